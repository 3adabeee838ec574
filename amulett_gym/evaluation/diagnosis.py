"""Diagnosis of a device: short simulated movements that show whether the loop can control it.

The movements are holds over the workspace and a step each way, at the nominal tension and at the upper end of the
tension range: 14 arms for 6 s, which take less than a tenth of a second. The last 2 s, at rest, are judged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulett_gym import FAILURES
from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import BY_STIFFNESS, LOOPS, Control
from amulett_gym.tasks.scenario import Move, Scenario, pack
from amulett_gym.tasks.suites import WORKSPACE_DEG

SECONDS, RESTS = 6.0, 2.0
"""Length of the movements, and of the rest at their end that is judged [s]."""

MOST_SWITCHES = 1.0
"""Agonist switches of a resting arm [1/s]; shipped devices: none."""

MOST_SWING = 2.0
"""Peak to peak of a resting joint without drift [deg]: half the paper's error margin; shipped devices: up to 0.7."""

MOST_ERROR = 2.0
"""Mean error of a resting joint [deg], the paper's error margin; shipped devices: up to 0.13."""

MOST_SATURATED = 0.05
"""Share of the rest with a spring at the end of its table or a drive at its limit; shipped devices: 0."""

MOST_TENSION_ERROR = 0.1
"""Mean error of the antagonist's true tension at rest, as a share of its setpoint; shipped devices: up to 0.02."""

MOST_OVERSHOOT = 10.0
"""Overshoot of a step of 60 deg in a loop whose reference is smooth [deg]; shipped devices: up to 3."""

MOST_BELOW_FLOOR = 0.25
"""Share of the tension range below the force estimation's floor; testbed: 0.09, from 4 to 5 N."""

TENSION_FREE: tuple[Control, ...] = ("position-only", *BY_STIFFNESS, "minimal-motion")
"""Loops that do not hold the tension setpoint as the antagonist's tension: there it is not judged."""

Values = NDArray[np.float64]


class Finding(NamedTuple):
    """A fault of a device: its kind, the number that shows it, and a sentence with that number."""

    kind: str
    number: float
    text: str


def diagnose(
    profile: Profile, tension_range: tuple[float, float] = TENSION_RANGE, control: Control = "decentralized"
) -> list[Finding]:
    """Return the faults of a device in a control loop, by simulated short movements.

    Parameters
    ----------
    profile : Profile
    tension_range : tuple of float
        Tension setpoint at action -1 and +1 [N]; its upper end and the nominal tension are played.
    control : str
        The loop, one of `layout.CONTROLS`.

    Returns
    -------
    list of Finding
        At most one of each kind, from the movement that shows it most: ``force floor`` [N], ``cannot start`` [deg, the
        posture], ``fails`` [s, when], ``chatters`` [1/s], ``oscillates`` [deg], ``cannot hold`` [deg], ``overshoots``
        [deg], ``spring end`` and ``drive limit`` [share of the rest], ``tension`` [N]. Empty for a device on which the
        loop works. Only the paper's loop needs the force floor. In the loops of the literature the agonist has no
        role, so it may chatter; only they are judged by overshoot, since their reference is smooth. The tension is not
        judged in `TENSION_FREE`.

    Raises
    ------
    AmulettError
        If the loop is unknown, or the device cannot have it.
    """
    low, high = tension_range
    findings = []
    floor = profile.sensors.force_floor
    if control == "decentralized" and (floor - low) / (high - low) > MOST_BELOW_FLOOR:
        text = f"tensions below sensors.force_floor, {floor:g} N, are not estimated; the tension range begins at"
        findings.append(Finding("force floor", floor, f"{text} {low:g} N"))
    movements: list[tuple[str, float]] = []
    rows: list[NDArray[np.void]] = []
    single = Simulation(profile, 1, control)
    for tension in (profile.variable_stiffness.nominal_tension, high):
        for name, scenario in _movements(len(rows)):
            row = pack(scenario, profile)
            try:
                single.reset(row)
            except AmulettError as error:
                if not any(finding.kind == "cannot start" for finding in findings):
                    reason = str(error).partition(" ")[2].partition(" ")[2]  # without "scenario 0"
                    findings.append(
                        Finding("cannot start", scenario.initial_angle_deg, f"{name} cannot begin: it {reason}")
                    )
                continue
            movements.append((name, tension))
            rows.append(row)
    if rows:
        findings += _judge(_play(Simulation(profile, len(rows), control), np.concatenate(rows), movements), movements)
    silent = {"chatters"} if control in LOOPS else {"overshoots"}
    silent |= {"tension"} if control in TENSION_FREE else set()
    return [finding for finding in findings if finding.kind not in silent]


