"""The baselines of worn devices, against the formulas by hand."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from pydantic import ValidationError

from amulett_gym import WORN_ID
from amulett_gym.envs.worn_transition import OBSERVATIONS
from amulett_gym.laws.policies import load_policy
from amulett_gym.laws.worn import WORN_LAWS, Constant, Eq6, Latched, Switched, WornLaw


def observed(error_deg=0.0, rate_deg=0.0, cuff=0.0, count=1):
    rows = np.zeros((count, len(OBSERVATIONS)), dtype=np.float32)
    rows[:, OBSERVATIONS.index("position_error")] = error_deg / 90.0
    rows[:, OBSERVATIONS.index("joint_velocity")] = rate_deg / 500.0
    rows[:, OBSERVATIONS.index("measured_cuff")] = cuff / 2.0
    return rows


def levels(actions, tension_range=(0.0, 15.0)):
    low, high = tension_range
    return low + 0.5 * (actions[:, 0] + 1.0) * (high - low), 0.5 * (actions[:, 1] + 1.0)


def test_a_constant_is_constant_in_any_range_of_tensions():
    law = Constant(co_contraction=6.0, assistance=0.25)
    for ends in ((0.0, 15.0), (4.0, 15.0)):
        tension, assistance = levels(WornLaw(law, tension_range=ends)(observed(20.0, 100.0, 1.0, count=3)), ends)
        assert tension == pytest.approx([6.0] * 3, abs=1e-5) and assistance == pytest.approx([0.25] * 3)
    below, _ = levels(WornLaw(Constant(co_contraction=1.0), tension_range=(4.0, 15.0))(observed()), (4.0, 15.0))
    assert below == pytest.approx([4.0])


def test_eq6_falls_with_the_error_as_the_paper_says():
    law = WornLaw(Eq6(nominal_tension=10.0, minimum_tension=4.0, error_offset=30.0, assistance=0.5))
    for error, wanted in ((0.0, 10.0), (7.5, 4.0 + 6.0 * 0.75**4), (-15.0, 4.0 + 6.0 * 0.5**4), (60.0, 4.0)):
        tension, assistance = levels(law(observed(error)))
        assert tension == pytest.approx([wanted], abs=1e-4) and assistance == pytest.approx([0.5])


def test_switched_is_soft_in_motion_and_stiff_after_its_hold_time():
    settings = Switched(moving_tension=1.0, holding_tension=11.0, holding_assistance=0.0, speed=20.0, torque=0.5)
    law = WornLaw(settings.model_copy(update={"hold": 0.1, "width": 0.01}))
    law.reset(1)
    assert levels(law(observed())) == (pytest.approx([11.0]), pytest.approx([0.0], abs=1e-6))
    for moving in (observed(rate_deg=-40.0), observed(cuff=-1.0), observed(rate_deg=15.0, cuff=0.25)):
        law.reset(1)
        assert levels(law(moving)) == (pytest.approx([1.0], abs=1e-4), pytest.approx([1.0]))
        shares = [levels(law(observed()))[1][0] for _ in range(6)]
        assert shares == pytest.approx([0.8, 0.6, 0.4, 0.2, 0.0, 0.0], abs=1e-4)  # 20 ms steps of 0.1 s
    assert levels(law(observed(rate_deg=20.0)))[0] == pytest.approx([6.0], abs=1e-3)  # on the switch


def test_latched_locks_at_rest_and_lets_go_when_the_torque_changes_late():
    law = WornLaw(
        Latched(moving_tension=1.0, holding_tension=12.0, speed=5.0, still=0.04, least_motion=0.1, settling=0.2)
    )

    def assistances(steps, **seen):
        return [float(levels(law(observed(**seen)))[1][0]) for _ in range(steps)]

    law.reset(1)
    assert assistances(9, cuff=0.5) == [0.0] * 9  # a load that comes on early is carried
    assert assistances(20, cuff=0.5) == [0.0] * 20
    assert assistances(1, cuff=0.9) == [1.0]  # a late change frees it
    assert levels(law(observed(rate_deg=30.0)))[0] == pytest.approx([1.0], abs=1e-5)
    assert assistances(10, rate_deg=-30.0) == [1.0] * 10
    assert assistances(3) == [1.0, 0.0, 0.0]  # still for 40 ms
    assert levels(law(observed()))[0] == pytest.approx([12.0], abs=1e-5)
    assert assistances(20, cuff=0.2) == [0.0] * 20
    assert assistances(1, cuff=-0.1) == [1.0]
    assert sum(assistances(8)) == pytest.approx(4.0, abs=1.0)  # free for at least 0.1 s, then locked again


def test_slow_changes_do_not_free_a_latched_arm():
    law = WornLaw(Latched(settling=0.1, torque=0.25, forgetting=0.4))
    law.reset(1)
    slow = [law(observed(cuff=0.3 * 0.02 * k))[0, 1] for k in range(200)]  # 0.3 N m/s: 0.12 N m beyond its mean
    assert slow == [-1.0] * 200


def test_an_episode_begins_without_a_memory():
    law = WornLaw(Switched())
    law.reset(2)
    first = law(observed(count=2))
    law(observed(rate_deg=400.0, count=2))
    assert not np.array_equal(law(observed(count=2)), first)
    law.reset(2)
    assert np.array_equal(law(observed(count=2)), first)


@pytest.mark.parametrize("name", WORN_LAWS)
def test_a_baseline_acts_in_the_environment(name):
    env = gym.make_vec(WORN_ID, num_envs=3)
    policy = load_policy(WornLaw(WORN_LAWS[name]()), env)
    observations, _ = env.reset(seed=0)
    for _ in range(3):
        actions = policy(observations)
        assert actions.shape == (3, 2) and np.abs(actions).max() <= 1.0
        observations, rewards, *_ = env.step(actions)
    assert np.isfinite(rewards).all()


def test_parameters_are_checked():
    for wrong in ({"co_contraction": 16.0}, {"assistance": 1.5}, {"tension": 3.0}):
        with pytest.raises(ValidationError):
            Constant(**wrong)
    with pytest.raises(ValidationError):
        Switched(hold=0.0)
