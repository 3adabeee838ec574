"""The gains of a control loop as tunable parameters, with the constant co-contraction that they are judged with.

Range and scale of the search come from the loop's group in `amulett_gym.gains`: from a tenth to ten times the default,
on a logarithmic scale, within the gain's own range; or what the field names as ``json_schema_extra={"search": (low,
high)}``, logarithmic if `low` is above 0. The search starts at the group's defaults.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic.fields import FieldInfo

from amulett_gym.envs.action import FEED_FORWARD_RANGE
from amulett_gym.errors import AmulettError
from amulett_gym.gains import Loops
from amulett_gym.laws.parametric import Parameter, Space
from amulett_gym.profile import Profile, is_shipped
from amulett_gym.settings import Sourced
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.safe_yaml import parse_yaml, to_yaml

GAINS = "gains"
"""Name of what is tuned, instead of a law's."""

TENSION = Parameter("co_contraction", "N", *FEED_FORWARD_RANGE, 10.0, "constant tension with which the gains are tuned")

FACTOR = 10.0
"""A gain is searched from its default over this to its default times this."""


@dataclass(frozen=True)
class Gains(Space):
    """The gains of one loop, and the co-contraction as the last parameter."""

    control: str = ""

    def profile(self, base: Profile, vector: NDArray[np.float64]) -> Profile:
        """Return a profile with these gains, and with its own sources."""
        key = group_name(self.control)
        gains = zip(self.parameters[:-1], vector[:-1].tolist(), strict=True)
        group = getattr(base.loops, key).model_copy(update={parameter.name: gain for parameter, gain in gains})
        return base.model_copy(update={"loops": base.loops.model_copy(update={key: group})})


def gains_of(control: str) -> Gains:
    """Return the gains of a loop.

    Raises
    ------
    AmulettError
        If the loop has none in `profile.loops`.
    """
    if control not in LOOPS:
        raise AmulettError(f"the loop '{control}' has no gains to tune; choose from {', '.join(LOOPS)}")
    group: Sourced = getattr(Loops(), group_name(control))
    parameters = [
        _parameter(name, field, getattr(group, name))
        for name, field in type(group).model_fields.items()
        if isinstance(getattr(group, name), float)
    ]
    return Gains(GAINS, f"gains of {control}", (*parameters, TENSION), control)


def group_name(control: str) -> str:
    """Return the name of a loop's group in `profile.loops`."""
    return control.replace("-", "_")


def profile_text(profile: Profile, control: str, gains: Mapping[str, float], source: str) -> str:
    """Return a profile file with gains of a loop and their source, based on a shipped profile if `profile` is one."""
    own: dict[str, Any] = {"name": f"{profile.name}-tuned", "base": profile.name}
    if not is_shipped(profile):
        own = profile.model_dump(mode="json", exclude_defaults=True)
    return to_yaml({**own, "loops": {**own.get("loops", {}), **_group(profile, control, gains, source)}})


def shipped_text(text: str, profile: Profile, control: str, gains: Mapping[str, float], source: str) -> str:
    """Return the text of a shipped profile with these gains of a loop; all but the group `loops` stays as it is."""
    loops = parse_yaml(text, "profile").get("loops", {}) | _group(profile, control, gains, source)
    others = re.sub(r"^loops:.*\n((?:[ #].*)?\n)*", "", text, flags=re.MULTILINE).rstrip()
    return f"{others}\n\n{to_yaml({'loops': loops})}"


def _group(profile: Profile, control: str, gains: Mapping[str, float], source: str) -> dict[str, Any]:
    """Return a loop's group with these gains and their source, by its name."""
    group = getattr(profile.loops, group_name(control))
    sources = {**group.sources, **dict.fromkeys(gains, source)}
    return {group_name(control): {**group.model_dump(mode="json"), **gains, "sources": sources}}


def _parameter(name: str, field: FieldInfo, default: float) -> Parameter:
    """Return a gain's range and scale in the search."""
    extra = field.json_schema_extra
    low, high = default / FACTOR, default * FACTOR
    for bound in field.metadata:
        low, high = max(low, getattr(bound, "ge", -math.inf)), min(high, getattr(bound, "le", math.inf))
    if isinstance(extra, dict) and "search" in extra:
        low, high = cast(tuple[float, float], extra["search"])
    if not low < high:
        raise AmulettError(f"the gain '{name}' has no range to search: its field has to name one")
    meaning, _, unit = (field.description or "").partition(" [")
    return Parameter(name, unit.partition("]")[0] or "1", low, high, default, meaning, logarithmic=low > 0.0)
