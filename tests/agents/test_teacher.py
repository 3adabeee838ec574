"""Imitation of a teacher that knows the wearer's intention."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch
from helpers import SMALL_RECIPE

import amulett_gym
from amulett_agents.bundles import describe_policy
from amulett_agents.config import load_train_config
from amulett_agents.model import make_model
from amulett_agents.teacher import teacher_actions
from amulett_agents.teacher_settings import TeacherSettings
from amulett_agents.training import resume, train
from amulett_agents.validation import evaluate, make_validation_env
from amulett_gym.errors import AmulettError
from amulett_gym.laws.actor import Actor
from amulett_gym.laws.bundle import read_bundle

WORN = amulett_gym.WORN_ID
SMALL = [*SMALL_RECIPE, f"env.id={WORN}", "network.hidden=[16]", "network.memory=true", "env.control=co-rotation"]
TEACHER = ["teacher={rounds: 2, episodes: 24, gradient_steps: 150, batch_size: 128}"]


def test_the_teacher_assists_while_the_intention_moves():
    env = gym.make_vec(WORN, num_envs=6, agent_period=0.05)
    env.reset(seed=0)
    settings = TeacherSettings(moving_tension=3.0, holding_tension=12.0)
    found = set()
    for _ in range(40):
        env.step(np.zeros((6, 2), np.float32))
        rates = np.degrees(env.unwrapped.episodes.simulation.read_worn("intention_rate"))
        actions = teacher_actions(settings, env, [0.0, 15.0])
        moves = np.abs(rates) > 2.0
        np.testing.assert_allclose(actions[:, 0], np.where(moves, 3.0, 12.0) / 7.5 - 1.0, atol=1e-6)
        np.testing.assert_array_equal(actions[:, 1], np.where(moves, 1.0, -1.0))
        beyond = teacher_actions(settings.model_copy(update={"assistance_margin": 0.25}), env, [0.0, 15.0])
        np.testing.assert_array_equal(beyond, actions * np.float32([1.0, 1.25]))
        found |= set(moves.tolist())
    assert found == {True, False}


def test_imitation_is_better_than_the_constant_that_it_replaces():
    longer = ["env.max_episode_steps=100", "validation.episodes=24", "teacher.gradient_steps=400", "teacher.rounds=4"]
    plain = make_model(load_train_config(None, [*SMALL, *longer[:2]]))
    config = load_train_config(None, [*SMALL, *TEACHER, *longer])
    taught = make_model(config)
    costs = []
    for model in (plain, taught):
        env = make_validation_env(config)
        costs.append(evaluate(model, env, 0)["cost"])
        env.close()
    assert costs[1] < 0.9 * costs[0]


def test_a_correcting_teacher_assists_at_rest_where_the_wearer_pushes_the_device_to_its_place():
    scenario = {"initial_angle_deg": 40.0, "pushes": [{"time": 0.5, "duration": 2.0, "torque": 0.8, "rise": 0.1}]}
    env = gym.make_vec(WORN, num_envs=1, control="co-rotation")
    env.reset(seed=0, options={"scenario": scenario})
    plain, correcting = TeacherSettings(), TeacherSettings(correction=1.0)
    simulation, assisted = env.unwrapped.episodes.simulation, []
    for step in range(200):
        # The device gives way to the push for 0.1 s, and then has a wrong place.
        env.step(np.float32([[0.5, 1.0 if 30 <= step < 35 else -1.0]]))
        missing = np.degrees(simulation.read_worn("intention") - simulation.read("setpoint"))[0]
        torque = simulation.read_worn("measured_cuff")[0]
        assert teacher_actions(plain, env, [0.0, 15.0])[0, 1] == -1.0
        acts = teacher_actions(correcting, env, [0.0, 15.0])[0, 1] == 1.0
        assert acts == (abs(missing) > 1.0 and missing * torque > 0.05 * abs(missing))
        assisted.append((step, acts, missing, torque))
    env.close()
    # Not while the tool pushes it farther away, but when it stops.
    pushed = [acts for step, acts, missing, _ in assisted if 40 < step < 120 and abs(missing) > 1.0]
    assert pushed and not any(pushed)
    assert any(acts for step, acts, *_ in assisted if step > 125)


def test_a_margin_lets_the_policy_reach_the_ends_of_the_assistance():
    """An imitated end of the range is missed by some error, which a margin beyond it clips."""
    shares = []
    for margin in (0.0, 0.5):
        config = load_train_config(None, [*SMALL, *TEACHER, "env.follow_time=0", f"teacher.assistance_margin={margin}"])
        model, seen = make_model(config), []
        env = make_validation_env(config)
        policy = Actor(*describe_policy(model), env)
        observations, _ = env.reset(seed=0)
        for _ in range(60):
            actions = policy(observations)
            assert (np.abs(actions) <= 1.0).all()
            seen.append(actions[:, 1])
            observations = env.step(actions)[0]
        env.close()
        shares.append(np.mean(np.abs(seen) == 1.0))
    assert shares[1] > 1.3 * shares[0]


def test_a_taught_run_is_the_same_again_and_resumes(tmp_path):
    config = load_train_config(None, [*SMALL, *TEACHER, "total_steps=512"])
    weights = [read_bundle(train(config, tmp_path / name, progress=False).last).layers for name in "ab"]
    for one, other in zip(*weights, strict=True):
        assert np.array_equal(one[0], other[0]) and np.array_equal(one[1], other[1])
    assert resume(tmp_path / "a").steps == 512
    # A resumed model gets the checkpoint's weights, and does not imitate anew.
    model = make_model(config, resumed=True)
    assert not torch.any(model.policy.action_net.weight)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (TEACHER, "only PPO in Amulett/Worn-v0 has one"),
        ([f"env.id={WORN}", *TEACHER, "algorithm=sac"], "only PPO in Amulett/Worn-v0 has one"),
        ([f"env.id={WORN}", *TEACHER, "network.start=pretrained"], "without network.start"),
        ([f"env.id={WORN}", *TEACHER, "teacher.holding_tension=20"], "at most 15.0 N"),
        ([f"env.id={WORN}", *TEACHER, "env.tension_range=[2, 15]"], "at least 2.0 N"),
    ],
)
def test_wrong_teachers_are_refused(changes, problem):
    with pytest.raises(AmulettError, match=problem):
        load_train_config(None, changes)


def test_recipes_without_a_teacher_keep_their_records():
    assert "teacher" not in load_train_config().model_dump()
    assert load_train_config(None, [f"env.id={WORN}", *TEACHER]).model_dump()["teacher"]["rounds"] == 2
