"""Laws for the firmware: which C text computes them, and its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.envs.action import action_to_tension, tension_to_action
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.firmware.control import left_for_law
from amulett_gym.firmware.network import (
    SLICE,
    Numbers,
    choose_numbers,
    forward_numbers,
    jobs,
    quantised,
    recorded_inputs,
    slices,
    weights_header,
)
from amulett_gym.firmware.numbers import array, defines
from amulett_gym.laws.bundle import Bundle, read_bundle
from amulett_gym.laws.contenders import (
    CONSTANT,
    EQ6_HELD,
    Contender,
    bundle_folder,
    constant_tension,
    in_loop,
    parse_contender,
)
from amulett_gym.laws.parametric import BEST_CONSTANT, EQ6_TUNED, Device, is_tuned, tuned_vector
from amulett_gym.laws.policies import is_law
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import CONTROLS

PARAMETRIC_SLICES, _PARAMETRIC_CYCLES = 2, 14_600
"""Of ``law_parametric.c``; the cycles are those of its longest slice on an ATmega2560."""

_CURVE_CELLS = 1024


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
    remarks : tuple of str
        For the folder's README.
    apart : float
        By how much whole numbers may change its tension setpoint [N].
    slices : int
        Control ticks that it takes.
    cycles : int
        Of an ATmega2560 in the longest slice, if that is more than a few.
    """

    source: str
    defines: Mapping[str, float | int] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    apart: float = 0.0
    slices: int = 1
    cycles: int = 0


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
    if contender.env_id == WORN_ID:
        raise AmulettError(
            f"'{name}' needs the cuff of a worn device ({WORN_ID}), which the firmware lacks. Export another law, "
            "for example pretrained or eq6"
        )
    if control is not None:
        contender = in_loop(contender, control)
    loop = contender.env_keywords.get("control", CONTROLS[0])
    if loop not in CONTROLS:
        raise unknown("control", str(loop), CONTROLS)
    if contender.env_keywords.get("privileged"):
        raise AmulettError(f"'{name}' needs observations that no device can measure; the firmware cannot run it")
    keywords = {key: value for key, value in contender.env_keywords.items() if key != "privileged"}
    if contender.policy_name is not None and not is_law(contender.policy_name):
        keywords["tension_range"] = read_bundle(bundle_folder(contender.policy_name)).policy.tension_range
    return contender, Settings.read({"profile": profile, **keywords}, "firmware")


def with_delay(settings: Settings, slices: int) -> Settings:
    """Return an environment's settings with the firmware's `action_delay`: the law's own, or what its slices need."""
    delay = max(settings.action_delay, slices - 1)
    return type(settings)(**{**settings.given, "action_delay": delay}) if delay else settings


def delay_remark(own: Settings, found: Settings) -> str:
    """Return what the firmware's delay is beside that of the law's `own` settings, as a sentence; "" without any."""
    if found.action_delay == 0:
        return ""
    late = f"The ramp of an action begins {_control_ticks(found.action_delay)} after its observation"
    if own.action_delay == found.action_delay:
        return f"{late}, as in the simulation in which the law was trained or tuned."
    return (
        f"{late}; the law was trained or tuned with {_control_ticks(own.action_delay)} (`action_delay`), so that it "
        "may cost more than there."
    )


def fitting_remark(profile: Profile) -> str:
    """Return what the firmware of a worn device lacks, as a sentence; "" of a device that is not worn."""
    if profile.wearer is None:
        return ""
    return (
        f"Without intent control: '{profile.name}' is worn (`wearer`), but the firmware has no cuff. Its setpoint is "
        "what the host sends, and does not follow a cuff's torque (`wearer.admittance`), as in Amulett/Worn-v0."
    )


def _control_ticks(count: int) -> str:
    return f"{count} control tick{'s' * (count != 1)}"


