"""The sensors' noise and resolution by a fit's residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulett_gym.identification.from_logs.fit import QUANTILE, Fit
from amulett_gym.identification.from_logs.noise import resolution
from amulett_gym.identification.from_logs.recording import SLIDERS

Values = NDArray[np.float64]

_ABOVE = 3.0  # standard deviations from 0 at which a slider's noise is not clipped
_DOUBT = 0.02  # of the noise: it is not quite normal, and not quite independent of the rounding
_MEDIAN = 2.1  # factor of the standard deviation of a noise by the median of third differences, by simulation
_MOST_BITS = 24


@dataclass(frozen=True)
class Sensor:
    """A sensor's noise without its rounding, with a 90 % interval, and its resolution, 0 if none shows; SI units."""

    noise: float
    low: float
    high: float
    resolution: float


def encoder(fit: Fit) -> Sensor:
    """Return the joint encoder's noise and resolution [rad]."""
    return _sensor(fit, ("angle",))


def sliders(fit: Fit) -> Sensor | None:
    """Return the potentiometers' noise and resolution [m]; None if no log has sliders."""
    return _sensor(fit, SLIDERS) if any(part.channel in SLIDERS for part in fit.model.parts) else None


def bits_of(sensor: Sensor, full: float) -> int | None:
    """Return the bits by which a sensor divides its full range; None if it shows no whole number of them."""
    if sensor.resolution <= 0.0:
        return None
    bits = math.log2(full / sensor.resolution)
    return round(bits) if abs(bits - round(bits)) < 0.02 and 0 < bits < _MOST_BITS else None


def _sensor(fit: Fit, channels: tuple[str, ...]) -> Sensor:
    parts = [part for part in fit.model.parts if part.channel in channels]
    measured, predicted = (
        np.concatenate([values[part.cells] for part in parts]) for values in (fit.model.measured, fit.predicted)
    )
    steps = [
        resolution(np.concatenate([fit.model.measured[part.cells] for part in parts if part.channel == channel]))
        for channel in {part.channel for part in parts}
    ]
    step = min(steps)
    if not all(fit.model.piece_of(part).recording.open_loop for part in parts):  # residuals are the joint's motion too
        return _by_differences(fit, channels, step, measured.size)
    apart = measured - predicted
    if channels == SLIDERS:
        clear = apart[predicted > _ABOVE * np.median(np.abs(apart)) / 0.6745]
        apart = clear if clear.size > 100 else apart
    total = float(np.mean(apart**2))
    noise = math.sqrt(max(total - step**2 / 12.0, 1e-4 * total))
    rows = apart.size / max(fit.whiteness[channel].time for channel in channels if channel in fit.whiteness)
    share = (QUANTILE / math.sqrt(2.0 * rows)) * total / noise**2 + _DOUBT
    return Sensor(noise, noise / (1.0 + share), noise * (1.0 + share), step)


def _by_differences(fit: Fit, channels: tuple[str, ...], step: float, rows: int) -> Sensor:
    """Return the noise that the model's simulations in closed loop have, which is that of the readings' differences."""
    sensors = fit.model.noisy.sensors
    total = sensors.potentiometer_noise if channels == SLIDERS else math.radians(sensors.encoder_noise_deg)
    noise = math.sqrt(max(total**2 - step**2 / 12.0, 1e-4 * total**2))
    share = (_MEDIAN * QUANTILE / math.sqrt(2.0 * rows)) * (total / noise) ** 2 + _DOUBT
    return Sensor(noise, noise / (1.0 + share), noise * (1.0 + share), step)
