"""A wearer in a scenario: who is in the exoskeleton, and how they move. What they intend are the scenario's moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import GRAVITY
from amulett_gym.model.wearer import forearm
from amulett_gym.settings import Group
from amulett_gym.simulation.random import derive_keys, uniform
from amulett_gym.simulation.worn_layout import DELAY, PERSON, put_values

_DIGITS = 9  # of angles in degrees and times: what is drawn is far coarser, so that packing loses nothing


class Quantity(NamedTuple):
    """A quantity in which wearers differ: drawn uniformly from a range, and from another one in the split `shifted`."""

    unit: str
    low: float
    high: float
    shifted: tuple[float, float]
    digits: int
    source: str


POPULATION = {
    "height": Quantity(
        "m",
        1.50,
        1.95,
        (1.38, 1.48),
        2,
        "assumed: about the 5th percentile of women to beyond the 95th of men, as in ISO 7250-2 (from memory)",
    ),
    "body_mass_index": Quantity(
        "kg/m2", 19.0, 30.0, (31.0, 38.0), 1, "assumed: normal and overweight after WHO (from memory); shifted: obese"
    ),
    "tone": Quantity(
        "1",
        0.4,
        1.0,
        (1.05, 1.3),
        2,
        "assumed: 1.2 to 3 N m/rad of the relaxed elbow, up to Katayama and Kawato's (1993) value; shifted: stiffer",
    ),
    "relative_strength": Quantity(
        "1 per 70 kg of body mass",
        1.8,
        3.2,
        (1.2, 1.6),
        2,
        "assumed: so that both muscles' stiffness is 2 to 15 N m/rad in movement, and below 25 N m/rad with one muscle "
        "fully active (Bennett et al., 1992: below any postural value), and the arm is carried; shifted: weaker",
    ),
    "rest_angle_deg": Quantity(
        "deg", 38.0, 50.0, (30.0, 36.0), 1, "assumed: about the middle of the workspace; shifted: more extended"
    ),
    "co_contraction": Quantity("1", 0.01, 0.05, (0.08, 0.15), 3, "assumed: a few percent; shifted: as of older people"),
    "reflex_delay": Quantity(
        "s", 0.03, 0.07, (0.08, 0.11), 3, "assumed: about the 50 ms of PMC4191878; shifted: slower"
    ),
    "feedback_stiffness": Quantity(
        "N m/rad", 3.0, 6.0, (1.5, 2.5), 2, "assumed: stiffness in movement is 2 to 15 N m/rad, muscles included"
    ),
    "feedback_damping": Quantity("N m s/rad", 0.3, 0.6, (0.1, 0.25), 3, "assumed: 0.1 s times the stiffness"),
    "correction_time": Quantity(
        "s", 0.3, 0.6, (0.7, 1.0), 3, "assumed: voluntary answers to a lasting load begin after 0.1 to 0.2 s"
    ),
    "relaxation_time": Quantity(
        "s",
        0.6,
        1.2,
        (1.3, 1.8),
        3,
        "assumed: the motor system forgets effort that is not needed (slacking, from memory)",
    ),
    "anticipation": Quantity("1", 0.5, 0.9, (0.2, 0.45), 3, "assumed: how well the wearer knows the own arm"),
    "tremor_torque": Quantity("N m", 0.02, 0.08, (0.1, 0.2), 3, "assumed: of hundredths of a degree"),
    "tremor_frequency": Quantity("Hz", 8.0, 12.0, (6.0, 7.5), 2, "assumed: physiological, 8 to 12 Hz (from memory)"),
    "endpoint_spread": Quantity(
        "1",
        0.03,
        0.05,
        (0.06, 0.09),
        4,
        "assumed: standard deviation of a movement's end over its amplitude (from memory, Schmidt et al., 1979)",
    ),
    "timing_spread": Quantity(
        "1",
        0.05,
        0.1,
        (0.12, 0.16),
        4,
        "assumed: standard deviation of a movement's duration over it (from memory, Wing and Kristofferson, 1973)",
    ),
}
"""What a person is drawn from. ``assumed`` is what no text could be read for; see docs/wearer.md. All splits but
`shifted`, which lies outside of them, share the ranges; their persons differ by their keys."""

_PERSON_STREAM = 3  # of an episode's key; 0 to 2 are those of `tasks.suites`
_REFERENCE_MASS = 70.0  # [kg], of a relative strength of 1


def draw_wearers(keys: NDArray[np.uint64], shifted: bool) -> dict[str, NDArray[np.float64]]:
    """Return a person for each key: quantity -> values, shape (N,).

    The quantities are those of `POPULATION` without the relative ones, body mass and `strength`; the same key gives the
    same person in any batch.
    """
    draws = uniform(derive_keys(keys, _PERSON_STREAM), len(POPULATION))
    people = {}
    for (name, quantity), draw in zip(POPULATION.items(), draws.T, strict=True):
        low, high = quantity.shifted if shifted else (quantity.low, quantity.high)
        people[name] = between(draw, low, high, quantity.digits)
    mass = rounded(people.pop("body_mass_index") * people["height"] * people["height"], 1)
    strength = rounded(people.pop("relative_strength") * mass / _REFERENCE_MASS, 2)
    return people | {"mass": mass, "strength": strength}


def between(draw: NDArray[np.float64], low: ArrayLike, high: ArrayLike, digits: int) -> NDArray[np.float64]:
    """Return uniform draws scaled to [low, high] and rounded, so that scenarios are readable and replay exactly."""
    return rounded(np.asarray(low) + draw * (np.asarray(high) - low), digits)


def rounded(numbers: ArrayLike, digits: int) -> NDArray[np.float64]:
    """Return numbers with so many decimals."""
    scale = 10.0**digits
    return np.asarray(np.rint(np.asarray(numbers) * scale) / scale)


def middle(name: str) -> float:
    """Return the middle of a quantity's range in `POPULATION`."""
    quantity = POPULATION[name]
    return round(0.5 * (quantity.low + quantity.high), quantity.digits)


