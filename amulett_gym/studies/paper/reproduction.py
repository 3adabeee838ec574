"""Comparison of Tables 2-5 with the step responses of our devices.

The paper leaves several sentences open (see `Readings`). One set of readings holds for all rows; each alternative is
tried alone, which shows the rows that it explains better. Nothing is tuned per row.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulett_gym import FAILURES
from amulett_gym.control.agonist import BICEPS
from amulett_gym.errors import unknown
from amulett_gym.identification.parameters import spring_end_changes
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import Control
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.studies.paper.tables import (
    CONFIGURATIONS,
    DEVICES,
    DRIVES,
    PROTOCOL,
    TABLES_2_TO_5,
    TENSION_SETPOINT,
    Cell,
)
from amulett_gym.tasks.scenario import Move, Scenario, pack
from amulett_gym.tasks.suites import START

Values = NDArray[np.float64]

_TO_DEGREES = float(np.degrees(1.0))

MOVES_FROM = 2.0
"""Time of the first of several setpoint steps [s]: Figure 7 takes the mean force until then as its setpoint."""

STEPS = (PROTOCOL.target_deg, PROTOCOL.start_deg, PROTOCOL.target_deg)
"""Setpoints of several successive steps [deg]: Figures 7 and 9 show the first three."""

HOLD = 5.0
"""Time for which each of several setpoints is held [s]: twice the slowest rise time of Table 2."""

STEPS_TIME = MOVES_FROM + len(STEPS) * HOLD
"""Duration of all these steps [s]."""

MEASUREMENT_TIME = 5.0
"""T of eqs. 7 and 8 [s], which the paper does not print.

By then the simulation is at rest: a longer T changes none of its numbers. On the testbed the noise lets tension ISEs
and ISAVs grow without end, and an arm at 5 N, the floor of the estimation, leaves the margin again; `motion.vary`
returns how many numbers other times explain. The paper's slowest step settles in 2.4 s.
"""


@dataclass(frozen=True)
class Readings:
    """How the sentences that the paper leaves open are taken; the defaults hold for all rows.

    eq6
        Eq. 6 with the shift by d_offset that its text describes, or as printed.
    damping
        Figure 3's fit with the parentheses that its text needs, or as printed.
    preload
        The string force on which the damping depends: "the preload force" of Figure 3 was alike in both strings.
    wiring
        Input of the antagonist: position plus tension controller, as section 2.2 says, or the tension controller.
    agonist
        The agonist of the steps, which all flex: the biceps throughout, since section 3.5 alone shows "movements with
        enabled switching"; or the drive whose spring is deflected more.
    floor
        The replacement of forces estimated below 5 N on the testbed. ``hold`` is the nearest to the words. With it or
        ``clamp`` noise lets the tension at a setpoint of 5 N run down (`motion.vary`).
    derivative_on
        The signal that the controllers differentiate.
    rise_time
        Time of the last entry into the error margin, or of the first, as the paper's words say.
    tension_error
        The force signal of eq. 7: the one that a device records (simulation: force, testbed: estimation); or the
        estimation, which Figure 8 shows of both; or the true force.
    isav_unit
        Unit of the drives' position signals in eq. 8.
    isav_kick
        The drives whose ISAV includes the setpoint's jump, which passes through the position controller's proportional
        and derivative term. As section 2.2 is written, both drives receive it; but one column of Table 5 is 29 to
        108 000 times smaller than the other.
    spring_end
        What ends the spring's curve at the end of its table, of which the paper says nothing: the force is held there
        (``held``), however far the string is pulled, as in a look-up table that is clipped; the law goes on
        (``continued``); a stop behind the spring takes over (``hard-stop``); or the law goes on and drives stall
        (``stall``). It limits the torque at the joint, and so decides the simulated steps.
    isav_columns
        Whether Table 5's columns are headed by the other drive's name: the agonist of a flexion is the biceps, and
        receives the jump, but the small numbers are headed "biceps".
    """

    eq6: Literal["text", "printed"] = "text"
    damping: Literal["shifted", "printed"] = "shifted"
    preload: Literal["mean", "smaller"] = "mean"
    wiring: Literal["sum", "tension_only"] = "sum"
    agonist: Literal["biceps", "switching"] = "biceps"
    floor: Literal["clamp", "hold", "ignore"] = "clamp"
    derivative_on: Literal["error", "measurement"] = "error"
    rise_time: Literal["settling", "first-entry"] = "settling"
    tension_error: Literal["recorded", "estimated", "true"] = "recorded"
    isav_unit: Literal["deg", "rad"] = "rad"
    isav_kick: Literal["agonist", "both", "neither"] = "agonist"
    isav_columns: Literal["swapped", "as-printed"] = "swapped"
    spring_end: Literal["held", "continued", "hard-stop", "stall"] = "held"


ALTERNATIVES: tuple[tuple[str, str], ...] = (
    ("eq6", "printed"),
    ("damping", "printed"),
    ("preload", "smaller"),
    ("wiring", "tension_only"),
    ("agonist", "switching"),
    ("floor", "hold"),
    ("floor", "ignore"),
    ("derivative_on", "measurement"),
    ("rise_time", "first-entry"),
    ("tension_error", "estimated"),
    ("tension_error", "true"),
    ("isav_unit", "deg"),
    ("isav_kick", "both"),
    ("isav_kick", "neither"),
    ("isav_columns", "as-printed"),
    ("spring_end", "continued"),
    ("spring_end", "hard-stop"),
    ("spring_end", "stall"),
)
"""Readings that are tried, each alone, instead of the default."""

BOUNDS = {
    ("rise_time", "simulation"): (0.85, 1.15),
    ("rise_time", "testbed"): (0.65, 1.35),
    ("position_ise", "simulation"): (0.95, 1.05),
    ("position_ise", "testbed"): (0.95, 1.05),
    ("tension_ise", "simulation"): (0.75, 1.25),
    ("tension_ise", "testbed"): (0.75, 1.25),
    ("isav", "simulation"): (1 / 3, 3.0),
    ("isav", "testbed"): (1 / 3, 3.0),
}
"""Metric and device -> least and largest ratio of ours to the paper's number at which that number is explained."""