def firmware_law(
    contender: Contender, profile: Profile, settings: Settings, numbers: Numbers | None = None
) -> FirmwareLaw:
    """Return a law as C; `numbers`: those of a network. AmulettError if it does not fit the microcontroller."""
    name = contender.policy_name
    if name is None:  # the loop itself sets the tension, or there is none
        return FirmwareLaw("law_constant.c", {"LAW_TENSION": 0.0})
    if name.startswith(CONSTANT):
        return _constant(constant_tension(name), settings)
    if name in EQ6_HELD:
        own = profile.variable_stiffness
        return FirmwareLaw(
            "law_eq6.c",
            {
                "LAW_EQ6_TUNED": 0,
                "LAW_PRINTED": int(EQ6_HELD[name]),
                "LAW_NOMINAL": own.nominal_tension,
                "LAW_MINIMUM": own.minimum_tension,
                "LAW_ERROR_SCALE": OBSERVATION_SCALES["position_error"],
                "LAW_ERROR_OFFSET": math.radians(own.error_offset_deg),
            },
        )
    if not is_tuned(name):
        return _network(read_bundle(bundle_folder(name)), profile, settings, numbers)
    law, vector = tuned_vector(name, profile)
    if law.name == BEST_CONSTANT.name:
        return _constant(float(vector[0]), settings)
    if law.name == EQ6_TUNED.name:
        most, minimum, offset, exponent = map(float, vector)
        return FirmwareLaw(
            "law_eq6.c",
            {
                "LAW_EQ6_TUNED": 1,
                "LAW_NOMINAL": most,
                "LAW_MINIMUM": minimum,
                "LAW_ERROR_SCALE": math.degrees(OBSERVATION_SCALES["position_error"]),
                "LAW_ERROR_OFFSET": offset,
                "LAW_EXPONENT": exponent,
            },
        )
    nominal = Device.of(profile, settings.agent_period)
    constants = dict(
        zip(("JOINT_RADIUS", "INERTIA", "DECAY_A", "DECAY_B", "DECAY_C", "DECAY_D"), nominal.constants, strict=True)
    )
    values = {parameter.name.upper(): value for parameter, value in zip(law.parameters, vector, strict=True)}
    values |= {**constants, "PI": math.pi, "PERIOD": nominal.agent_period, "LEAST": law.range[0], "MOST": law.range[1]}
    numbers_of_law = {f"LAW_{key}": float(value) for key, value in values.items()}
    slices, cycles = PARAMETRIC_SLICES, _PARAMETRIC_CYCLES
    return FirmwareLaw("law_parametric.c", numbers_of_law, {"curves.h": _curves()}, slices=slices, cycles=cycles)


def _curves() -> str:
    """Return ``curves.h``: what the parametric law reads from tables, where numbers have 32 bits."""
    curves: dict[str, tuple[float, Callable[[Any], Any]]] = {
        "size": (4.0, lambda x: -np.expm1(-(x**2))),
        "tanh": (8.0, np.tanh),
        "squash": (4.0, lambda x: x / (1.0 + x**8) ** 0.125),
    }
    share = np.linspace(0.0, 1.0, _CURVE_CELLS + 1)
    values = {"CURVE_CELLS": _CURVE_CELLS, **{f"{name.upper()}_END": end for name, (end, _) in curves.items()}}
    tables = [
        array("table_real", f"{name}_curve", curve(end * share).astype(np.float32))
        for name, (end, curve) in curves.items()
    ]
    head = "/* Generated: 1 - exp(-x^2), tanh(x) and x / (1 + x^8)^(1/8), from 0 to their ends. */"
    return f'{head}\n\n#include "flash.h"\n\n{defines(values)}\n{"".join(tables)}'


def _network(bundle: Bundle, profile: Profile, settings: Settings, numbers: Numbers | None) -> FirmwareLaw:
    """Return a policy's network in the numbers asked for, or the best ones that fit."""
    low, high = settings.tension_range
    slice_most = min(SLICE, left_for_law(settings.control, profile.loop.control_period))
    kind = choose_numbers(bundle, settings.ticks(profile), settings.action_delay, numbers, slice_most)
    costs = jobs(bundle, kind)
    needed = slices(costs, slice_most)
    layers, remarks, most = None, list[str](), 0.0
    if kind != "float":
        inputs = recorded_inputs(bundle, with_delay(settings, needed))
        layers = quantised(bundle, inputs, kind)
        rounded, saturated = forward_numbers(layers, bundle, inputs, kind)
        exact = bundle.act(inputs).astype(np.float64)
        apart = 0.5 * (high - low) * np.abs(rounded - exact)
        rms, most = float(np.sqrt(np.mean(apart**2))), float(apart.max())
        activations = len(inputs) * sum(bundle.policy.network.layers[1:-1])
        remarks.append(
            f"The network has {kind} weights. In {len(inputs)} agent steps of `mixed`, split train, its tension "
            f"differs by {rms:.2g} N rms and at most {most:.2g} N from that in 64 bits; {saturated} of {activations} "
            "activations were at the end of their range."
        )
    remarks.append(
        f"An action takes about {sum(costs)} cycles of an ATmega2560, in {needed} slices of at most {slice_most}; an "
        f"agent period has {settings.ticks(profile)} control ticks."
    )
    files = {"weights.h": weights_header(bundle, layers, kind, slice_most)}
    return FirmwareLaw("law_network.c", {}, files, tuple(remarks), 3.0 * most, needed, slice_most)


def _constant(tension: float, settings: Settings) -> FirmwareLaw:
    """Return a constant as an environment sets it: by an action, a 32-bit number."""
    action = tension_to_action(tension, settings.tension_range).astype(np.float32)
    return FirmwareLaw("law_constant.c", {"LAW_TENSION": float(action_to_tension(action, settings.tension_range))})
