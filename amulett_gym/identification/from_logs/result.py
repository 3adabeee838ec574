"""A fit as plain data: parameters with intervals, what the logs do not determine, residuals, and a prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.identification.from_logs.experiments import Outlook
from amulett_gym.identification.from_logs.fit import DETERMINED, Fit
from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.physics import physics_of
from amulett_gym.identification.from_logs.recording import CHANNELS, Recording
from amulett_gym.identification.from_logs.sensors import bits_of, encoder, sliders
from amulett_gym.profile import Profile

Values = NDArray[np.float64]

OUTSIDE = 3.0
"""Standard deviations of the prior beyond which a parameter is unlike the plausible devices'."""

UNITS = {"angle": ("deg", 180.0 / np.pi), "slider": ("mm", 1000.0), "force": ("N", 1.0)}
"""How readings are shown: unit and factor, by the first word of their column."""

_SHOWN = 0.3  # of a direction's largest part: smaller ones are not named


def content(fit: Fit, base: Profile, held_out: Sequence[Recording], experiments: Sequence[Outlook]) -> dict[str, Any]:
    """Return everything that a fit found, as plain data.

    Parameters
    ----------
    fit : Fit
    base : Profile
        As of the fit.
    held_out : sequence of Recording
        To predict; not used in the fit.
    experiments : sequence of Outlook
        As of `experiments.outlooks`.
    """
    return {
        "base": base.name,
        "logs": [_log(fit, each) for each in dict.fromkeys(piece.recording.name for piece in fit.model.pieces)],
        "parameters": [_parameter(fit, k) for k in range(len(fit.prior.seen))],
        "sensors": _sensors(fit),
        "undetermined": undetermined(fit),
        "residuals": {channel: _residuals(fit, channel) for channel in fit.noise},
        "held_out": [prediction(fit, base, each) for each in held_out],
        "experiments": [vars(each) | {"determines": list(each.determines)} for each in experiments],
        "starts": list(fit.starts),
    }


def undetermined(fit: Fit) -> list[dict[str, float]]:
    """Return the directions in which the logs leave the prior's width nearly as it was, the widest first.

    Returns
    -------
    list of dict
        Parameter -> its change within one posterior standard deviation along the direction: relative if the search
        takes its logarithm. The parameters of a direction change together.
    """
    root = np.linalg.cholesky(fit.prior.covariance)
    inverse = np.linalg.inv(root)
    squares, directions = np.linalg.eigh(inverse @ fit.covariance @ inverse.T)
    found = []
    for k in np.argsort(squares)[::-1]:
        if np.sqrt(squares[k]) > DETERMINED:
            change = np.sqrt(squares[k]) * root @ directions[:, k]
            share = np.abs(change) / fit.prior.deviation
            first = int(np.argmax(share))
            change *= np.sign(change[first])
            order = [each for each in np.argsort(share)[::-1] if share[each] >= _SHOWN * share[first]]
            found.append({fit.prior.seen[each].name: float(change[each]) for each in order})
    return found


def prediction(fit: Fit, base: Profile, recording: Recording) -> dict[str, Any]:
    """Return how well a recording that was not fitted is predicted, by the fitted device and by the base."""
    model = Model(fit.model.template, [recording], whole=True)
    start = physics_of(base)
    without = {each.name: 0.0 if each.nuisance else start.get(each.name, fit.values[each.name]) for each in model.seen}
    found = model.predict([fit.values, without], fit.noise.get("slider_biceps", 0.0))
    return {"log": recording.name, "begin": _finite(recording.begin), "end": _finite(recording.end)} | {
        name: {**shown(channel_rms(model, each - model.measured))}
        for name, each in zip(("fit", "base"), found, strict=True)
    }


def channel_rms(model: Model, apart: Values) -> dict[str, float]:
    """Return the root mean square of residuals by channel [rad], [m], [N]."""
    channels = model.channel_of()
    return {CHANNELS[k]: float(np.sqrt(np.mean(apart[channels == k] ** 2))) for k in np.unique(channels)}


def shown(values: Mapping[str, float]) -> dict[str, float]:
    """Return values of channels in the units in which they are shown, with these in the name: ``angle_deg``."""
    found = {}
    for channel, value in values.items():
        unit, factor = UNITS[channel.split("_")[0]]
        found[f"{channel}_{unit}"] = value * factor
    return found


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _log(fit: Fit, name: str) -> dict[str, Any]:
    pieces = [piece for piece in fit.model.pieces if piece.recording.name == name]
    recording = pieces[0].recording
    return {
        "name": name,
        "loop": "open" if recording.open_loop else "closed",
        "columns": list(recording.columns),
        "rows": sum(piece.rows.size for piece in pieces),
        "duration": sum(piece.end - piece.begin for piece in pieces),
        "pieces": len(pieces),
        "payload": recording.payload and recording.payload.model_dump(),
    }


def _parameter(fit: Fit, k: int) -> dict[str, Any]:
    each, seen = fit.estimates[k], fit.prior.seen[k]
    apart = (fit.place[k] - fit.prior.mean[k]) / fit.prior.deviation[k]
    return {
        "name": seen.name,
        "unit": seen.unit,
        "meaning": seen.meaning,
        "value": each.value,
        "low": each.low,
        "high": each.high,
        "prior": [each.prior_low, each.prior_high],
        "narrower": float(np.sqrt(fit.covariance[k, k]) / fit.prior.deviation[k]),
        "determined": each.determined,
        "unlike_prior": bool(abs(apart) > OUTSIDE),
        "of_recording": seen.nuisance,
    }


def _sensors(fit: Fit) -> dict[str, Any]:
    angle, slider = encoder(fit), sliders(fit)
    degrees = np.degrees([angle.noise, angle.low, angle.high, angle.resolution]).tolist()
    found: dict[str, Any] = {
        "encoder": {
            **dict(zip(("noise_deg", "low_deg", "high_deg", "resolution_deg"), degrees, strict=True)),
            "bits": bits_of(angle, 2.0 * np.pi),
        }
    }
    return found if slider is None else {**found, "sliders": vars(slider)}


def _residuals(fit: Fit, channel: str) -> dict[str, Any]:
    test = fit.whiteness[channel]
    rms = next(iter(shown({channel: fit.noise[channel]}).items()))
    return {
        "rms": rms[1],
        "unit": rms[0].rsplit("_", 1)[1],
        "p": test.p,
        "largest_autocorrelation": test.largest,
        "rows_that_count_as_one": test.time,
    }