SPRING_END_VALUES = {"stop_stiffness": 4e4, "stall_torque": 0.3}
"""Of the readings `spring_end` without a fit: a braided string of 0.25 m behind the spring [N/m]; the load at which a
force of 21.7 N on the shipped drive pulley stalls [N m], a small gear motor's."""

SAME = 0.01
"""Distances from the paper that differ by less are the same."""


@dataclass(frozen=True)
class Response:
    """Metrics of a configuration's step responses under every reading; arrays have the shape (repetitions,)."""

    rise_time: dict[str, Values]  # by the choices of `Readings.rise_time` [s]; NaN if not reached
    position_ise: Values  # [deg2 s]
    tension_ise: dict[str, Values]  # by the choices of `Readings.tension_error` [N2 s]
    isav: dict[tuple[str, str], Values]  # by drive, and ``with`` or ``without`` the jump at the step [deg2/s]
    failures: tuple[str, ...]  # one reason for each repetition that failed


@dataclass(frozen=True)
class Row:
    """One number of the paper with ours, the mean over the repetitions, and its standard deviation `spread`.

    A number that does not exist is None; `trouble` is the reason, and `failed` is true if a device failed. `ratio` is
    ours over the paper's; it is explained if within `BOUNDS`.
    """

    cell: Cell
    ours: float | None
    spread: float | None
    ratio: float | None
    unit: str
    explained: bool
    trouble: str = ""
    failed: bool = False

    @property
    def distance(self) -> float:
        """Absolute logarithm of the ratio; infinite where there is no number."""
        return abs(math.log(self.ratio)) if self.ratio else math.inf


@dataclass(frozen=True)
class Reproduction:
    """One row for each of `tables.TABLES_2_TO_5` under the default readings, and under each of `ALTERNATIVES`."""

    profiles: dict[str, Profile]
    readings: Readings
    rows: tuple[Row, ...]
    alternatives: dict[tuple[str, str], tuple[Row, ...]]


