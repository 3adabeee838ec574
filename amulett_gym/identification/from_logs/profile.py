"""A fit as a profile, with the interval and source of each value, and its posterior as a fleet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from amulett_gym.identification.from_logs.fit import Fit, values_at
from amulett_gym.identification.from_logs.physics import device
from amulett_gym.identification.from_logs.sensors import bits_of, encoder, sliders
from amulett_gym.profile import Profile, is_shipped, load_profile

_KEYS = {
    "plant": {"masses": "inertia", "drive_pulley_radius": "radius_ratio", "joint_pulley_radius": "joint_pulley_radius"},
    "spring": {
        "stiffness": "stiffness",
        "half_width": "half_width",
        "free_length": "length_ratio",
        "max_deflection": "max_force",
    },
    "damping": {"a": "damping", "b": "damping_preload", "c": "damping_preload", "d": "damping"},
    "drives": {"lag": "lag", "rate_limit_deg": "rate_limit", "stall_torque": "stall_torque"},
}
"""Key of a profile's group -> parameter of the fit."""

_DIGITS = 6


def profile_content(fit: Fit, base: Profile, name: str) -> dict[str, Any]:
    """Return the fitted profile as plain data: what differs from the base, with interval and source of each value.

    Parameters
    ----------
    fit : Fit
    base : Profile
        As of the fit.
    name : str
        Of the profile.
    """
    logs = ", ".join(dict.fromkeys(piece.recording.name for piece in fit.model.pieces))
    fitted, sensors = device(fit.model.template, fit.values), _sensors(fit, base)
    content = _content(fitted, base, name, f"Fitted to {logs}.", sensors)
    estimates = {each.seen.name: each for each in fit.estimates}
    for group, changed in _changes(fitted, base).items():
        sources = dict.fromkeys(changed, "assumed: as of the plausible devices that explain the logs best")
        for key in changed:
            if (parameter := _KEYS[group].get(key)) in estimates:
                each = estimates[parameter]
                unit = f" {each.seen.unit}" if each.seen.unit else ""
                how = f"from {logs}" if each.determined else f"hardly from {logs}: most of it is the prior"
                text = f"{parameter} {each.value:.4g}{unit} ({each.low:.4g} to {each.high:.4g}, 90 %), {how}"
                sources[key] = f"identified: {text}"
        content[group]["sources"] = content[group].get("sources", {}) | sources
    sources = dict.fromkeys(sensors, f"identified: residuals of {logs}")
    content["sensors"]["sources"] = content["sensors"].get("sources", {}) | sources
    load_profile(content)
    return content


def draw_fleet(fit: Fit, base: Profile, name: str, count: int, seed: int) -> list[dict[str, Any]]:
    """Return devices drawn from a fit's posterior, as plain data of profiles named ``NAME-01`` and so on."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(fit.covariance)
    sensors = _sensors(fit, base)
    found = []
    for k in range(count):
        values = values_at(fit.prior.seen, fit.place + root @ rng.standard_normal(fit.place.size))
        own = f"{name}-{k + 1:0{len(str(count))}d}"
        content = _content(
            device(fit.model.template, values), base, own, "A draw from the posterior of a fit.", sensors
        )
        load_profile(content)
        found.append(content)
    return found


def _sensors(fit: Fit, base: Profile) -> dict[str, Any]:
    """Return the changes of the base's sensors: noise, and the resolution where the logs show one."""
    found: dict[str, Any] = {}
    if any(part.channel == "angle" for part in fit.model.parts):
        angle = encoder(fit)
        found["encoder_noise_deg"] = _rounded(math.degrees(angle.noise))
        if (bits := bits_of(angle, 2.0 * math.pi)) is not None:
            found["encoder_bits"] = bits
    if (slider := sliders(fit)) is not None:
        found["potentiometer_noise"] = _rounded(slider.noise)
        if slider.resolution > 0.0 and base.sensors.potentiometer_bits:
            found["potentiometer_travel"] = _rounded(slider.resolution * 2**base.sensors.potentiometer_bits)
    return found


def _content(
    profile: Profile, base: Profile, name: str, description: str, sensors: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a profile as its differences from the base, in rounded numbers."""
    start: dict[str, Any] = {"base": base.name} if is_shipped(base) else base.model_dump(mode="json")
    changes = {**_changes(profile, base), "sensors": sensors}
    merged = {group: {**start.get(group, {}), **changed} for group, changed in changes.items()}
    return {**start, "name": name, "description": description, **merged}


def _changes(profile: Profile, base: Profile) -> dict[str, dict[str, Any]]:
    """Return the keys of the fitted groups whose rounded values are not the base's."""
    new, old = (each.model_dump(mode="json", include=set(_KEYS)) for each in (profile, base))
    rounded = {group: {key: _plain(value) for key, value in new[group].items() if key != "sources"} for group in _KEYS}
    return {
        group: {key: value for key, value in values.items() if value != old[group].get(key)}
        for group, values in rounded.items()
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return _rounded(value) if isinstance(value, float) else value


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
