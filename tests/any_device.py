"""Any device and any scenario that is allowed: hypothesis strategies read off the models, new keys and ranges included.

Half of the keys keep what a shipped profile has, so that some devices work and single keys go to their ends; what has
to fit together is made to.
"""

from __future__ import annotations

import math
import types
import typing
from typing import Any, Literal

from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import MOST_TENSION, STABLE_STEP, Profile, device_names, load_profile
from amulett_gym.tasks.scenario import Scenario, empty_rows, most_damping, most_stiffness

Values = st.SearchStrategy[Any]

LARGEST = 1.7e308
LEAST_POWER = -15.0
SOON = {"time": 0.2, "duration": 0.2, "measure_from": 0.05}
"""Times that an episode of a few steps meets [s]; any other is drawn as well."""
NOT_DRAWN = ("sources", "measured_curve", "base", "name", "description", "divisors_of", "setpoint")


def range_of(field: FieldInfo) -> tuple[float, float]:
    """Return the least and the greatest number that a field takes."""
    low, high = -LARGEST, LARGEST
    for rule in field.metadata:
        low = max(low, getattr(rule, "ge", low), math.nextafter(getattr(rule, "gt", -math.inf), math.inf))
        high = min(high, getattr(rule, "le", high), math.nextafter(getattr(rule, "lt", math.inf), -math.inf))
    return low, high


def numbers(low: float, high: float) -> Values:
    """Draw from a range evenly, by order of magnitude, and its ends."""
    choices: list[Values] = [st.floats(low, high), st.sampled_from([low, high])]
    if low >= 0:
        least, most = max(math.log10(low), LEAST_POWER) if low > 0 else LEAST_POWER, math.log10(high)
        choices.append(st.floats(least, most).map(lambda power: min(max(10.0**power, low), high)))
    return st.one_of(choices)


def values(name: str, annotation: Any, field: FieldInfo, shipped: Any = None) -> Values:
    """Draw what a field may hold, or what a shipped profile has there."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin in (typing.Union, types.UnionType):
        choices = [st.none() if one is types.NoneType else values(name, one, field, shipped) for one in arguments]
        return st.one_of(choices)
    if origin is list:
        sizes = {key: getattr(rule, key) for rule in field.metadata for key in vars_of(rule)}
        return st.lists(groups(arguments[0]), min_size=sizes.get("min_length", 0), max_size=3)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return groups(annotation, shipped)
    if annotation is bool:
        return st.booleans() if shipped is None else st.one_of(st.just(shipped), st.booleans())
    low, high = range_of(field)
    if annotation is int:
        drawn: Values = st.integers(int(low), int(high))
    elif annotation is float:
        drawn = numbers(low, high)
    else:
        raise TypeError(f"{name}: no strategy for {annotation}")
    if name in SOON:
        drawn = st.one_of(st.floats(math.nextafter(low, 1.0), SOON[name]), drawn)
    return drawn if shipped is None else st.one_of(st.just(shipped), drawn)


def vars_of(rule: Any) -> list[str]:
    """Return which bounds of a list's length a rule sets."""
    return [key for key in ("min_length", "max_length") if hasattr(rule, key)]


def groups(model: type[BaseModel], shipped: Any = None) -> Values:
    """Draw a mapping for a model."""
    return st.fixed_dictionaries(
        {
            name: values(name, field.annotation, field, getattr(shipped, name, None))
            for name, field in model.model_fields.items()
            if name not in NOT_DRAWN
        }
    )


SHIPPED = {name: load_profile(name) for name in device_names()}
NOT_GROUPS = (*NOT_DRAWN, *Profile.OPTIONS)  # what a device may lack is simulated apart
GROUPS = {name: field.annotation for name, field in Profile.model_fields.items() if name not in NOT_GROUPS}
DRAWN = {
    base: {name: groups(model, getattr(profile, name)) for name, model in GROUPS.items()}
    for base, profile in SHIPPED.items()
}


