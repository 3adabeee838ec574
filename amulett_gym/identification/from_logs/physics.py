"""The parameters of one device that a log may see, and a device with other values of them.

They are keys of the profile, or products of keys: inertia, radii, spring, damping and drives. `Nuisance` ones belong to
a log's recording, such as a sensor's offset, and do not enter the profile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulett_gym.model.plant import inertia
from amulett_gym.model.spring import assembly_curve
from amulett_gym.profile import Damping, Drives, Plant, PointMass, Profile, Spring, least_lag

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """A parameter that a log may see.

    Attributes
    ----------
    name, unit, meaning : str
    spread : float
        Standard deviation of the prior beside that of the plausible devices: relative if `logarithmic`.
    logarithmic : bool
        Whether the search takes the parameter's logarithm.
    low, high : float
        Bounds of the search.
    nuisance : bool
        Whether it belongs to the recording: the profile does not have it.
    """

    name: str
    unit: str
    meaning: str
    spread: float
    logarithmic: bool = True
    low: float = 0.0
    high: float = math.inf
    nuisance: bool = False

    def place(self, value: float) -> float:
        """Return the coordinate of a value in the search."""
        return math.log(value) if self.logarithmic else value

    def value(self, place: float) -> float:
        """Return the value at a coordinate, within the bounds; the inverse of `place`."""
        return min(max(math.exp(place) if self.logarithmic else place, self.low), self.high)


_DEGREE = math.radians(1.0)

PARAMETERS = (
    Seen("inertia", "kg m2", "J of the bare arm", 0.2, low=1e-6, high=1.0),
    Seen("radius_ratio", "", "R_1/R_2", 0.05, low=0.02, high=2.0),
    Seen("joint_pulley_radius", "m", "R_2", 0.1, low=2e-3, high=0.2),
    Seen("stiffness", "N/m", "of each linear spring", 0.3, low=1.0, high=1e6),
    Seen("half_width", "m", "of the spring assembly", 0.1, low=1e-4, high=0.5),
    Seen("length_ratio", "", "free length of a linear spring over half_width", 0.03, False, 0.0, 1.0),
    Seen("max_force", "N", "at the end of the spring's table", 0.2, low=1.0, high=1e4),
    Seen("damping", "", "factor of the decay rate of Figure 3's fit", 0.3, low=1e-3, high=1e3),
    Seen(
        "damping_preload",
        "",
        "factor of the preload at which the decay rate is that of the fit",
        0.3,
        low=0.1,
        high=10.0,
    ),
    Seen("lag", "s", "of the drives", 0.1, low=1e-3, high=2.0),
    Seen("rate_limit", "deg/s", "of the drives", 0.3, low=10.0, high=1e5),
    Seen("stall_torque", "N m", "of the drives", 0.2, low=1e-2, high=1e3),
)
"""Physics; a profile without a finite rate limit or stall torque lacks it, and one whose spring goes on by the same law
lacks `max_force`, which then changes no motion."""

NUISANCES = (
    Seen("command_delay", "s", "of the logged commands", 5e-3, False, -0.1, 0.1, True),
    Seen(
        "zero_biceps",
        "rad",
        "command at which the biceps' string is just slack, at 0",
        0.5 * _DEGREE,
        False,
        -1,
        1,
        True,
    ),
    Seen("zero_triceps", "rad", "the same of the triceps", 0.5 * _DEGREE, False, -1, 1, True),
    Seen("encoder_bias", "rad", "offset of the joint angle", 0.2 * _DEGREE, False, -1, 1, True),
    Seen("slider_bias_biceps", "m", "offset of the slider", 5e-5, False, -0.1, 0.1, True),
    Seen("slider_bias_triceps", "m", "offset of the slider", 5e-5, False, -0.1, 0.1, True),
)
"""Of the recording; the prior mean of each is 0."""


def physics_of(profile: Profile) -> dict[str, float]:
    """Return the values of those of `PARAMETERS` that a profile has; the factors of the damping are 1."""
    plant, spring, drives = profile.plant, profile.spring, profile.drives
    found = {
        "inertia": float(inertia([each.mass for each in plant.masses], [each.arm for each in plant.masses])),
        "radius_ratio": plant.drive_pulley_radius / plant.joint_pulley_radius,
        "joint_pulley_radius": plant.joint_pulley_radius,
        "damping": 1.0,
        "damping_preload": 1.0,
    }
    if spring.measured_curve is None:
        found |= {"stiffness": spring.stiffness, "half_width": spring.half_width}
        found |= {"length_ratio": spring.free_length / spring.half_width}
        if spring.beyond != "continued":
            found["max_force"] = _end_force(spring)
    if drives.lag > 0.0:
        found["lag"] = drives.lag
        if drives.rate_limit_deg is not None:
            found["rate_limit"] = drives.rate_limit_deg
    if drives.stall_torque is not None:
        found["stall_torque"] = drives.stall_torque
    return {each.name: found[each.name] for each in PARAMETERS if each.name in found}


def device(template: Profile, values: Mapping[str, float]) -> Profile:
    """Return a profile with other values of `PARAMETERS`; the rest is that of `template`.

    The masses are scaled to the inertia. The table of a spring ends at `max_force`, by default that of the template.
    """
    plant, spring, drives, damping = template.plant, template.spring, template.drives, template.damping
    old = physics_of(template)
    new = old | {name: value for name, value in values.items() if name in old}
    factor = new["inertia"] / old["inertia"]
    radius = new["joint_pulley_radius"]
    masses = [PointMass(mass=each.mass * factor, arm=each.arm) for each in plant.masses]
    changes = {"masses": masses, "joint_pulley_radius": radius, "drive_pulley_radius": new["radius_ratio"] * radius}
    groups: dict[str, Plant | Spring | Drives | Damping] = {"plant": plant.model_copy(update=changes)}
    if spring.measured_curve is None:
        half_width = new["half_width"]
        length = min(new["length_ratio"] * half_width, half_width)
        changed = spring.model_copy(
            update={"stiffness": new["stiffness"], "half_width": half_width, "free_length": length}
        )
        end = _end_deflection(changed, new.get("max_force", _end_force(spring)))
        groups["spring"] = changed.model_copy(update={"max_deflection": end})
    preload = new["damping_preload"]
    changes = {"a": damping.a * new["damping"], "d": damping.d * new["damping"], "b": damping.b / preload}
    changes |= {"c": damping.c * preload} if damping.fit == "shifted" else {}
    groups["damping"] = damping.model_copy(update=changes)
    least = least_lag(template.loop.control_period, template.loop.substeps)
    changes = {"lag": max(new["lag"], least)} if "lag" in new else {}
    changes |= {"rate_limit_deg": new["rate_limit"]} if "rate_limit" in new else {}
    changes |= {"stall_torque": new["stall_torque"]} if "stall_torque" in new else {}
    groups["drives"] = drives.model_copy(update=changes)
    return template.model_copy(update=groups)


def _end_force(spring: Spring) -> float:
    """Return the force of the geometric model at the table's end [N]."""
    force, _ = assembly_curve(spring, np.array([spring.max_deflection]))
    return float(force[0])


def _end_deflection(spring: Spring, force: float) -> float:
    """Return the string deflection [m] at a force [N] of the geometric model, a convex curve, by Newton's method."""
    width, length = spring.half_width, spring.free_length
    x = force / (2.0 * spring.stiffness) + length  # there f(x) >= force
    for _ in range(50):
        reach = math.hypot(width, x)
        value = 2.0 * spring.stiffness * x * (1.0 - length / reach) - force
        slope = 2.0 * spring.stiffness * (1.0 - length * width * width / reach**3)
        step = value / slope
        x -= step
        if abs(step) < 1e-12 * x:
            break
    return x
