"""What the judgement calls that no table decides are worth: each varied alone, all else as taken.

The noise of the testbed's repetitions, the measurement time T of eqs. 7 and 8, how certain the agonist's switch waits
to be, and what replaces forces estimated below the floor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.studies.paper.reproduction import (
    MEASUREMENT_TIME,
    Readings,
    apply_readings,
    compare,
    explained,
    measure,
)
from amulett_gym.studies.paper.runs import MOVES_FROM, antagonist_force, paper_step, start
from amulett_gym.studies.paper.switching import switching_run
from amulett_gym.studies.paper.tables import DEVICES, PROTOCOL, TENSION_SETPOINT

FIRST_KEYS = (1, 11, 21, 31, 41, 51)
"""Keys of the first repetition's noise."""

MEASUREMENT_TIMES = (3.0, 5.0, 10.0, 20.0)
"""T [s]."""

HYSTERESES = (0.6, 1.0, 1.6, 2.4)
"""Factors of the testbed's `switch_hysteresis`; the shipped one is 5 standard deviations of the noise."""

FLOORS: tuple[Literal["clamp", "hold", "ignore"], ...] = ("clamp", "hold", "ignore")
"""Treatments of forces estimated below the floor (`Readings.floor`)."""

REST = (5.0, 20.0)
"""When an arm at rest with a tension setpoint of 5 N is looked at [s]."""


@dataclass(frozen=True)
class Sensitivity:
    """What the variations give.

    Attributes
    ----------
    by_noise : dict of int to tuple of int
        Key of the first repetition's noise -> numbers explained of each table.
    by_time : dict of float to tuple of int
        T [s] -> numbers explained of each table.
    by_hysteresis : dict of float to dict of str to tuple of int and float
        Factor -> configuration with tension control -> switches in the movements of Figure 9, and the largest
        difference of the joint angle that one of them makes [deg].
    by_floor : dict of str to tuple of float
        Treatment -> the antagonist's true force [N] after each of `REST`, mean of all repetitions: the testbed at rest
        on the posture of the paper's step, before it, with a setpoint of 5 N.
    by_setpoint : dict of str to float
        What the error is taken against -> tension ISE of the testbed without tension control [N^2 s], mean of all
        repetitions: the true force at rest, as in Table 4, or as in the paper the force signal's mean over the two
        seconds before the step.
    """

    by_noise: dict[int, tuple[int, ...]]
    by_time: dict[float, tuple[int, ...]]
    by_hysteresis: dict[float, dict[str, tuple[int, float]]]
    by_floor: dict[str, tuple[float, ...]]
    by_setpoint: dict[str, float]


def vary(profiles: Mapping[str, Profile], readings: Readings) -> Sensitivity:
    """Vary the judgement calls, each alone.

    Parameters
    ----------
    profiles : mapping of str to Profile
        The devices, by `tables.DEVICES`.
    readings : Readings

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    testbed = profiles["testbed"]
    return Sensitivity(
        {key: _explained(profiles, readings, MEASUREMENT_TIME, key) for key in FIRST_KEYS},
        {time: _explained(profiles, readings, time) for time in MEASUREMENT_TIMES},
        {factor: _switches(testbed, readings, factor) for factor in HYSTERESES},
        {floor: _forces_at_rest(testbed, replace(readings, floor=floor)) for floor in FLOORS},
        _position_only_ise(apply_readings(testbed, readings)),
    )


def _explained(profiles: Mapping[str, Profile], readings: Readings, time: float, first_key: int = 1) -> tuple[int, ...]:
    durations = dict.fromkeys(DEVICES, time)
    rows = compare(measure(profiles, readings, duration=durations, first_key=first_key), readings)
    return tuple(count for count, _ in explained(rows).values())


def _switches(testbed: Profile, readings: Readings, factor: float) -> dict[str, tuple[int, float]]:
    loop = {"switch_hysteresis": factor * testbed.loop.switch_hysteresis}
    loop["tie_width"] = min(testbed.loop.tie_width, loop["switch_hysteresis"])
    device = load_profile(merge(testbed.model_dump(), {"loop": loop}))
    found = {}
    for configuration in (*TENSION_SETPOINT, "variable"):
        switches = switching_run(device, readings, configuration).switches
        found[configuration] = len(switches), max((switch.deviation for switch in switches), default=0.0)
    return found


def _forces_at_rest(testbed: Profile, readings: Readings) -> tuple[float, ...]:
    device = apply_readings(testbed, readings)
    repetitions = range(1, PROTOCOL.repetitions_testbed + 1)
    still = [paper_step(device, "tension-5", noise_seed=key).model_copy(update={"moves": []}) for key in repetitions]
    simulation = start(device, "tension-5", still)
    forces, passed = [], 0.0
    for time in REST:
        simulation.advance(round((time - passed) / simulation.control_period))
        forces.append(float(np.mean(simulation.read("force_triceps"))))
        passed = time
    return tuple(forces)


def _position_only_ise(testbed: Profile) -> dict[str, float]:
    scenario = paper_step(testbed, "position-only")
    late = {"moves": [scenario.moves[0].model_copy(update={"time": MOVES_FROM})], "measure_from": MOVES_FROM}
    keys = range(1, PROTOCOL.repetitions_testbed + 1)
    scenarios = [scenario.model_copy(update={**late, "noise_seed": key}) for key in keys]
    simulation = start(testbed, "position-only", scenarios)
    force, at_rest = antagonist_force(simulation, MOVES_FROM + MEASUREMENT_TIME, estimated=True)
    first = round(MOVES_FROM / simulation.control_period)
    mean = force[:first].mean(axis=0)
    setpoints = {"true force at rest (as in Table 4 here)": at_rest[0], "mean of the signal before the step": mean}
    return {
        name: float(np.mean(np.sum((force[first:] - setpoint) ** 2, axis=0)) * simulation.control_period)
        for name, setpoint in setpoints.items()
    }
