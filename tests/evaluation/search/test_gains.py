"""Gains of a loop are tuned in their own ranges, with as many episodes for each loop, into a profile."""

from dataclasses import replace

import numpy as np
import pytest

from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.evaluation.search.gains import gains_of, group_name, profile_text, shipped_text
from amulett_gym.evaluation.search.laws import Recipe, mean_costs, tune
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.safe_yaml import parse_yaml

TESTBED = load_profile("testbed")
SMALL = Recipe(
    "gains", seeds=(1,), population=6, generations=((2, 3), (3, 2)), validation=3, control="equilibrium-point"
)


@pytest.fixture(scope="module")
def trials():
    return Trials(Protocol(TESTBED, split="train", episodes=3), "co-rotation")


@pytest.mark.parametrize("control", LOOPS)
def test_every_gain_of_every_loop_has_a_range_that_its_group_allows(control):
    space = gains_of(control)
    group = type(getattr(TESTBED.loops, group_name(control)))
    *gains, tension = space.parameters
    assert gains and tension.unit == "N"
    for end in (0.0, 0.5, 1.0):
        vector = space.from_unit(np.full(len(space.parameters), end))
        group(**{gain.name: float(value) for gain, value in zip(gains, vector, strict=False)})
    assert all(gain.low <= gain.start <= gain.high for gain in space.parameters)
    assert (space.to_unit(space.start()) >= 0.0).all() and (space.to_unit(space.start()) <= 1.0).all()


def test_all_loops_have_the_same_number_of_episodes():
    for budget in (None, 30_000):
        recipes = [Recipe("gains", control=control) for control in LOOPS]
        found = {(recipe if budget is None else recipe.within(budget)).episodes for recipe in recipes}
        assert len(found) == 1
    assert Recipe("gains", control=LOOPS[0]).episodes == 204_288


def test_candidates_are_played_with_their_own_gains(trials):
    space = gains_of("co-rotation")
    vectors = space.from_unit(np.random.default_rng(0).uniform(0.3, 0.7, size=(3, len(space.parameters))))
    costs = mean_costs(space, vectors, trials, np.arange(3))
    assert len(set(costs.tolist())) == 3
    for vector, cost in zip(vectors, costs, strict=True):
        own = Trials(replace(trials.protocol, profile=space.profile(TESTBED, vector)), "co-rotation")
        choose = held(np.full(3, vector[-1]), own.tension_range)
        assert own.control_costs(np.arange(3), choose).mean() == cost
    present = held(np.full(3, 8.0), trials.tension_range)  # afterwards the profile's own gains hold again
    fresh = Trials(trials.protocol, "co-rotation")
    assert trials.control_costs(np.arange(3), present).tolist() == fresh.control_costs(np.arange(3), present).tolist()


@pytest.mark.parametrize("profile", ["testbed", {"name": "mine", "base": "testbed", "drives": {"lag": 0.1}}])
def test_tuned_gains_are_a_profile_with_their_source(tmp_path, profile):
    recipe = replace(SMALL, profile=profile)
    content = tune(tmp_path, recipe)
    space, base = gains_of("equilibrium-point"), load_profile(profile)
    train, _ = recipe.trials()
    start = mean_costs(space, space.start()[None], train, np.arange(3))[0]
    assert content["starts"]["1"]["train"] <= start
    found = load_profile(tmp_path / "profile.yaml")
    assert found.name == ("mine" if isinstance(profile, dict) else "testbed-tuned")
    assert found.drives == base.drives and found.root == base.root
    group = found.loops.equilibrium_point
    for name in ("reference_time", "lead"):
        assert getattr(group, name) == pytest.approx(content["parameters"][name]["value"], rel=1e-5)
        assert group.sources[name].startswith("identified: tuned on train of steps, 102 simulated episodes, with a")
    assert found.loops.model_copy(update={"equilibrium_point": base.loops.equilibrium_point}) == base.loops


def test_a_shipped_profile_is_written_with_all_else_as_it_was(tmp_path, monkeypatch):
    (tmp_path / "profiles").mkdir()
    path = tmp_path / "profiles" / "testbed.yaml"
    text = "# kept\nname: testbed\nloops:\n  co_rotation: {kp: 0.3}\n# of the loops\ndrives: {lag: 0.1}  # kept, too\n"
    path.write_text(text)
    monkeypatch.setattr(tuning.resources, "files", lambda package: tmp_path)
    parameters = {"reference_time": {"value": 0.2}, "lead": {"value": 0.1234567}, "co_contraction": {"value": 8.0}}
    assert tuning.ship(SMALL, {"parameters": parameters}) == path
    written = path.read_text()
    assert written.startswith("# kept\nname: testbed\n") and "drives: {lag: 0.1}  # kept, too\n" in written
    loops = parse_yaml(written, "profile")["loops"]
    assert loops["co_rotation"] == {"kp": 0.3}
    assert loops["equilibrium_point"]["lead"] == 0.123457
    again = shipped_text(written, TESTBED, "co-rotation", {"kp": 0.5}, "identified: here")
    assert again.count("loops:") == 1
    assert parse_yaml(again, "profile")["loops"]["equilibrium_point"] == loops["equilibrium_point"]
    assert parse_yaml(again, "profile")["loops"]["co_rotation"]["kp"] == 0.5


def test_sources_of_other_loops_stay():
    once = load_profile(parse_yaml(profile_text(TESTBED, "co-rotation", {"kp": 0.5}, "identified: a"), "profile"))
    twice = load_profile(parse_yaml(profile_text(once, "equilibrium-point", {"lead": 0.1}, "identified: b"), "profile"))
    assert twice.loops.co_rotation.kp == 0.5 and twice.loops.co_rotation.sources["kp"] == "identified: a"
    assert twice.loops.equilibrium_point.sources == {"lead": "identified: b"}
    assert twice.name == "testbed-tuned" and twice.root == "testbed"
