"""The device parameters that a search may vary.

R_2 is not among them. The equations stay the same when R_1, R_2, all lengths of the spring and J are scaled together at
the same forces, so that no recorded motion or force determines it; it is fixed, and the others are identified for it.
A sample of devices draws it, and what else no table sees, from ranges: `UNSEEN`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.model.plant import inertia
from amulett_gym.profile import Profile, least_lag, load_profile
from amulett_gym.settings import merge

Values = NDArray[np.float64]

JOINT_PULLEY_RADIUS = 0.04
"""R_2 [m]; see above."""

MASS_ARM = 0.13
"""Lever arm of the one mass that stands for the arm [m]; motions in the horizontal plane depend on J alone."""

SWITCH_FILTER = 0.03
"""Time constant of the testbed's low-pass over the difference of both springs' readings [s]; not identified."""

CERTAIN = 5.0
"""The hysteresis of the agonist's switch in standard deviations of that difference's noise."""


@dataclass(frozen=True)
class Free:
    """A parameter to identify."""

    name: str
    low: float  # bound of the search
    high: float
    unit: str  # empty if dimensionless
    source: str  # of the bounds
    logarithmic: bool = True  # scale of the search
    choices: tuple[float, ...] = ()  # if not empty, the only values allowed

    def value(self, place: float) -> float:
        """Return the parameter at a place from 0 (lower bound) to 1 (upper bound)."""
        if self.choices:
            return self.choices[min(int(place * len(self.choices)), len(self.choices) - 1)]
        if self.logarithmic:
            return self.low * (self.high / self.low) ** place
        return self.low + (self.high - self.low) * place

    def place(self, value: float) -> float:
        """Return the place of a value, the inverse of `value`."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices)
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


PARAMETERS = (
    Free("inertia", 3e-4, 1e-2, "kg m2", "J: a bare printed beam, to one with half a kilogram of motor and mount"),
    Free("radius_ratio", 0.2, 0.5, "", "R_1/R_2: 0.29 by the measured position ISEs without lag, more with lag"),
    Free("max_force", 10.05, 40.0, "N", "where the springs saturate: 10 N was held"),
    Free("max_deflection", 2e-3, 3e-2, "m", "string deflection there: an assembly the size of a hand"),
    Free(
        "width_ratio",
        0.15,
        1.5,
        "",
        "half width of the assembly over max_deflection: wider, the slider on a spring moves by less than 0.3 of the "
        "string's deflection",
    ),
    Free(
        "length_ratio", 0.0, 1.0, "", "free length of a linear spring over half width: 0 linear, 1 cubic at rest", False
    ),
    Free(
        "simulation.position_filter", 2e-4, 0.03, "s", "derivative filter: up to three times Simulink's default, 10 ms"
    ),
    Free("simulation.tension_filter", 1e-3, 0.05, "s", "derivative filter"),
    Free("simulation.force_filter", 1e-3, 0.3, "s", "the lag without which the tension loop is algebraic"),
    Free("testbed.lag", 3e-3, 0.3, "s", "a servo's, to that of a geared motor under load"),
    Free("testbed.rate_limit", 200.0, 2000.0, "deg/s", "a slow servo's, to that of a fast geared motor"),
    Free(
        "testbed.position_filter",
        2e-4,
        0.03,
        "s",
        "derivative filter: next to none, to what an encoder's noise asks for",
    ),
    Free("testbed.tension_filter", 2e-4, 0.1, "s", "derivative filter: the potentiometers are noisier"),
    Free("testbed.force_filter", 2e-3, 0.3, "s", "low-pass of the estimated force"),
    Free(
        "testbed.slider_noise",
        2e-5,
        2e-4,
        "m",
        "potentiometers: a bit, to a hundredth of their travel, beside two motors",
    ),
    Free(
        "testbed.control_period",
        2e-3,
        1e-2,
        "s",
        "what an Arduino Mega 2560 does with three sensors and two PIDs; an agent acts every 20 ms, a multiple of it",
        choices=(0.002, 0.0025, 0.004, 0.005, 0.01),
    ),
)
"""Parameters that the paper does not print and data might determine."""

LOOP = ("testbed.position_filter", "testbed.tension_filter", "testbed.force_filter", "testbed.control_period")
"""Those of `PARAMETERS` that are choices of the testbed's loop, known to the owner who programs it; not physics."""

SPRING_ENDS = ("held", "continued", "hard-stop", "stall")
"""What may end the spring's curve: `Spring.beyond`; ``stall``: the law continued, with drives that stall."""

