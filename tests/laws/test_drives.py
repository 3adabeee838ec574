"""Policies in `Amulett/Drives-v0`: bundles, functions of your own, and what cannot act there."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from helpers import keep_network, make_bundle

import amulett_gym
from amulett_gym import load_policy
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol, evaluate
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import Own, parse_contender
from amulett_gym.laws.own import load_own
from amulett_gym.profile import load_profile

SCALING, TENSION, DRIVES = amulett_gym.ENV_IDS[:3]
SETPOINT = OBSERVATIONS.index("setpoint")


def keep(folder: Path, **about) -> Path:
    """Write a policy that turns the drives to the setpoint, with 9 N."""
    weight = np.zeros((2, len(OBSERVATIONS)), np.float32)
    weight[0, SETPOINT] = 150.0 / 90.0
    about = {"env_id": DRIVES, "mean_angle_range": 258.66, "tension_range": [0.0, 15.0], **about}
    return keep_network(folder, [(weight, np.array([0.0, 0.2], np.float32))], **about)


def follow_setpoint(observations):
    """Turn the drives to the setpoint, with 9 N."""
    return np.stack([observations[:, SETPOINT] * 150.0 / 90.0, np.full(len(observations), 0.2)], axis=1)


@pytest.fixture
def folder(tmp_path) -> Path:
    return keep(tmp_path / "drives")


def test_a_bundle_has_two_actions_and_a_range_of_the_mean_angle(folder, tmp_path):
    bundle = read_bundle(folder)
    assert (bundle.env.id, bundle.policy.mean_angle_range) == (DRIVES, 258.66)
    assert bundle.act(np.zeros((3, 13))).shape == (3, 2)
    with pytest.raises(ValueError, match="to map the 13 observations and features to 1 action"):
        keep(tmp_path / "wrong", mean_angle_range=None)
    with pytest.raises(AmulettError, match="mean_angle_range is 258.66; .* names Amulett/Scaling-v0"):
        keep(tmp_path / "wrong", env_id=SCALING)
    assert "mean_angle_range" not in (make_bundle(tmp_path / "other") / "policy.json").read_text()


def test_a_bundle_acts_as_its_own_network(folder):
    env = gym.make(DRIVES, mean_angle_range=258.66)
    policy = load_policy(folder, env)
    observation, _ = env.reset(seed=1)
    action = policy(observation)
    assert action.dtype == np.float32 and action.shape == (2,)
    assert action == pytest.approx([observation[SETPOINT] * 150.0 / 90.0, 0.2])
    assert policy(np.stack([observation] * 3)).shape == (3, 2)


def test_a_network_can_act_relative_to_the_setpoint(tmp_path):
    env = gym.make(DRIVES, mean_angle_range=258.66)
    policy = load_policy(keep(tmp_path / "relative", setpoint_gain=-2.5), env)
    for setpoint, mean in ((0.2, 0.2 * (150.0 / 90.0 - 2.5)), (0.6, 1.0 - 1.5), (-1.0, 1.0)):  # each step is limited
        observation = np.zeros(len(OBSERVATIONS), dtype=np.float32)
        observation[SETPOINT] = setpoint
        assert policy(observation) == pytest.approx([mean, 0.2], abs=1e-6)
    with pytest.raises(ValueError, match="setpoint_gain needs mean_angle_range"):
        keep_network(tmp_path / "wrong", [(np.zeros((1, 13)), np.zeros(1))], setpoint_gain=1.0)


def test_a_low_pass_holds_for_both_entries(tmp_path):
    env = gym.make(DRIVES, mean_angle_range=258.66)
    policy = load_policy(keep(tmp_path / "slow", follow=0.25), env)
    scenario = {"moves": [{"time": 0.0, "angle_deg": 45.0}], "noise_seed": 0}
    observation, _ = env.reset(seed=0, options={"scenario": scenario})
    actions = []
    for _ in range(8):
        actions.append(policy(observation))
        observation, *_ = env.step(actions[-1])
    mean, tension = np.array(actions).T
    assert mean == pytest.approx(0.5 - 0.5 * 0.75 ** np.arange(1, 9), abs=1e-6)
    assert np.diff(tension) == pytest.approx(0.25 * (0.2 - tension[:-1]), abs=1e-6)


def test_another_tension_range_means_the_same_tensions(folder):
    played = []
    for tension_range in ((0.0, 15.0), (0.0, 20.0)):
        env = gym.make(DRIVES, mean_angle_range=258.66, tension_range=tension_range)
        policy = load_policy(folder, env)
        observation, _ = env.reset(seed=1)
        for _ in range(30):
            observation, *_, info = env.step(policy(observation))
        played.append((info["joint_angle"], info["tension_setpoint"]))
    assert played[0] == pytest.approx(played[1], rel=1e-6) and played[0][1] == pytest.approx(9.0)


@pytest.mark.parametrize("name", ["constant:8", "eq6-held", "eq6-held-printed", "parametric", "eq6-tuned"])
def test_laws_for_a_tension_cannot_act_on_drives(name):
    with pytest.raises(AmulettError, match=f"'{name}' chooses a tension and cannot act in {DRIVES}"):
        load_policy(name, gym.make(DRIVES))


def test_a_bundle_acts_in_its_own_environment_alone(folder):
    with pytest.raises(
        AmulettError, match="needs an environment in which an action is a tension; .* Amulett/Drives-v0"
    ):
        load_policy("pretrained", gym.make(DRIVES))
    with pytest.raises(AmulettError, match="needs Amulett/Drives-v0; this is Amulett/Tension-v0"):
        load_policy(folder, gym.make(TENSION))
    with pytest.raises(AmulettError, match="make it with mean_angle_range=258.66"):
        load_policy(folder, gym.make(DRIVES))
    with pytest.raises(AmulettError, match="'co-rotation/.*' is no contender: .* acts in Amulett/Drives-v0 alone"):
        parse_contender(f"co-rotation/{folder}")


def test_functions_of_your_own_return_both_entries():
    env = gym.make_vec(DRIVES, num_envs=3)
    observations, _ = env.reset(seed=0)
    np.testing.assert_allclose(
        load_policy(follow_setpoint, env)(observations), follow_setpoint(observations), rtol=1e-6
    )
    for wrong in (lambda seen: np.zeros(len(seen)), lambda seen: np.zeros((len(seen), 1))):
        with pytest.raises(AmulettError, match=r"it has to be \(3, 2\)$"):
            load_policy(wrong, env)(observations)


def test_a_policy_for_drives_is_compared_with_eq_6_in_the_papers_loop(folder):
    contender = parse_contender(str(folder))
    assert contender.env_id == DRIVES
    assert contender.env_keywords == {"agent_period": 0.02, "control": "drives", "mean_angle_range": 258.66}
    keywords = {"episodes": 4, "duration": 3.0, "suite": "paper-step"}
    apart = evaluate(["eq6", "constant:10"], **keywords)
    own = Own("mine", {"mean_angle_range": 258.66}, act=follow_setpoint, env_id=DRIVES)
    mixed = evaluate([str(folder), "constant:10", own], **keywords)
    assert (apart.track, mixed.track) == ("schedule", "full-control")
    for name in ("eq6", "constant:10"):
        np.testing.assert_array_equal(mixed.values[name]["cost"], apart.values[name]["cost"])
    np.testing.assert_allclose(mixed.values[str(folder)]["cost"], mixed.values["mine"]["cost"], rtol=1e-4)
    assert mixed.values[str(folder)]["position_ise"].mean() < mixed.values["eq6"]["position_ise"].mean()
    there = evaluate([str(folder), "constant:10"], env_id=DRIVES, **keywords)  # laws stay in the paper's loop
    for name in ("eq6", "constant:10", str(folder)):
        np.testing.assert_array_equal(there.values[name]["cost"], mixed.values[name]["cost"])


def test_training_in_drives_is_no_difference_but_another_suite_is(folder):
    remarks = evaluate([str(folder)], episodes=2, duration=0.2, suite="steps").remarks
    assert not [remark for remark in remarks if "trained" in remark]
    remarks = evaluate([str(folder)], episodes=2, duration=0.2, suite="reach").remarks
    assert [remark for remark in remarks if "was trained for steps, not reach" in remark]


def test_a_recorded_episode_has_the_bits_of_the_comparison(folder):
    protocol = Protocol(load_profile("testbed"), suite="mixed", seed=3, duration=2.0, episodes=1)
    values = evaluate([str(folder)], suite="mixed", seed=3, duration=2.0, episodes=1).values[str(folder)]
    episode = record_episode(str(folder), protocol)
    for name in ("position_ise", "effort", "cost"):
        assert episode.metrics[name] == values[name][0], name


def test_a_python_file_can_name_its_environment(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "import numpy as np\ndef act(seen):\n    return np.zeros((len(seen), 2))\nact.env_id = 'Amulett/Drives-v0'\n"
        "def other(seen):\n    return 0\nother.env_id = 'Amulett/Drive-v0'\n"
    )
    own = load_own(f"{file}:act")
    assert own.env_id == DRIVES
    assert evaluate([own], episodes=2, duration=0.2).failures[own.name] == ["", ""]
    with pytest.raises(AmulettError, match="did you mean 'Amulett/Drives-v0'"):
        load_own(f"{file}:other")
