"""Many laws in many scenarios at once: what an episode costs there is what it costs in the environment."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulett_gym.evaluation.runner import Protocol, evaluate, play
from amulett_gym.evaluation.search.trials import Trials, held, scheduled
from amulett_gym.laws.policies import load_policy
from amulett_gym.profile import load_profile

PROTOCOL = Protocol(load_profile("testbed"), episodes=3, seed=5, duration=4.0)


@pytest.fixture(scope="module")
def trials():
    return Trials(PROTOCOL)


@pytest.mark.parametrize("suite", ["steps", "reach", "hold-push"])
def test_an_episode_costs_minus_its_return_in_the_environment(suite):
    results = evaluate(["constant:7"], suite=suite, episodes=3, seed=5, duration=4.0)
    costs = Trials(Protocol(PROTOCOL.profile, suite, episodes=3, seed=5, duration=4.0)).play(
        np.arange(3), held([7.0, 7.0, 7.0])
    )
    returns = np.zeros(3)
    for cost in costs:
        returns -= cost
    assert returns.tolist() == results.values["constant:7"]["return"].tolist()


@pytest.mark.parametrize(
    ("name", "keywords"), [("eq6", {"tension_law": "eq6"}), ("position-only", {"control": "position-only"})]
)
def test_what_acts_in_the_loop_costs_what_it_does_in_the_environment(name, keywords):
    results = evaluate([name], episodes=3, seed=5, duration=4.0)
    costs = Trials(PROTOCOL, **keywords).play(np.arange(3), held([10.0] * 3))
    np.testing.assert_allclose(costs.sum(axis=0), -results.values[name]["return"], rtol=1e-12)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 2), min_size=1, max_size=20), st.integers(0, 99))
def test_neighbours_change_nothing(trials, scenarios, seed):
    tensions = np.random.default_rng(seed).uniform(4.0, 15.0, len(scenarios))
    together = trials.play(np.array(scenarios), held(tensions))
    for device, scenario in enumerate(scenarios[:2]):
        alone = trials.play(np.array([scenario]), held(tensions[device : device + 1]))
        assert (alone[:, 0] == together[:, device]).all()


def test_each_device_follows_its_own_schedule(trials):
    constant, late = np.zeros((2, trials.steps), dtype=np.float32)
    late[100:] = 1.0
    costs = trials.play(np.array([0, 0]), scheduled(np.array([constant, late])))
    assert (costs[:100, 0] == costs[:100, 1]).all()
    assert (costs[100:, 0] != costs[100:, 1]).any()


def test_a_failure_is_charged_once_and_the_device_stands_still():
    profile = load_profile({"name": "nervous", "base": "testbed", "plant": {"velocity_limit_deg": 60.0}})
    trials = Trials(Protocol(profile, episodes=6, duration=4.0))
    costs = trials.play(np.arange(6), held(np.full(6, 4.0)))
    results = evaluate(["constant:4"], profile=profile, episodes=6, duration=4.0)
    failed = results.values["constant:4"]["failed"] > 0
    assert failed.any()
    np.testing.assert_allclose(costs.sum(axis=0), -results.values["constant:4"]["return"], rtol=1e-12)
    for cost in costs.T[failed]:
        last = np.flatnonzero(cost)[-1]
        assert cost[last] > 1.0
        assert last < trials.steps - 1


def test_the_digest_names_device_scenarios_and_loop(trials):
    other = {
        "seed": Protocol(PROTOCOL.profile, episodes=3, seed=6, duration=4.0),
        "suite": Protocol(PROTOCOL.profile, "reach", episodes=3, seed=5, duration=4.0),
        "duration": Protocol(PROTOCOL.profile, episodes=3, seed=5, duration=5.0),
        "profile": Protocol(load_profile("simulation"), episodes=3, seed=5, duration=4.0),
    }
    digests = {name: Trials(protocol).digest() for name, protocol in other.items()}
    assert len({trials.digest(), *digests.values()}) == 5
    assert Trials(PROTOCOL).digest() == trials.digest()
    for bits in (0, 255):  # what lies in memory before
        rows = np.frombuffer(bytearray([bits]) * trials.rows.nbytes, dtype=trials.rows.dtype).copy()
        for name in rows.dtype.names:
            rows[name] = trials.rows[name]
        again = Trials(PROTOCOL)
        again.rows = rows
        assert again.digest() == trials.digest() == again.digest(np.arange(3))


def test_redrawn_scenarios_differ_by_chance_alone(trials):
    several = trials.redrawn(2)
    assert several.draws == 2 and len(several.rows) == 2 * len(trials.rows)
    for name in trials.rows.dtype.names:
        same = several.rows[name].tobytes() == np.repeat(trials.rows[name], 2, axis=0).tobytes()  # NaNs as well
        assert same == (name != "noise_key"), name
    keys = np.concatenate([trials.rows["noise_key"], trials.redrawn(4).rows["noise_key"]])
    assert np.unique(keys).size == keys.size
    assert np.array_equal(several.rows["noise_key"].reshape(-1, 2)[:, 1], trials.redrawn(1, 1).rows["noise_key"])
    assert trials.digest() != several.digest(np.arange(0, len(several.rows), 2))
    for wrong in (lambda: trials.redrawn(0), lambda: several.redrawn(2)):
        with pytest.raises(ValueError, match="it has to be at least 1, of 1 each"):
            wrong()


@pytest.mark.parametrize("control", ["decentralized", "co-rotation"])
def test_the_full_control_cost_is_that_of_the_environment(control):
    device = {"name": "mine", "base": "testbed", "plant": {"velocity_limit_deg": 60.0}}  # where some fail
    protocol = Protocol(load_profile(device), "mixed", episodes=6, duration=4.0)
    trials = Trials(protocol, control)
    costs = trials.control_costs(np.arange(6), held([7.0] * 6, trials.tension_range))
    keywords = {"profile": protocol.profile, "suite": "mixed", "split": "held-out", "control": control}
    env = gym.make_vec(protocol.env_id, num_envs=6, max_episode_steps=200, failure_horizon=200, **keywords)
    run = play(protocol, env, load_policy("constant:7", env))
    assert costs.tolist() == run.values["control_cost"].tolist()
    assert 0.0 < run.values["failed"].sum() < 6.0


FLEET = tuple(load_profile(name) for name in ("testbed", "simulation"))


@pytest.mark.parametrize("control", ["decentralized", "co-rotation"])
def test_each_device_of_a_fleet_costs_what_it_does_alone(control):
    fleet = Trials(replace(PROTOCOL, suite="mixed", episodes=5), control, fleet=FLEET)
    assert fleet.which.tolist() == [0, 1, 0, 1, 0]
    chosen = np.array([4, 1, 0, 3, 1, 2, 4, 4, 0, 2, 0, 3, 2, 4])  # more than a block of the first device
    tensions = np.linspace(5.0, 14.0, chosen.size)
    costs = fleet.play(chosen, held(tensions, fleet.tension_range))
    control_costs = fleet.control_costs(chosen, held(tensions, fleet.tension_range))
    for index, profile in enumerate(FLEET):
        alone = Trials(replace(PROTOCOL, profile=profile, suite="mixed", episodes=5), control)
        own = fleet.which[chosen] == index
        choose = held(tensions[own], alone.tension_range)
        assert (alone.play(chosen[own], choose) == costs[:, own]).all()
        assert (alone.control_costs(chosen[own], choose) == control_costs[own]).all()
        for name in alone.rows.dtype.names:
            assert alone.rows[name][fleet.which == index].tobytes() == fleet.rows[name][fleet.which == index].tobytes()


def test_crossed_devices_of_a_fleet_play_all_scenarios():
    fleet = Trials(PROTOCOL, fleet=FLEET, crossed=True)
    assert fleet.which.tolist() == [0, 0, 0, 1, 1, 1]
    costs = fleet.play(np.arange(6), held([7.0] * 6))
    for index, profile in enumerate(FLEET):
        alone = Trials(replace(PROTOCOL, profile=profile)).play(np.arange(3), held([7.0] * 3))
        assert (costs[:, fleet.which == index] == alone).all()


def test_a_law_sees_the_observations_of_its_own_episode():
    fleet, seen = Trials(PROTOCOL, fleet=FLEET, crossed=True), []
    chosen = np.array([5, 0, 3, 2])

    def choose(step, observations):
        seen.append(observations.copy())
        return np.full(len(observations), 0.1 * step / fleet.steps, dtype=np.float32)

    fleet.play(chosen, choose)
    together, alone = np.array(seen), []
    for scenario in chosen:
        seen.clear()
        fleet.play(np.array([scenario]), choose)
        alone.append(np.array(seen)[:, 0])
    assert (np.stack(alone, axis=1) == together).all()


def test_the_digest_names_the_fleet_and_how_it_is_dealt():
    trials = [
        Trials(PROTOCOL),
        Trials(PROTOCOL, fleet=FLEET[:1]),
        Trials(PROTOCOL, fleet=FLEET),
        Trials(PROTOCOL, fleet=FLEET[::-1]),
        Trials(PROTOCOL, fleet=FLEET, crossed=True),
    ]
    assert len({each.digest() for each in trials}) == 5
    assert trials[2].digest() == Trials(PROTOCOL, fleet=FLEET).digest()
    balanced = trials[2].balanced(2)
    assert balanced.which.size == 2 and trials[2].redrawn(2).which.tolist() == [0, 0, 1, 1, 0, 0]