OWN = {
    "hard-stop": Free(
        "stop_stiffness",
        5e3,
        2e5,
        "N/m",
        "a stop of printed parts, to 0.25 m of a 1 mm steel cable (E A / L), twice over",
    ),
    "stall": Free(
        "stall_torque", 0.15, 2.0, "N m", "a micro servo's 1.5 kgf cm, to the 20 kgf cm of a large hobby servo"
    ),
}
"""The parameter that an end of the spring's curve has of its own, by `SPRING_ENDS`."""


UNSEEN = (
    Free(
        "joint_pulley_radius",
        0.03,
        0.05,
        "m",
        "R_2: half the breadth of a small elbow, to that of a wide one within a cuff of 1 cm (57 to 79 mm for medium "
        "frames: Metropolitan tables of 1983); the other lengths, J and the torques go with it, so that strings and "
        "motions stay the same",
    ),
    Free(
        "mass_arm",
        0.12,
        0.18,
        "m",
        "lever arm of the mass that stands for the arm, at the same J: a uniform beam of 0.2 to 0.3 m has the weight's "
        "torque and J of one mass at 0.62 of its length; no forearm of the tables swings vertically",
    ),
    Free("encoder_noise", 0.01, 0.06, "deg", "half a bit, to the AS5048's worst case without averaging (datasheet)"),
    Free(
        "potentiometer_travel",
        0.015,
        0.03,
        "m",
        "short slide potentiometers: 20 and 30 mm (Bourns PTL, datasheet), and one shorter; 10 bits of it are the "
        "resolution",
        choices=(0.015, 0.02, 0.03),
    ),
    Free("command_limit", 360.0, 1080.0, "deg", "one to three turns of the string's drum; 300 deg move the joint"),
)
"""What a sample of devices draws, since no table or hardly one sees it; without them they are the shipped profiles'."""


def searched(spring_end: str = "held", loop: bool = True) -> tuple[Free, ...]:
    """Return the parameters to search with an end of the spring's curve: `PARAMETERS`, and its own.

    Without `loop` the testbed's loop is that of its profile: `LOOP` is not searched.
    """
    free = tuple(item for item in PARAMETERS if loop or item.name not in LOOP)
    return (*free, OWN[spring_end]) if spring_end in OWN else free


def unpack(vector: Values, free: tuple[Free, ...] = PARAMETERS) -> dict[str, float]:
    """Return the named parameters of a search vector, whose numbers go from 0 to 1 between the bounds of `free`.

    Every vector gives devices that a profile allows: a lag too short for the control period is raised to the least one.
    """
    parameters = _between_bounds(vector, free)
    return {**parameters, "testbed.lag": max(parameters["testbed.lag"], _least_lag(parameters))}


def allowed(vector: Values, free: tuple[Free, ...] = PARAMETERS) -> bool:
    """Return whether `unpack` leaves a vector unchanged, as every candidate of a search has to be."""
    parameters = _between_bounds(vector, free)
    return parameters["testbed.lag"] >= _least_lag(parameters)


def pack(parameters: Mapping[str, float]) -> Values:
    """Return the search vector of named parameters, the inverse of `unpack`."""
    return np.array([free.place(parameters[free.name]) for free in of(parameters)])


def of(parameters: Mapping[str, float]) -> tuple[Free, ...]:
    """Return what was searched for a set of named parameters."""
    return tuple(free for free in (*PARAMETERS, *OWN.values()) if free.name in parameters)


def _between_bounds(vector: Values, free: tuple[Free, ...]) -> dict[str, float]:
    return {item.name: item.value(place) for item, place in zip(free, vector.tolist(), strict=True)}


def _least_lag(parameters: Mapping[str, float]) -> float:
    """Return the shortest lag of the testbed's drives [s] that its integration steps resolve."""
    loop = load_profile("testbed").loop
    return least_lag(parameters.get("testbed.control_period", loop.control_period), loop.substeps)


def resized(parameters: Mapping[str, float], joint_pulley_radius: float) -> dict[str, float]:
    """Return the set of parameters by which a device with another R_2 [m] has the same strings and motions."""
    factor = joint_pulley_radius / JOINT_PULLEY_RADIUS
    longer = ("inertia", "max_deflection", "testbed.slider_noise", "stall_torque")
    scale = dict.fromkeys(longer, factor) | {"stop_stiffness": 1.0 / factor}
    found = {name: value * scale.get(name, 1.0) for name, value in parameters.items()}
    return {**found, "joint_pulley_radius": joint_pulley_radius}


def spring_end_changes(spring_end: str, **own: float) -> dict[str, dict[str, Any]]:
    """Return the changes of a profile by an end of the spring's curve (`SPRING_ENDS`); `own`: see `OWN`."""
    spring: dict[str, Any] = {"beyond": {"held": None, "stall": "continued"}.get(spring_end, spring_end)}
    stop = own.get("stop_stiffness") if spring_end == "hard-stop" else None
    stall = own.get("stall_torque") if spring_end == "stall" else None
    return {"spring": {**spring, "stop_stiffness": stop}, "drives": {"stall_torque": stall}}


