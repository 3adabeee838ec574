"""The paper's published numbers as data: Tables 1-5, parameters of figures, protocol.

Units are the paper's where it prints one. For Table 5 it prints none.
"""

from __future__ import annotations

from dataclasses import dataclass

from amulett_gym.errors import AmulettError, unknown

DEVICES = ("simulation", "testbed")
"""Profiles that stand for the paper's two devices, in its order; it calls the testbed's rows "Measurement"."""

CONFIGURATIONS = ("position-only", "tension-5", "tension-10", "variable")
"""Control configurations, in the order of the rows of Tables 2-5, once for each device."""

DRIVES = ("biceps", "triceps")


@dataclass(frozen=True)
class Cell:
    """One number of Tables 2-5; rows count from 1 below the header.

    `profile` is one of `DEVICES`, `configuration` one of `CONFIGURATIONS`, `metric` is ``rise_time``,
    ``position_ise``, ``tension_ise`` or ``isav``, `drive` one of `DRIVES` for an ISAV, else None. `unit` is empty where
    the paper prints none.
    """

    table: int
    row: int
    profile: str
    configuration: str
    metric: str
    drive: str | None
    value: float
    unit: str


@dataclass(frozen=True)
class Parameter:
    """A number that the paper prints about its controllers, its damping or eq. 6.

    `source` is a table and row, or a figure; `profile` one of `DEVICES`, or None for both; `key` the place in a
    profile, such as ``loop.position.kp``; `unit` is empty if dimensionless.
    """

    source: str
    profile: str | None
    key: str
    value: float
    unit: str


@dataclass(frozen=True)
class Protocol:
    """The experiments (section 2.2). T of eqs. 7 and 8 is not printed."""

    start_deg: float = 0.0  # of the position setpoint's step
    target_deg: float = 45.0
    repetitions_simulation: int = 1  # step responses of which the tables print the mean
    repetitions_testbed: int = 10
    position_margin_deg: float = 2.0  # of the rise time
    tension_margin: float = 0.05  # of the string force, a fraction of its setpoint
    position_only_offset_deg: float = 20.0  # opposite turn of both drives without tension controller
    force_floor: float = 5.0  # only forces estimated above it were used on the testbed (Figure 5b) [N]
    damping_mass: float = 0.2  # weight of the decay experiment behind Figure 3 [kg] (section 2.1)
    damping_arm: float = 0.143  # its distance from the joint [m]


PROTOCOL = Protocol()


def repetitions(profile: str) -> int:
    """Return the number of step responses whose mean the tables print, on one of `DEVICES`."""
    return PROTOCOL.repetitions_testbed if profile == "testbed" else PROTOCOL.repetitions_simulation


TENSION_SETPOINT = {"tension-5": 5.0, "tension-10": 10.0}
"""Setpoint of the two configurations that hold one [N] (section 2.2)."""

# One value for each of CONFIGURATIONS.
_TABLES: tuple[tuple[int, str, str | None, str, str, tuple[float, float, float, float]], ...] = (
    (2, "rise_time", None, "s", "simulation", (0.26, 0.25, 0.25, 0.24)),
    (2, "rise_time", None, "s", "testbed", (1.09, 1.84, 1.19, 2.43)),
    (3, "position_ise", None, "deg^2 s", "simulation", (116.21, 119.58, 117.11, 115.12)),
    (3, "position_ise", None, "deg^2 s", "testbed", (579.23, 588.0, 650.57, 585.07)),
    (4, "tension_ise", None, "N^2 s", "simulation", (11.17, 7.82, 0.15, 5.45)),
    (4, "tension_ise", None, "N^2 s", "testbed", (0.98, 0.2, 0.5, 2.03)),
    (5, "isav", "biceps", "", "simulation", (89042.2, 33263.4, 901.25, 36866.3)),
    (5, "isav", "triceps", "", "simulation", (1.25141e8, 1.12419e8, 9.7497e7, 9.92114e7)),
    (5, "isav", "biceps", "", "testbed", (18.61, 17.22, 49.14, 197.06)),
    (5, "isav", "triceps", "", "testbed", (5998.15, 6485.63, 7237.26, 5726.74)),
)

