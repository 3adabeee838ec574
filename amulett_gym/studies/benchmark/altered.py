"""What one change does: noise alone, or wrong parameters alone, in all scenarios; other gains of the paper's loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.profile import Profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.studies.benchmark.description import Altered
from amulett_gym.tasks.scenario import Device, Scenario, pack, unpack

NOISE = 2.0
"""Factor of the sensors' noise."""

OFF = 0.2
"""Share by which springs, inertia and damping differ, up or down, beside the scenario's own deviation."""


def alter(protocol: Protocol, change: Altered) -> Protocol:
    """Return a protocol with the same scenarios, targets and noise draws, changed in one way.

    ``noise-x2``: twice the standard deviation of the sensors' noise. ``wrong-parameters``: the rate of both springs,
    the inertia and the damping are 20 % above or below what they were, drawn for each scenario; loops do not know.
    Where weaker springs could not hold the scenario's begin, they are stronger.
    """
    scenarios = [unpack(row) for row in Trials(protocol).rows]
    if change == "noise-x2":
        devices = [{"noise": min(NOISE * one.device.noise, 10.0)} for one in scenarios]
    else:
        factors = np.random.default_rng(0).choice((1.0 - OFF, 1.0 + OFF), (len(scenarios), 3))
        weaker = [_with(one, _off(one.device, *each)) for one, each in zip(scenarios, factors.tolist(), strict=True)]
        factors[[not _can_begin(protocol.profile, one) for one in weaker], 0] = 1.0 + OFF
        devices = [_off(one.device, *each) for one, each in zip(scenarios, factors.tolist(), strict=True)]
    changed = (_with(scenario, device) for scenario, device in zip(scenarios, devices, strict=True))
    return replace(protocol, scenarios=tuple(changed))


def with_gains(profile: Profile, other: Profile) -> Profile:
    """Return a device with the gains of another profile in the paper's loop."""
    gains = {"position": other.loop.position, "tension": other.loop.tension}
    return profile.model_copy(update={"loop": profile.loop.model_copy(update=gains)})


def _off(device: Device, spring: float, inertia: float, damping: float) -> dict[str, float]:
    return {
        "spring_biceps": device.spring_biceps * spring,
        "spring_triceps": device.spring_triceps * spring,
        "inertia": device.inertia * inertia,
        "damping": device.damping * damping,
    }


def _can_begin(profile: Profile, scenario: Scenario) -> bool:
    try:
        Simulation(profile).reset(pack(scenario, profile))
    except AmulettError:
        return False
    return True


def _with(scenario: Scenario, changes: dict[str, float]) -> Scenario:
    return scenario.model_copy(update={"device": scenario.device.model_copy(update=changes)})