@st.composite
def profiles(draw: st.DrawFn, only: tuple[str, ...] = tuple(GROUPS), **fixed: Any) -> Profile:
    """Draw a device: a shipped one with some groups (of `only`) drawn anew, and `fixed` keys."""
    base = draw(st.sampled_from(sorted(SHIPPED)))
    shipped = SHIPPED[base].model_dump(exclude={"name", "base", "description", "divisors_of"})
    content = {name: {**shipped[name], **fixed.get(name, {})} for name in GROUPS}
    for name in draw(st.sets(st.sampled_from(only))):
        content[name] = {**draw(DRAWN[base][name]), **fixed.get(name, {})}
    spring, loop, law, drives = (content[name] for name in ("spring", "loop", "variable_stiffness", "drives"))
    spring["half_width"] = min(spring["half_width"], 100 * spring["max_deflection"])
    spring["free_length"] = min(spring["free_length"], spring["half_width"])
    if spring.get("beyond") == "hard-stop":
        spring["stop_stiffness"] = spring.get("stop_stiffness") or 1e4
    else:
        spring["stop_stiffness"] = None
    if drives["rate_limit_deg"] is None and drives["lag"] > 0:
        drives["stall_torque"] = None
    loop["tie_width"] = min(loop["tie_width"], loop["switch_hysteresis"])
    law["minimum_tension"] = min(law["minimum_tension"], law["nominal_tension"])
    if drives["lag"] > 0:
        drives["lag"] = max(drives["lag"], loop["control_period"] / loop["substeps"] / STABLE_STEP * (1 + 1e-12))
    damping = content["damping"]
    damping["d"] = min(damping["d"], 0.5 * STABLE_STEP * loop["substeps"] / loop["control_period"])
    try:
        return load_profile({"name": "any", "base": base, **content})
    except AmulettError as refused:
        if "inertia" not in str(refused):
            raise
        return load_profile({"name": "any", "base": base, **content, "plant": shipped["plant"]})


@st.composite
def scenarios(draw: st.DrawFn, profile: Profile) -> dict[str, Any]:
    """Draw a scenario for a device."""
    content = draw(ANY_SCENARIO)
    force = build_tables(profile.spring).max_force * min(content["device"][f"spring_{side}"] for side in SIDES)
    content["initial_tension"] = min(max(draw(st.floats(0.01, 0.9)) * force, 1e-300), MOST_TENSION)
    limit = 0.9 * profile.plant.angle_limit_deg
    content["initial_angle_deg"] = min(max(content["initial_angle_deg"], -limit), limit)
    if content["obstacle"] is not None:
        inertia = float(empty_rows(1, profile)["inertia"][0]) * content["device"]["inertia"]
        for key, most in (("stiffness", most_stiffness), ("damping", most_damping)):
            content["obstacle"][key] = min(content["obstacle"][key], most(inertia, profile))
    moves: list[dict[str, Any]] = []
    for move in sorted(content["moves"], key=lambda move: move["time"]):
        move["duration"] = move["duration"] if move["duration"] >= 1e-3 else 0.0
        if not moves or move["time"] >= moves[-1]["time"] + moves[-1]["duration"]:
            moves.append(move)
    content["moves"] = moves
    if draw(st.integers(0, 3)) == 0:
        times = sorted(draw(st.lists(st.one_of(st.floats(0, 0.2), st.floats(0, 1e6)), min_size=1, max_size=20)))
        angles = draw(st.lists(st.floats(-180, 180), min_size=len(times), max_size=len(times)))
        shape = draw(st.sampled_from(["linear", "hold"]))
        content |= {"moves": [], "setpoint": {"time": times, "angle_deg": angles, "interpolation": shape}}
    for push in content["pushes"]:
        rise = min(push["rise"], push["duration"] / 2)
        push["rise"] = rise if rise >= 1e-3 else 0.0
    return content


SIDES = ("biceps", "triceps")
ANY_SCENARIO = groups(Scenario)
actions = st.one_of(st.floats(-1, 1), st.sampled_from([-1.0, 1.0, -math.inf, math.inf, 1e300]))
tension_ranges = st.one_of(
    st.just(TENSION_RANGE),
    st.tuples(numbers(1e-9, 1e5), numbers(1.001, 1e6)).map(
        lambda drawn: (drawn[0], min(drawn[0] * drawn[1], MOST_TENSION))
    ),
)