def reproduce(profiles: Mapping[str, Profile] | None = None) -> Reproduction:
    """Run the paper's protocol on both devices and compare all rows under all readings.

    Parameters
    ----------
    profiles : mapping of str to Profile, optional
        Devices to use instead of the shipped ones, by `tables.DEVICES`.

    Raises
    ------
    AmulettError
        If a device cannot hold the posture at which a configuration starts.
    """
    devices = {name: load_profile(name) for name in DEVICES} | dict(profiles or {})
    readings = Readings()
    responses: dict[Readings, dict[tuple[str, str], Response]] = {}

    def rows(taken: Readings) -> tuple[Row, ...]:
        simulated = replace(Readings(), **{name: getattr(taken, name) for name in _SIMULATED})
        if simulated not in responses:
            responses[simulated] = measure(devices, simulated)
        return compare(responses[simulated], taken)

    alternatives = {(name, choice): rows(_with(readings, name, choice)) for name, choice in ALTERNATIVES}
    return Reproduction(devices, readings, rows(readings), alternatives)


_SIMULATED = ("eq6", "damping", "preload", "wiring", "agonist", "floor", "derivative_on", "spring_end")
"""Readings that change what the device does; the others change how it is measured."""


def measure(
    devices: Mapping[str, Profile],
    readings: Readings,
    repetitions: int = PROTOCOL.repetitions_testbed,
    duration: Mapping[str, float] | None = None,
    first_key: int = 1,
) -> dict[tuple[str, str], Response]:
    """Return the step responses of all configurations on both devices, by device and configuration.

    Parameters
    ----------
    devices : mapping of str to Profile
        By `tables.DEVICES`.
    repetitions : int
        On the testbed; the simulation has nothing to repeat.
    duration : mapping of str to float, optional
        T of each device [s]; `MEASUREMENT_TIME` if None.
    first_key : int
        Key of the first repetition's sensor noise; the others' follow.

    Raises
    ------
    AmulettError
        If a device cannot hold the posture at which a configuration starts.
    """
    counts = {"simulation": PROTOCOL.repetitions_simulation, "testbed": repetitions}
    responses = {}
    for name in DEVICES:
        device = apply_readings(devices[name], readings)
        time = MEASUREMENT_TIME if duration is None else duration[name]
        for configuration in CONFIGURATIONS:
            responses[name, configuration] = step_response(
                device, configuration, readings.eq6, counts[name], time, first_key
            )
    return responses


def apply_readings(profile: Profile, readings: Readings) -> Profile:
    """Return a profile with the readings that concern the device and its loop.

    A stop or a stall torque that the profile does not have is that of `SPRING_END_VALUES`.
    """
    own = {"stop_stiffness": profile.spring.stop_stiffness, "stall_torque": profile.drives.stall_torque}
    given = SPRING_END_VALUES | {name: value for name, value in own.items() if value is not None}
    derivative = {"derivative_on": readings.derivative_on}
    changes = {
        "damping": {"fit": readings.damping, "preload": readings.preload},
        "sensors": {"below_floor": readings.floor},
        "loop": {
            "wiring": readings.wiring,
            "agonist": readings.agonist,
            "position": derivative,
            "tension": derivative,
            "position_only": derivative,
        },
    }
    return load_profile(merge(merge(profile.model_dump(), changes), spring_end_changes(readings.spring_end, **given)))


def paper_step(profile: Profile, configuration: str, eq6: str = "text", noise_seed: int = 1) -> Scenario:
    """Return the paper's step from 0 to 45 deg, from rest at the configuration's own tension setpoint.

    Raises AmulettError if the configuration is none of `tables.CONFIGURATIONS`.
    """
    if configuration not in CONFIGURATIONS:
        raise unknown("configuration", configuration, CONFIGURATIONS)
    law = profile.variable_stiffness
    at_rest = law.nominal_tension if eq6 == "text" else law.minimum_tension  # eq. 6 at an error of zero
    return Scenario(
        initial_angle_deg=PROTOCOL.start_deg,
        initial_tension=TENSION_SETPOINT.get(configuration, at_rest),
        moves=[Move(time=START, angle_deg=PROTOCOL.target_deg)],
        measure_from=START,
        noise_seed=noise_seed,
    )