def _movements(seed: int) -> list[tuple[str, Scenario]]:
    """Return the movements in words and as scenarios, with noise seeds from `seed` on."""
    low, high = WORKSPACE_DEG
    ends = low + (high - low) / 6, high - (high - low) / 6
    found: list[tuple[str, float, list[Move]]]
    found = [(f"a hold at {angle:g} deg", float(angle), []) for angle in np.linspace(low, high, 5)]
    for begin, end in (ends, ends[::-1]):
        found.append((f"a step from {begin:g} to {end:g} deg", begin, [Move(time=0.5, angle_deg=end)]))
    return [
        (name, Scenario(initial_angle_deg=angle, moves=moves, noise_seed=seed + k))
        for k, (name, angle, moves) in enumerate(found)
    ]


def _play(simulation: Simulation, rows: NDArray[np.void], movements: list[tuple[str, float]]) -> dict[str, Values]:
    """Simulate the movements and return the quantities that are judged, one value for each movement."""
    simulation.reset(rows)
    tensions = np.array([tension for _, tension in movements])
    simulation.command_tension(tensions)
    period = simulation.control_period
    ticks = round(RESTS / period)
    simulation.advance(round(SECONDS / period) - ticks)
    switches = simulation.read("switch_count")
    limit = simulation.parameters["command_limit"][0]
    angle, tension = np.empty((ticks, len(rows))), np.empty((ticks, len(rows)))
    spring, drive = np.zeros(len(rows)), np.zeros(len(rows))
    for tick in range(ticks):
        simulation.advance(1)
        biceps, triceps = simulation.read("force_biceps"), simulation.read("force_triceps")
        angle[tick] = np.degrees(simulation.read("angle"))
        antagonist = np.where(simulation.read("agonist") > 0, triceps, biceps)
        tension[tick] = antagonist if simulation.loop is None else np.minimum(biceps, triceps)
        spring += np.maximum(biceps, triceps) > 0.999 * simulation.max_force
        commands = np.abs([simulation.read(f"command_{name}") for name in ("biceps", "triceps")])
        drive += commands.max(axis=0) > 0.999 * limit
    return {
        "failure": simulation.read("failure"),
        "time": simulation.read("tick") * period,
        "switches": (simulation.read("switch_count") - switches) / RESTS,
        "swing": np.ptp(angle - np.linspace(angle[0], angle[-1], ticks), axis=0),
        "error": np.abs(angle.mean(axis=0) - np.degrees(simulation.read("setpoint"))),
        "overshoot": np.degrees(simulation.read("overshoot")),
        "spring": spring / ticks,
        "drive": drive / ticks,
        "tension": tension.mean(axis=0),
        "tension_error": np.abs(tension.mean(axis=0) - tensions) / tensions,
    }


def _judge(played: dict[str, Values], movements: list[tuple[str, float]]) -> list[Finding]:
    """Return the findings, each from the movement that shows it most."""
    found = []
    failed = np.flatnonzero(played["failure"])
    if failed.size:
        first = failed[np.argmin(played["time"][failed])]
        reason, seconds = FAILURES[int(played["failure"][first])], float(played["time"][first])
        text = f"{_where(movements, first)} the device fails after {seconds:.2g} s: {reason}"
        found.append(Finding("fails", seconds, text))
    for kind, name, most, sentence in (
        ("chatters", "switches", MOST_SWITCHES, "the agonist of the resting arm switches {:.1f} times a second"),
        ("oscillates", "swing", MOST_SWING, "the resting joint swings by {:.1f} deg, peak to peak"),
        ("cannot hold", "error", MOST_ERROR, "the joint rests {:.1f} deg from its setpoint"),
        ("overshoots", "overshoot", MOST_OVERSHOOT, "the joint overshoots its setpoint by {:.1f} deg"),
        ("spring end", "spring", MOST_SATURATED, "a spring is at the end of its table for {:.0%} of the rest"),
        ("drive limit", "drive", MOST_SATURATED, "a drive is at command_limit_deg for {:.0%} of the rest"),
        ("tension", "tension_error", MOST_TENSION_ERROR, "the antagonist's tension is {:.1f} N"),
    ):
        values = np.where(played["failure"] == 0, played[name], 0.0)
        worst = int(np.argmax(values))
        if values[worst] > most:
            number = float(played["tension" if kind == "tension" else name][worst])
            text = f"{_where(movements, worst)} {sentence.format(number)}"
            allowed = f"{most:.0%}" if most < 1.0 else f"{most:g}"
            kept = "within" if kind == "tension" else "at most"
            found.append(Finding(kind, number, f"{text} (a sound loop: {kept} {allowed})"))
    return found


def _where(movements: list[tuple[str, float]], index: int) -> str:
    name, tension = movements[index]
    return f"in {name}, at {tension:g} N,"
