"""Laws for the firmware: which C text computes them, and its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from amulett_gym import DRIVES_ID
from amulett_gym.envs.action import action_to_tension, tension_to_action
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import CONSTANT, Contender, constant_tension, in_loop, parse_contender
from amulett_gym.laws.parametric import BEST_CONSTANT, EQ6_TUNED, tuned_vector
from amulett_gym.profile import Profile


@dataclass(frozen=True)
class FirmwareLaw:
    """A law as C.

    Attributes
    ----------
    source : str
        File of `amulett_gym.c` that becomes ``law.c``.
    defines : dict
        Its numbers.
    files : dict
        Further generated files: name -> content.
    """

    source: str
    defines: Mapping[str, float | int] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)


def choose(name: str, profile: Profile, control: str | None = None) -> tuple[Contender, Settings]:
    """Return a law by name with the settings of the environment in which it acts.

    Parameters
    ----------
    name : str
        As `laws.contenders.contender_names` lists them.
    profile : Profile
    control : str, optional
        Loop; None: that of the law.

    Raises
    ------
    AmulettError
        If the law is unknown or cannot run on a device.
    """
    contender = parse_contender(name)
    if contender.env_id == DRIVES_ID:
        raise AmulettError(
            f"'{name}' drives both motors directly ({DRIVES_ID}); the firmware has laws that choose a tension. Export "
            "one of those, for example pretrained or eq6"
        )
    if control is not None:
        contender = in_loop(contender, control)
    if contender.env_keywords.get("privileged"):
        raise AmulettError(f"'{name}' needs observations that no device can measure; the firmware cannot run it")
    keywords = {key: value for key, value in contender.env_keywords.items() if key != "privileged"}
    return contender, Settings.read({"profile": profile, **keywords}, "firmware")


def firmware_law(contender: Contender, profile: Profile, settings: Settings) -> FirmwareLaw:
    """Return a law as C (errors as `choose`)."""
    name = contender.policy_name
    if name is None:  # the loop itself sets the tension, or there is none
        return FirmwareLaw("law_constant.c", {"LAW_TENSION": 0.0})
    if name.startswith(CONSTANT):
        return _constant(constant_tension(name), settings)
    if name in ("eq6-held", "eq6-held-printed"):
        own = profile.variable_stiffness
        return FirmwareLaw(
            "law_eq6.c",
            {
                "LAW_EQ6_TUNED": 0,
                "LAW_PRINTED": int(name == "eq6-held-printed"),
                "LAW_NOMINAL": own.nominal_tension,
                "LAW_MINIMUM": own.minimum_tension,
                "LAW_ERROR_SCALE": OBSERVATION_SCALES["position_error"],
                "LAW_ERROR_OFFSET": math.radians(own.error_offset_deg),
            },
        )
    law, vector = tuned_vector(name, profile)
    if law.name == BEST_CONSTANT.name:
        return _constant(float(vector[0]), settings)
    if law.name == EQ6_TUNED.name:
        nominal, minimum, offset, exponent = map(float, vector)
        return FirmwareLaw(
            "law_eq6.c",
            {
                "LAW_EQ6_TUNED": 1,
                "LAW_NOMINAL": nominal,
                "LAW_MINIMUM": minimum,
                "LAW_ERROR_SCALE": math.degrees(OBSERVATION_SCALES["position_error"]),
                "LAW_ERROR_OFFSET": offset,
                "LAW_EXPONENT": exponent,
            },
        )
    raise AmulettError(f"no firmware for {name} yet")


def _constant(tension: float, settings: Settings) -> FirmwareLaw:
    """Return a constant as an environment sets it: by an action, a 32-bit number."""
    action = tension_to_action(tension, settings.tension_range).astype(np.float32)
    return FirmwareLaw("law_constant.c", {"LAW_TENSION": float(action_to_tension(action, settings.tension_range))})