_MASS = round(middle("body_mass_index") * middle("height") ** 2, 1)
_STRENGTH = round(middle("relative_strength") * _MASS / _REFERENCE_MASS, 2)


class Wearer(Group):
    """A person's arm: by default that of the middle of `POPULATION`, which has sources and ranges."""

    mass: float = Field(default=_MASS, ge=20, le=250, description="of the body [kg]")
    height: float = Field(default=middle("height"), ge=1.0, le=2.5, description="of the body [m]")
    tone: float = Field(
        default=middle("tone"), ge=0.05, le=20, description="factor of the relaxed muscles' stiffness [1]"
    )
    strength: float = Field(
        default=_STRENGTH,
        ge=0.05,
        le=20,
        description="factor of the stiffness and torque of the muscles' activation [1]",
    )
    rest_angle_deg: float = Field(
        default=middle("rest_angle_deg"),
        ge=-180,
        le=180,
        description="posture in which the muscles of a guided wearer are in balance [deg]; else the intended one",
    )
    co_contraction: float = Field(
        default=middle("co_contraction"), ge=0, le=1, description="activation of both muscles that is always there [1]"
    )
    reflex_delay: float = Field(
        default=middle("reflex_delay"), ge=0, le=0.5, description="from an error to its answer [s]"
    )
    feedback_stiffness: float = Field(
        default=middle("feedback_stiffness"), ge=0, le=500, description="of the delayed answer [N m/rad]"
    )
    feedback_damping: float = Field(
        default=middle("feedback_damping"), ge=0, le=50, description="of the delayed answer [N m s/rad]"
    )
    correction_time: float = Field(
        default=middle("correction_time"),
        ge=0.01,
        le=1e6,
        description="in which a lasting error's answer is given once more [s]",
    )
    relaxation_time: float = Field(
        default=middle("relaxation_time"),
        ge=0.01,
        le=1e6,
        description="in which the wearer relaxes a correction that no error needs [s]",
    )
    anticipation: float = Field(
        default=middle("anticipation"),
        ge=0,
        le=2,
        description="share of the own inertia and friction that the wearer feeds forward [1]",
    )
    tremor_torque: float = Field(
        default=middle("tremor_torque"), ge=0, le=10, description="standard deviation of the tremor [N m]"
    )
    tremor_frequency: float = Field(default=middle("tremor_frequency"), ge=1, le=20, description="of the tremor [Hz]")
    payload_time: float = Field(
        default=0.0, ge=0, le=1e6, description="from when on the scenario's payload is in the hand [s]"
    )
    guided: bool = Field(
        default=False,
        description="true: the scenario's moves are the device's setpoint instead of an intention, and the wearer is "
        "relaxed: the co-contraction is all that the muscles do",
    )
    worn: bool = Field(default=True, description="false: the same arm outside the exoskeleton, to compare")