def profile_changes(parameters: Mapping[str, float], spring_end: str = "held") -> dict[str, dict[str, Any]]:
    """Return the changes of each device's profile by a set of parameters, in the profile's own keys.

    A set without `LOOP` leaves the testbed's loop and force filter as they are; those of `UNSEEN` that it lacks, too.
    Numbers have five significant digits, in the search too, so that a written profile is the one that was found.
    """
    p = parameters
    deflection, force = p["max_deflection"], p["max_force"]
    half_width = p["width_ratio"] * deflection
    free_length = p["length_ratio"] * half_width
    radius, arm = p.get("joint_pulley_radius", JOINT_PULLEY_RADIUS), p.get("mass_arm", MASS_ARM)
    shared = {
        "plant": {
            "masses": [{"mass": _digits(p["inertia"] / inertia([1.0], [arm])), "arm": arm}],
            "drive_pulley_radius": _digits(p["radius_ratio"] * radius),
            "joint_pulley_radius": radius,
        },
        "spring": {
            "stiffness": _digits(force / (2 * deflection * (1 - free_length / math.hypot(half_width, deflection)))),
            "half_width": _digits(half_width),
            "free_length": _digits(free_length),
            "max_deflection": _digits(deflection),
        },
    }
    if spring_end != "held":
        own = {free.name: _digits(p[free.name]) for free in OWN.values() if free.name in p}
        shared = merge(shared, spring_end_changes(spring_end, **own))
    noise = _digits(p["testbed.slider_noise"])
    loop = _loop(p, noise) if "testbed.control_period" in p else {"sensors": {}}
    testbed = {**shared, **loop}
    testbed["sensors"]["potentiometer_noise"] = noise
    testbed["drives"] = testbed.get("drives", {}) | {
        "lag": _digits(p["testbed.lag"]),
        "rate_limit_deg": _digits(p["testbed.rate_limit"]),
    }
    for name, (group, key) in _UNSEEN_KEYS.items():
        if name in p:
            testbed[group][key] = p[name]
    return {"simulation": {**shared, **_filters("simulation", p)}, "testbed": testbed}


_UNSEEN_KEYS = {
    "encoder_noise": ("sensors", "encoder_noise_deg"),
    "potentiometer_travel": ("sensors", "potentiometer_travel"),
    "command_limit": ("drives", "command_limit_deg"),
}


def _filters(device: str, p: Mapping[str, float]) -> dict[str, Any]:
    position = {"derivative_filter": _digits(p[f"{device}.position_filter"])}
    tension = {"derivative_filter": _digits(p[f"{device}.tension_filter"])}
    return {
        "sensors": {"force_filter": _digits(p[f"{device}.force_filter"])},
        "loop": {"position": position, "position_only": position, "tension": tension},
    }


def _loop(p: Mapping[str, float], noise: float) -> dict[str, Any]:
    """Return the changes of the testbed's loop; `noise` is that of its potentiometers [m]."""
    period = p["testbed.control_period"]
    weight = period / (SWITCH_FILTER + period)
    difference = noise * math.sqrt(2.0 * weight / (2.0 - weight))  # standard deviation, after the low-pass
    own = {
        "control_period": period,
        "switch_filter": SWITCH_FILTER,
        "switch_hysteresis": _digits(CERTAIN * difference),
        "tie_width": _digits(difference),
    }
    return merge(_filters("testbed", p), {"loop": own})


def devices(parameters: Mapping[str, float], spring_end: str = "held") -> dict[str, Profile]:
    """Return both shipped devices, the simulation and the testbed, with a set of parameters instead of theirs.

    `spring_end` is one of `SPRING_ENDS`, whose own parameter has to be in the set.

    Raises AmulettError if a profile does not allow one of the values.
    """
    return {
        name: load_profile({"base": name, "name": f"{name}-identified", **changes})
        for name, changes in profile_changes(parameters, spring_end).items()
    }


def same_device(profile: Profile, other: Profile) -> bool:
    """Return whether two profiles describe the same device, whatever their names and sources."""
    return bool(bare(profile.model_dump()) == bare(other.model_dump()))


def bare(value: Any) -> Any:
    """Return a profile's content without its name, base, description and sources."""
    if isinstance(value, dict):
        words = ("name", "base", "description", "sources")
        return {key: bare(item) for key, item in value.items() if key not in words}
    return value


def _digits(value: float) -> float:
    return float(f"{value:.5g}")