def there_and_back(profile: Profile, configuration: str, eq6: str = "text") -> Scenario:
    """Return three successive steps of the paper, to 45 deg, back, and to 45 deg again, each held for `HOLD`.

    Parameters
    ----------
    configuration : str
        One of `tables.CONFIGURATIONS`; its tension is that of the start.
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.
    """
    moves = [Move(time=MOVES_FROM + k * HOLD, angle_deg=angle) for k, angle in enumerate(STEPS)]
    return paper_step(profile, configuration, eq6).model_copy(update={"moves": moves, "measure_from": MOVES_FROM})


def start(profile: Profile, configuration: str, scenarios: Sequence[Scenario], eq6: str = "text") -> Simulation:
    """Return devices in one of the paper's configurations, each at the start of a scenario.

    Parameters
    ----------
    profile : Profile
        With the readings applied (`reproduction.apply_readings`).
    configuration : str
        One of `tables.CONFIGURATIONS`.
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.

    Raises
    ------
    AmulettError
        If the device cannot hold a scenario's starting posture.
    """
    control: Control = "position-only" if configuration == "position-only" else "decentralized"
    law = {"text": "eq6", "printed": "eq6-printed"}[eq6] if configuration == "variable" else "agent"
    simulation = Simulation(profile, len(scenarios), control, law)
    simulation.reset(np.concatenate([pack(scenario, profile) for scenario in scenarios]))
    if configuration in TENSION_SETPOINT:
        simulation.command_tension(TENSION_SETPOINT[configuration])
    return simulation


def with_agonist(profile: Profile, agonist: str) -> Profile:
    """Return a profile whose agonist is another one: ``"switching"``, ``"biceps"`` or ``"triceps"``."""
    return load_profile(merge(profile.model_dump(), {"loop": {"agonist": agonist}}))


def follow(simulation: Simulation, duration: float) -> Trajectory:
    """Record what a single device does for `duration` seconds, or until it fails."""
    trajectory = record(simulation, round(duration / simulation.control_period))
    # The clock of a device that failed stands still.
    rows = int(trajectory["tick"][-1] - trajectory["tick"][0]) + 1
    signals = {name: values[:rows] for name, values in trajectory.signals.items()}
    return Trajectory(trajectory.profile, trajectory.control_period, signals)


def antagonist_force(simulation: Simulation, duration: float, estimated: bool) -> tuple[Values, Values]:
    """Record the force of each device's antagonist string, and its setpoint, for `duration` seconds.

    Returns
    -------
    force, setpoint : ndarray, shape (ticks, devices)
        As they are when each control tick begins, with the roles and the setpoint of that tick [N].
    """
    kind = "estimate" if estimated else "force"
    names = ("agonist", f"{kind}_biceps", f"{kind}_triceps", "tension_setpoint")
    ticks = round(duration / simulation.control_period)
    rows = {name: np.empty((ticks + 1, simulation.num_devices)) for name in names}
    for tick in range(ticks + 1):
        if tick:
            simulation.advance(1)
        for name, values in rows.items():
            values[tick] = simulation.read(name)
    agonist, biceps, triceps, setpoint = rows.values()
    return np.where(agonist[1:] == BICEPS, triceps[:-1], biceps[:-1]), setpoint[1:]


def step_response(
    profile: Profile,
    configuration: str,
    eq6: str = "text",
    repetitions: int = 1,
    duration: float = MEASUREMENT_TIME,
    first_key: int = 1,
) -> Response:
    """Do the paper's step in one configuration.

    Parameters
    ----------
    configuration : str
        One of `tables.CONFIGURATIONS`.
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.
    repetitions : int
        They differ by their sensor noise.
    duration : float
        T of eqs. 7 and 8, from the setpoint step on [s].
    first_key : int
        Key of the first repetition's noise; the others' follow.

    Raises
    ------
    AmulettError
        If the configuration is unknown or the device cannot hold its starting posture.
    """
    scenarios = [paper_step(profile, configuration, eq6, key) for key in range(first_key, first_key + repetitions)]
    simulation = start(profile, configuration, scenarios, eq6)
    period = simulation.control_period
    simulation.advance(math.ceil(START / period - 1e-9) + round(duration / period))
    read = simulation.read
    isav = {(drive, "with"): read(f"isav_{drive}") * _TO_DEGREES**2 for drive in DRIVES}
    isav |= {(drive, "without"): read(f"effort_{drive}") * _TO_DEGREES**2 for drive in DRIVES}
    return Response(
        rise_time={
            "first-entry": np.where(read("rise_count") > 0, read("rise_sum"), math.nan),
            "settling": read("inside_since") - read("step_start"),
        },
        position_ise=read("position_ise") * _TO_DEGREES**2,
        tension_ise={"true": read("tension_ise"), "estimated": read("tension_ise_estimated")},
        isav=isav,
        failures=tuple(FAILURES[code] for code in read("failure").tolist() if code),
    )