def pack_wearer(
    wearer: Wearer, control_period: float, vertical: bool, payload_mass: float = 0.0, payload_arm: float = 0.0
) -> NDArray[np.void]:
    """Return a wearer with a payload in the hand as a record of `simulation.worn_layout.PERSON`, shape (1,).

    Parameters and errors as of `pack_wearers`.
    """
    return pack_wearers(dict(wearer), control_period, vertical, payload_mass, payload_arm)


def pack_wearers(
    people: Mapping[str, Any],
    control_period: float,
    vertical: ArrayLike,
    payload_mass: ArrayLike = 0.0,
    payload_arm: ArrayLike = 0.0,
) -> NDArray[np.void]:
    """Return wearers, each with a payload in the hand, as records of `simulation.worn_layout.PERSON`, shape (N,).

    Parameters
    ----------
    people : mapping
        Key of `Wearer` -> value, or values of shape (N,); a key that is left out has its default.
    control_period : float
        Of the device [s]; reflex delay and time of the payload are rounded to it.
    vertical : bool or ndarray of bool, shape (N,)
        Whether gravity acts on the arm.
    payload_mass, payload_arm : float or ndarray, shape (N,)
        A point mass [kg] and its distance from the elbow [m].

    Returns
    -------
    ndarray of PERSON, shape (N,)
        A single value, of any of the arguments, counts for all; if all are single, N is 1.

    Raises
    ------
    AmulettError
        If a reflex delay has too many control ticks.
    """
    values = {key: np.atleast_1d(value) for key, value in (dict(Wearer()) | dict(people)).items()}
    delay = reflex_ticks(values["reflex_delay"], control_period)
    if delay.max(initial=0) >= DELAY:
        worst = int(np.argmax(delay))
        raise AmulettError(
            f"scenario: 'wearer.reflex_delay' is {values['reflex_delay'][worst]} s, {delay[worst]:.0f} control ticks "
            f"of the device; at most {(DELAY - 1) * control_period:g} s are possible"
        )
    mass, centre, inertia = forearm(values["mass"], values["height"])
    others = (np.shape(value) for value in (vertical, payload_mass, payload_arm))
    packed = np.zeros(np.broadcast_shapes(*(value.shape for value in values.values()), *others), dtype=PERSON)
    put_values(packed, values)
    packed["inertia"], packed["load_inertia"] = inertia, payload_mass * np.square(payload_arm)
    packed["weight"] = np.where(vertical, GRAVITY * mass * centre, 0.0)
    packed["load_weight"] = np.where(vertical, GRAVITY * np.multiply(payload_mass, payload_arm), 0.0)
    packed["rest_angle"] = np.radians(values["rest_angle_deg"])
    packed["load_tick"] = np.rint(values["payload_time"] / control_period)
    packed["delay"] = delay
    return packed


def reflex_ticks(delay: ArrayLike, control_period: float) -> NDArray[np.float64]:
    """Return the control ticks of reflex delays [s]."""
    return np.asarray(np.rint(np.asarray(delay) / control_period))


def unpack_wearer(record: NDArray[np.void] | np.void, control_period: float) -> Wearer:
    """Return the wearer of a record of `PERSON`; packing it again gives the same bits.

    Reflex delay and time of the payload are whole control periods [s].
    """
    values: dict[str, Any] = {key: float(record[key]) for key in Wearer.model_fields if key in (PERSON.names or ())}
    return Wearer(
        **values
        | {
            "rest_angle_deg": round(float(np.degrees(record["rest_angle"])), _DIGITS),
            "reflex_delay": round(int(record["delay"]) * control_period, _DIGITS),
            "payload_time": round(int(record["load_tick"]) * control_period, _DIGITS),
            "guided": bool(record["guided"]),
            "worn": bool(record["worn"]),
        }
    )
