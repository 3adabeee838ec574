"""What switching the agonist does to the joint's position and to the force feedback (section 3.5, Figure 9).

Each switch is undone once: from the moment before it, the same device with the same noise goes on with the agonist that
it had. What then differs is what this switch does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from amulett_gym.evaluation.signals import ANTAGONIST, switch_rows
from amulett_gym.profile import Profile
from amulett_gym.simulation.trajectory import Trajectory
from amulett_gym.studies.paper.reproduction import Readings, apply_readings
from amulett_gym.studies.paper.runs import HOLD, MOVES_FROM, STEPS, follow, start, there_and_back, with_agonist

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
    force_jump : float
        By which the tension controller's feedback jumps: the estimated force of the string that is the antagonist from
        now on, minus that of the one that was, at the same moment [N].
    deviation : float
        Largest difference of the joint angle from that without the switch, within `SWITCH_WINDOW` after it [deg].
        Within this time the agonist may switch again.
    without : Trajectory
        What the device does in this time if its agonist stays the one it was.
    """

    time: float
    force_jump: float
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


def _switch(trajectory: Trajectory, row: int, without: Trajectory) -> Switch:
    rows = min(len(without), len(trajectory) - row)
    angle, angle_without = (np.degrees(values)[:rows] for values in (trajectory["angle"][row:], without["angle"]))
    after, before = (f"estimate_{ANTAGONIST[int(trajectory['agonist'][place])]}" for place in (row + 1, row))
    return Switch(
        time=float(trajectory["time"][row]),
        force_jump=float(trajectory[after][row] - trajectory[before][row]),
        deviation=float(np.abs(angle - angle_without).max(initial=0.0)),
        without=without,
    )