def compare(responses: Mapping[tuple[str, str], Response], readings: Readings) -> tuple[Row, ...]:
    """Return every number of Tables 2-5 with ours, measured according to `readings`."""
    return tuple(_row(cell, responses[cell.profile, cell.configuration], readings) for cell in TABLES_2_TO_5)


def explained(rows: Iterable[Row]) -> dict[int, tuple[int, int]]:
    """Return how many rows of each table are explained, and how many there are, by the table's number."""
    tables: dict[int, list[bool]] = {}
    for row in rows:
        tables.setdefault(row.cell.table, []).append(row.explained)
    return {table: (sum(flags), len(flags)) for table, flags in tables.items()}


def moved(rows: Iterable[Row], taken: Iterable[Row]) -> list[str]:
    """Return for each row whether it is ``nearer`` to the paper than as taken, ``farther`` from it, or the ``same``."""
    return [_moved(row, default) for row, default in zip(rows, taken, strict=True)]


def best_reading(reproduction: Reproduction, index: int) -> tuple[tuple[str, str] | None, Row]:
    """Return the alternative that brings a row nearest to the paper, None for the default readings, and that row.

    Differences below 1 % do not count: then the default stays, or the first of `ALTERNATIVES`.
    """
    best: tuple[tuple[str, str] | None, Row] = (None, reproduction.rows[index])
    for key, rows in reproduction.alternatives.items():
        if rows[index].distance < best[1].distance - SAME:
            best = key, rows[index]
    return best


def _moved(row: Row, default: Row) -> str:
    if row.distance < default.distance - SAME:
        return "nearer"
    return "farther" if row.distance > default.distance + SAME else "same"


def _row(cell: Cell, response: Response, readings: Readings) -> Row:
    values, unit = _select(cell, response, readings)
    trouble = ""
    if response.failures:
        trouble = f"{len(response.failures)} of {values.size} failed: {response.failures[0]}"
    elif missing := int(np.isnan(values).sum()):
        trouble = f"{missing} of {values.size} did not reach the error margin within T"
    if trouble:
        return Row(cell, None, None, None, unit, False, trouble, failed=bool(response.failures))
    ours = float(values.mean())
    ratio = ours / cell.value
    low, high = BOUNDS[cell.metric, cell.profile]
    spread = float(values.std(ddof=1)) if values.size > 1 else None
    return Row(cell, ours, spread, ratio, unit, low <= ratio <= high)


def our_drive(column: str, readings: Readings) -> str:
    """Return the drive whose ISAV is compared with a column of Table 5, both by names of `DRIVES`."""
    return DRIVES[1 - DRIVES.index(column)] if readings.isav_columns == "swapped" else column


def _select(cell: Cell, response: Response, readings: Readings) -> tuple[Values, str]:
    """Return our values of a cell and their unit, measured as `readings` say."""
    if cell.metric == "rise_time":
        return response.rise_time[readings.rise_time], cell.unit
    if cell.metric == "position_ise":
        return response.position_ise, cell.unit
    if cell.metric == "tension_ise":
        recorded = "true" if cell.profile == "simulation" else "estimated"
        source = recorded if readings.tension_error == "recorded" else readings.tension_error
        return response.tension_ise[source], cell.unit
    drive = our_drive(str(cell.drive), readings)
    kick = readings.isav_kick == "both" or (readings.isav_kick == "agonist" and drive == "biceps")
    values = response.isav[drive, "with" if kick else "without"]
    if readings.isav_unit == "rad":
        values = values / _TO_DEGREES**2
    return values, f"{readings.isav_unit}^2/s"


def _with(readings: Readings, name: str, choice: str) -> Readings:
    changes: dict[str, Any] = {name: choice}
    return replace(readings, **changes)
