"""Costs are divided by those of eq. 6 on the very device: frozen for shipped profiles, measured for others."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from helpers import device

from amulett_gym import ENV_IDS
from amulett_gym.envs.eq6_costs import measure
from amulett_gym.envs.prices import divisors, divisors_are, divisors_owner, prices
from amulett_gym.envs.reward import COST_TERMS, FULL_CONTROL
from amulett_gym.profile import device_names, load_profile
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.tasks.suites import families_of, suite_names

SLOW = device("testbed", drives={"lag": 0.2}, plant={"masses": [{"mass": 1.0, "arm": 0.25}]})


@pytest.mark.parametrize("name", device_names())
def test_shipped_devices_have_frozen_divisors_under_any_name(name):
    shipped = load_profile(name)
    mine = load_profile({"name": "mine", "base": name})
    for suite in suite_names():
        assert (divisors_owner(mine, suite), divisors_are(mine, suite)) == (name, "frozen")
        assert prices(mine, suite).tolist() == prices(shipped, suite).tolist()


def test_what_is_frozen_is_what_is_measured():
    testbed = load_profile("testbed")
    found = measure(testbed, "steps")
    assert found is not None
    assert {term: getattr(found.mean, term) for term in COST_TERMS} == pytest.approx(
        divisors(testbed, "steps"), rel=0.01
    )


def test_the_effort_of_full_control_is_that_of_the_drives():
    found = measure(SLOW, "steps")
    assert found is not None
    assert divisors(SLOW, "steps")["effort"] == found.mean.effort
    assert divisors(SLOW, "steps", track=FULL_CONTROL)["effort"] == found.mean.drive_effort != found.mean.effort


@pytest.mark.parametrize("suite", ["steps", "hold-push"])
def test_eq6_returns_about_minus_one_on_a_device_of_ones_own(suite):
    assert (divisors_owner(SLOW, suite), divisors_are(SLOW, suite)) == (SLOW.name, "measured")
    borrowed = divisors(load_profile("testbed"), suite)
    assert abs(divisors(SLOW, suite)["position"] / borrowed["position"] - 1.0) > 0.2
    env = gym.make_vec(ENV_IDS[0], num_envs=160, suite=suite, profile=SLOW, tension_law="eq6")
    env.reset(seed=0)
    returns = sum(env.step(np.zeros((160, 1), dtype=np.float32))[1] for _ in range(500))
    assert np.mean(returns) == pytest.approx(-1.0, abs=0.15)


def test_families_choose_rows():
    testbed = load_profile("testbed")
    table = prices(testbed, "mixed")
    rows = [FAMILIES.index(family) for family in reversed(families_of("mixed"))] * 2
    assert prices(testbed, "mixed", families=rows).tolist() == table[rows].tolist()
    assert prices(testbed, "mixed", families=np.zeros(0, dtype=int)).shape == (0, len(COST_TERMS))


def test_a_device_that_eq6_cannot_play_has_the_divisors_of_its_base():
    weak = device("testbed", spring={"stiffness": 1.0})
    assert (divisors_owner(weak, "steps"), divisors_are(weak, "steps")) == ("testbed", "frozen")
    assert divisors(weak, "steps") == divisors(load_profile("testbed"), "steps")