TABLES_2_TO_5 = tuple(
    Cell(
        table, 1 + k + len(CONFIGURATIONS) * DEVICES.index(profile), profile, configuration, metric, drive, value, unit
    )
    for table, metric, drive, unit, profile, values in _TABLES
    for k, (configuration, value) in enumerate(zip(CONFIGURATIONS, values, strict=True))
)
"""All 40 numbers: 8 rows each of Tables 2, 3 and 4, and 8 rows of two drives of Table 5."""


def _gains(
    profile: str, first_row: int, controller: str, unit: str, values: tuple[float, float, float]
) -> tuple[Parameter, ...]:
    units = {"kp": unit, "ki": f"{unit}/s", "kd": f"{unit} s"}
    return tuple(
        Parameter(f"Table 1, row {first_row + i}", profile, f"loop.{controller}.{gain}", value, units[gain])
        for i, (gain, value) in enumerate(zip(units, values, strict=True))
    )


TABLE_1 = (
    *_gains("simulation", 1, "position_only", "deg/deg", (20.0, 22.5, 0.75)),
    *_gains("simulation", 4, "position", "deg/deg", (20.0, 22.5, 0.75)),
    *_gains("simulation", 7, "tension", "deg/N", (19.5, 25.0, 0.5)),
    *_gains("testbed", 10, "position_only", "deg/deg", (0.095, 5.94, 0.02)),
    *_gains("testbed", 13, "position", "deg/deg", (0.11, 5.8, 0.0137)),
    *_gains("testbed", 16, "tension", "deg/N", (4.8, 90.0, 0.1)),
)
"""PID gains; the paper prints no units for them. They follow from what goes in and what comes out, in degrees."""

FIGURE_3 = tuple(
    Parameter("Figure 3", None, f"damping.{key}", value, unit)
    for key, value, unit in (
        ("a", -1.79094945, "1/s"),
        ("b", -1.00214543, "1/N"),
        ("c", -5.25850838, ""),
        ("d", 5.44504523, "1/s"),
    )
)
"""``a exp(b x + c) + d`` as printed, x the preload force [N]; if ``b (x + c)`` was meant, c is in newtons."""

FIGURE_6 = tuple(
    Parameter("Figure 6", None, f"variable_stiffness.{key}", value, unit)
    for key, value, unit in (
        ("nominal_tension", 10.0, "N"),
        ("minimum_tension", 4.0, "N"),
        ("error_offset_deg", 30.0, "deg"),
    )
)


def published(metric: str, profile: str, configuration: str, drive: str | None = None) -> Cell:
    """Return one number of Tables 2-5, by the names of `Cell`; `drive` is needed for ``isav`` alone.

    Raises AmulettError if a name is unknown, or `drive` is missing or superfluous.
    """
    for kind, name, choices in (
        ("metric", metric, {cell.metric for cell in TABLES_2_TO_5}),
        ("profile", profile, DEVICES),
        ("configuration", configuration, CONFIGURATIONS),
    ):
        if name not in choices:
            raise unknown(kind, name, choices)
    key = (metric, profile, configuration, drive)
    for cell in TABLES_2_TO_5:
        if (cell.metric, cell.profile, cell.configuration, cell.drive) == key:
            return cell
    allowed = " or ".join(DRIVES) if metric == "isav" else "None"
    raise AmulettError(f"drive of '{metric}' is {drive!r}; it has to be {allowed}")


def printed_parameters(profile: str) -> tuple[Parameter, ...]:
    """Return what Table 1, Figure 3 and Figure 6 print about one device.

    Raises AmulettError if the profile is none of `DEVICES`.
    """
    if profile not in DEVICES:
        raise unknown("profile", profile, DEVICES)
    return tuple(item for item in (*TABLE_1, *FIGURE_3, *FIGURE_6) if item.profile in (None, profile))
