"""What switching the agonist does to the joint's position and to the force feedback (section 3.5, Figure 9).

Each switch is undone once: from the moment before it, the same device with the same noise goes on with the agonist that
it had. What then differs is what this switch does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from amulett_gym.config import Profile
from amulett_gym.evaluation.signals import ANTAGONIST, switch_rows
from amulett_gym.paper.reproduction import Readings, apply_readings
from amulett_gym.paper.runs import HOLD, MOVES_FROM, STEPS, follow, start, there_and_back, with_agonist
from amulett_gym.simulation.trajectory import Trajectory

SWITCH_WINDOW = 0.2
"""Time after a switch in which its effect on the position is looked for [s]."""

FIGURE_9 = "tension-10"
"""Its configuration: the paper says "with tension control" only. 10 N is well above the 5 N floor of the estimation."""


@dataclass(frozen=True)
class Switch:
    """One switch of the agonist, beside the same moments without it.

    Attributes
    ----------
    time : float
        When the control tick began in which the drives changed their roles [s].
    agonist : int
        The new one: +1 biceps, -1 triceps.
    force_jump : float
        By which the tension controller's feedback jumps: the estimated force of the string that is the antagonist from
        now on, minus that of the one that was, at the same moment [N].
    command_steps : tuple of float
        Changes of the biceps' and the triceps' position signal in this tick [deg].
    position_output_step : float
        Change of the position controller's output in this tick [deg], which both drives follow in any case.
    angle_step, angle_step_without : float
        Largest change of the joint angle in a tick, within `SWITCH_WINDOW` after the switch, with it and without [deg].
        If the switch made the position peak, the first would be clearly the larger one. Within this time the agonist
        may switch again.
    deviation : float
        Largest difference of the joint angle from that without the switch in this time [deg].
    without : Trajectory
        What the device does in this time if its agonist stays the one it was.
    """

    time: float
    agonist: int
    force_jump: float
    command_steps: tuple[float, float]
    position_output_step: float
    angle_step: float
    angle_step_without: float
    deviation: float
    without: Trajectory = field(repr=False)


@dataclass(frozen=True)
class SwitchingRun:
    """The movements of Figure 9.

    Attributes
    ----------
    trajectory : Trajectory
    switches : tuple of Switch
        In the order of time; empty if the agonist never changes.
    """

    trajectory: Trajectory
    switches: tuple[Switch, ...]


def switching_run(profile: Profile, readings: Readings, configuration: str = FIGURE_9) -> SwitchingRun:
    """Do three steps, there, back and there again, with tension control and an agonist that switches.

    Parameters
    ----------
    profile : Profile
        Of the device without readings.
    readings : Readings
        Taken as given, but for `agonist`: section 3.5 is about movements with switching enabled.
    configuration : str
        One of `tables.CONFIGURATIONS`.

    Raises
    ------
    AmulettError
        If the device cannot hold the starting posture.
    """
    device = apply_readings(profile, replace(readings, agonist="switching"))
    scenario = there_and_back(device, configuration, readings.eq6)
    trajectory = follow(start(device, configuration, [scenario], readings.eq6), MOVES_FROM + len(STEPS) * HOLD)
    again = start(device, configuration, [scenario], readings.eq6)
    switches = []
    for row in switch_rows(trajectory):
        again.advance(int(row - again.read("tick")[0]))
        stays = {+1: "biceps", -1: "triceps"}[int(trajectory["agonist"][row])]
        fixed = start(with_agonist(device, stays), configuration, [scenario], readings.eq6)
        fixed.set_state(again.get_state())
        switches.append(_switch(trajectory, int(row), follow(fixed, SWITCH_WINDOW)))
    return SwitchingRun(trajectory, tuple(switches))


def switching_numbers(profile: Profile, readings: Readings, configuration: str = FIGURE_9) -> tuple[Switch, ...]:
    """Return what every switch of the agonist does in these movements (see `switching_run`)."""
    return switching_run(profile, readings, configuration).switches


def _switch(trajectory: Trajectory, row: int, without: Trajectory) -> Switch:
    rows = min(len(without), len(trajectory) - row)
    angle, angle_without = (np.degrees(values)[:rows] for values in (trajectory["angle"][row:], without["angle"]))
    agonist, before = int(trajectory["agonist"][row + 1]), int(trajectory["agonist"][row])

    def estimate(antagonist_of: int) -> float:
        return float(trajectory[f"estimate_{ANTAGONIST[antagonist_of]}"][row])

    def step(name: str) -> float:
        return float(np.degrees(trajectory[name][row + 1] - trajectory[name][row]))

    return Switch(
        time=float(trajectory["time"][row]),
        agonist=agonist,
        force_jump=estimate(agonist) - estimate(before),
        command_steps=(step("command_biceps"), step("command_triceps")),
        position_output_step=step("position_output"),
        angle_step=_largest(np.diff(angle)),
        angle_step_without=_largest(np.diff(angle_without)),
        deviation=_largest(angle - angle_without),
        without=without,
    )


def _largest(values: NDArray[np.float64]) -> float:
    return float(np.abs(values).max(initial=0.0))
