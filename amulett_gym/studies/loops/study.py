"""The paper's step in each control loop, with the trade-off between the joint's error and the drives' motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import Protocol, Results, evaluate, play_alone
from amulett_gym.gains import group_name
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.table import Table
from amulett_gym.settings import merge
from amulett_gym.simulation.layout import LOOPS, Control, unfit_loops
from amulett_gym.simulation.trajectory import Trajectory

SUITE = "paper-step"
DURATION = 5.0  # [s]
TENSION = 10.0  # [N], the paper's nominal tension, the same in all loops

TIMES = (0.1, 0.15, 0.21, 0.3, 0.45, 0.7, 1.0, 1.5)
"""Reference times of the trade-off [s]."""

REFERENCES = ("minimum-jerk", "first-order")
"""Shapes of the reference in the trade-off: the smoothest, and the one with the best trade-off in closed form."""

JUMP = 45.0  # [deg], the paper's step

CONSTANTS = (5.0, 6.0, 8.0, 10.0, 12.0, 15.0)
"""Constant tensions of the trade-off in the paper's loop [N]."""

COLUMNS = (
    *("rise_time", "settling_time", "overshoot", "position_ise", "tension_ise", "isav_biceps", "isav_triceps"),
    *("drive_effort", "drive_work", "resting_stiffness", "push_deflection"),
)
"""Metrics of the table: those of the paper's Tables 2 to 5, and those in which loops differ most."""


def contenders(loops: Iterable[str] = LOOPS) -> list[str]:
    """Return the compared contenders: eq. 6 and a constant in the paper's loop, and the same constant in the others."""
    return ["eq6", f"constant:{TENSION:g}", *(f"{loop}/constant:{TENSION:g}" for loop in loops)]


@dataclass(frozen=True)
class Study:
    """What was measured.

    Attributes
    ----------
    results : Results
        Of `contenders`, paired.
    steps : dict of str to Trajectory
        The first scenario under each of them.
    fronts : dict of str to list of dict
        Loop -> means for each of `REFERENCES` and `TIMES`; ``"decentralized"`` -> means for each of `CONSTANTS`.
    skipped : dict of str to str
        Loop that the device does not fit -> the reason (`unfit_loops`).
    """

    results: Results
    steps: dict[str, Trajectory]
    fronts: dict[str, list[dict[str, Any]]]
    skipped: dict[Control, str] = field(default_factory=dict)

    def content(self) -> dict[str, Any]:
        """Return the numbers as plain data.

        ``means`` are over the repetitions that have a value; ``counted`` is their number.
        """
        every = self.results.values.items()
        means = {name: {key: _mean(values[key]) for key in METRICS if key in values} for name, values in every}
        counted = {name: {key: _counted(values[key]) for key in METRICS if key in values} for name, values in every}
        protocol = self.results.protocol
        described = {key: getattr(protocol, key) for key in ("suite", "split", "seed", "episodes", "duration")}
        return {"profile": protocol.profile.name, **described, "means": means, "counted": counted} | {
            "fronts": self.fronts,
            "skipped": dict(self.skipped),
        }


def measure(
    profile: str | Profile = "testbed",
    episodes: int = 20,
    seed: int = 0,
    report: Callable[[str], object] = lambda part: None,
) -> Study:
    """Play the paper's step in each loop that the device fits, and each trade-off.

    Parameters
    ----------
    profile : str or Profile
    episodes : int
        Repetitions, which differ in the sensors' noise.
    seed : int
    report : callable
        Called with the name of each finished part; there are `parts`.

    Raises
    ------
    AmulettError
        If a name is unknown.
    """
    device = load_profile(profile)
    skipped = unfit_loops(device)
    loops = [loop for loop in LOOPS if loop not in skipped]
    names = contenders(loops)
    results = evaluate(names, SUITE, device, episodes, seed, duration=DURATION)
    report("comparison")
    steps = {}
    for name in names:
        steps[name] = record_episode(name, results.protocol).trajectory
        report(name)
    fronts: dict[str, list[dict[str, Any]]] = {}
    fronts["decentralized"] = [_means(results.protocol, device, f"constant:{tension:g}") for tension in CONSTANTS]
    report("trade-off of decentralized")
    for loop in loops:
        fronts[loop] = [
            {"reference": shape, "reference_time": time}
            | _means(results.protocol, _with_reference(device, loop, shape, time), f"{loop}/constant:{TENSION:g}")
            for shape in REFERENCES
            for time in TIMES
        ]
        report(f"trade-off of {loop}")
    return Study(results, steps, fronts, skipped)


def parts(profile: Profile) -> int:
    """Return the number of parts of `measure` with a device."""
    loops = [loop for loop in LOOPS if loop not in unfit_loops(profile)]
    return 1 + len(contenders(loops)) + 1 + len(loops)


def table(study: Study) -> Table:
    """Return the means of `COLUMNS` for each contender; the note names the loops that were skipped."""
    protocol, some_missing = study.results.protocol, False
    shown = [METRICS[key] for key in COLUMNS]
    rows = []
    for name, values in study.results.values.items():
        row = [name]
        for metric in shown:
            count = _counted(values[metric.key])
            missing = count < protocol.episodes
            some_missing |= missing
            row.append(metric.text(_mean(values[metric.key])) + (f" ({count}/{protocol.episodes})" if missing else ""))
        rows.append(row)
    note = (
        f"Means of {protocol.episodes} repetitions of {protocol.suite} ({protocol.split}, from seed {protocol.seed}, "
        f"{protocol.duration:g} s) on the {protocol.profile.name}. Push deflection: on {study.results.push_suite}."
    )
    if some_missing:
        note += (
            f" (n/{protocol.episodes}): the mean of n repetitions; the others have no such value, for example because "
            "they did not settle."
        )
    for loop, reason in study.skipped.items():
        note += f" Without {loop}, which does not fit this device: {reason}."
    return Table("", ("contender", *(metric.heading for metric in shown)), rows, note)


def _counted(values: Any) -> int:
    return int((~np.isnan(values)).sum())


def _mean(values: Any) -> float | None:
    reached = values[~np.isnan(values)]
    return float(reached.mean()) if reached.size else None


def _means(protocol: Protocol, profile: Profile, name: str) -> dict[str, float]:
    run = play_alone(replace(protocol, profile=profile), parse_contender(name))
    return {key: float(run.values[key].mean()) for key in ("position_ise", "drive_effort", "drive_work", "cost")}


def _with_reference(profile: Profile, loop: str, shape: str, time: float) -> Profile:
    gains = {group_name(loop): {"reference": shape, "reference_time": time}}
    return load_profile(merge(profile.model_dump(), {"loops": gains}))


def least_ise(profile: Profile, drive_effort: float) -> float:
    """Return the least position ISE [deg2 s] of a jump of `JUMP` at a drive effort [deg2/s].

    It holds where the joint follows the mean of both drives, x = (e_1 + e_2) R_1 / (2 R_2), and does not move before
    the jump: an exponential answer with time constant T has an ISE of J^2 T/2 and an effort of (J R_2/R_1)^2 / T.
    """
    turn = JUMP * profile.plant.joint_pulley_radius / profile.plant.drive_pulley_radius
    return JUMP**2 / 2.0 * turn**2 / drive_effort
