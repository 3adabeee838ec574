"""The gains of a control loop as tunable parameters, with the constant co-contraction that they are judged with.

Range and scale of the search come from the loop's group in `amulett_gym.gains`: from a 30th to 30 times the default,
on a logarithmic scale, within the gain's own range; or what the field names as ``json_schema_extra={"search": (low,
high)}``, logarithmic if `low` is above 0. A gain whose default is 0 is off, and is not searched unless its field names
a range. The search starts at the group's defaults; for the paper's loop these are the gains of the profile.

The shape of the reference motion is a choice, not a number: see `shapes_of`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic.fields import FieldInfo

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.eq6_costs import shipped_costs
from amulett_gym.errors import AmulettError
from amulett_gym.gains import Following, Loops, group_name
from amulett_gym.laws.parametric import Parameter, Space
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile, is_shipped
from amulett_gym.settings import Group, merge
from amulett_gym.simulation.layout import LOOPS, STRING_FORCES
from amulett_gym.storage.safe_yaml import parse_yaml, to_yaml

GAINS = "gains"
"""Name of what is tuned, instead of a law's."""

TENSION = "co_contraction"
"""Name of the constant tension with which gains are tuned."""

SHAPE = "reference"
"""Name of the gain that is a shape of the reference motion."""

G = TypeVar("G", bound=Group)

MOST_FORCE = 0.9
"""Largest string force that a loop may need, as a share of what the profile's springs give."""

FACTOR = 30.0
"""A gain is searched from its default over this to its default times this."""


@dataclass(frozen=True)
class Gains(Space):
    """The gains of one loop, and the co-contraction as the last parameter.

    `places` are the paths of the gains in a profile; `reference` is the shape of the reference motion, empty: that of
    the profile.
    """

    control: str = ""
    places: tuple[tuple[str, ...], ...] = ()
    reference: str = ""

    def profile(self, base: Profile, vector: NDArray[np.float64]) -> Profile:
        """Return a profile with these gains, and with its own sources."""
        for place, gain in zip(self.places, vector[:-1].tolist(), strict=True):
            base = _with(base, place, gain)
        return _with(base, self._shape_place, self.reference) if self.reference else base

    @property
    def _shape_place(self) -> tuple[str, ...]:
        return "loops", group_name(self.control), SHAPE

    def changes(self, profile: Profile, vector: NDArray[np.float64], source: str) -> dict[str, Any]:
        """Return the groups with gains as a profile's content, with these gains and their source."""
        tuned, found = self.profile(profile, vector), dict[str, Any]()
        for group, key, *_ in self.places:  # loops: co_rotation: ..., or loop: position: ...
            content = getattr(getattr(tuned, group), key).model_dump(mode="json")
            if group == "loop":
                sources = {**tuned.loop.sources, **found.get(group, {}).get("sources", {}), key: source}
                found[group] = {**found.get(group, {}), key: content, "sources": sources}
            else:
                names = [*([SHAPE] if self.reference else []), *(place[-1] for place in self.places)]
                content["sources"] = {**content["sources"], **dict.fromkeys(names, source)}
                found[group] = {key: content}
        return found


def shapes_of(control: str) -> tuple[str, ...]:
    """Return the shapes that a loop's reference motion can have; none if it has no reference motion."""
    return get_args(Following.model_fields[SHAPE].annotation) if control in LOOPS else ()


def gains_of(control: str, profile: Profile, reference: str = "") -> Gains:
    """Return the gains of a loop that takes a tension, with a shape of its reference motion.

    Raises
    ------
    AmulettError
        If the loop takes none.
    """
    if control in LOOPS:
        key = group_name(control)
        groups: list[tuple[tuple[str, str], Group]] = [(("loops", key), getattr(Loops(), key))]
    elif control == "decentralized":
        groups = [(("loop", "position"), profile.loop.position), (("loop", "tension"), profile.loop.tension)]
    else:
        raise AmulettError(f"the loop '{control}' takes no tension, with which its gains could be tuned")
    most = MOST_FORCE * build_tables(profile.spring).max_force
    parameters, places = list[Parameter](), list[tuple[str, ...]]()
    for place, group in groups:
        for name, value in group:
            field = type(group).model_fields[name]
            found = _parameter(name, field, value) if isinstance(value, float) else None
            if found is not None and name in STRING_FORCES:
                found = replace(found, high=min(found.high, most), start=min(found.start, most))
            if found is not None:
                parameters.append(found if control in LOOPS else replace(found, name=f"{place[1]}_{name}"))
                places.append((*place, name))
    tensions = FEED_FORWARD_RANGE if control in LOOPS else TENSION_RANGE
    constant = Parameter(TENSION, "N", *tensions, 10.0, "constant tension with which the gains are tuned")
    return Gains(GAINS, f"gains of {control}", (*parameters, constant), control, tuple(places), reference)


def profile_text(profile: Profile, changes: Mapping[str, Any]) -> str:
    """Return a profile file with changed groups, based on a shipped profile if `profile` is one.

    With other gains of the paper's loop, it still has a shipped profile's unit of costs (`divisors_of`).
    """
    own: dict[str, Any] = {"name": f"{profile.name}-tuned", "base": profile.name}
    if not is_shipped(profile):
        own = profile.model_dump(mode="json", exclude_defaults=True)
    if "loop" in changes and (unit := shipped_costs(profile)) is not None:
        own["divisors_of"] = unit
    return to_yaml(merge(own, changes))


def shipped_text(text: str, loops: Mapping[str, Any]) -> str:
    """Return the text of a shipped profile with these groups in `loops`; all but this group stays as it is."""
    content = {"loops": parse_yaml(text, "profile").get("loops", {}) | loops}
    others = re.sub(r"^loops:.*\n((?:[ #].*)?\n)*", "", text, flags=re.MULTILINE).rstrip()
    return f"{others}\n\n{to_yaml(content)}"


def _with(group: G, place: Sequence[str], gain: float | str) -> G:
    """Return a group with another value at a path of keys."""
    name, *below = place
    return group.model_copy(update={name: _with(getattr(group, name), below, gain) if below else gain})


def _parameter(name: str, field: FieldInfo, default: float) -> Parameter | None:
    """Return a gain's range and scale in the search; None if it is off."""
    extra = field.json_schema_extra
    low, high = default / FACTOR, default * FACTOR
    for bound in field.metadata:
        low, high = max(low, getattr(bound, "ge", -math.inf)), min(high, getattr(bound, "le", math.inf))
    if isinstance(extra, dict) and "search" in extra:
        low, high = cast(tuple[float, float], extra["search"])
    if not low < high:
        return None
    meaning, _, unit = (field.description or "").partition(" [")
    return Parameter(name, unit.partition("]")[0] or "1", low, high, default, meaning, logarithmic=low > 0.0)
