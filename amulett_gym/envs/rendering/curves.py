"""Painting of the curves of the last seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.rendering.canvas import (
    BICEPS,
    FAINT,
    FOREARM,
    GRID,
    MUTED,
    SETPOINT,
    TRICEPS,
    Canvas,
    Color,
    Point,
)
from amulett_gym.envs.rendering.frame import STRIP_SECONDS, Frame
from amulett_gym.envs.rendering.wearer import ELBOW, INTENTION, paint_assistance

_PLOT_LEFT, _PLOT_RIGHT = 66, 560
_ANGLE_PLOT, _TENSION_PLOT = (354, 432), (446, 520)
_KEY_LEFT, _KEY_RIGHT = 574, 698
_ANGLES = (("setpoint", SETPOINT, 1.5), ("joint", FOREARM, 2.0), ("elbow", ELBOW, 2.0), ("intention", INTENTION, 1.5))
_TENSIONS = (("setpoint", SETPOINT, 1.5), ("biceps", BICEPS, 2.0), ("triceps", TRICEPS, 2.0))
"""Curves of the last seconds: name, colour and width."""


def paint_curves(canvas: Canvas, frame: Frame, history: Sequence[Frame]) -> None:
    """Draw the curves: angles with their setpoints above, tensions with theirs below."""
    columns = np.array([_curves(past) for past in history], dtype=np.float64).T  # None becomes NaN
    times, angles, tensions = columns[0], np.degrees(columns[1:5]), columns[5:]
    begin = max(frame.time - STRIP_SECONDS, 0.0)
    low, high = min(np.nanmin(angles), -5.0), max(np.nanmax(angles), 95.0)
    step = 30.0 if high - low < 150.0 else 90.0
    angle = _Axes(canvas, _ANGLE_PLOT, begin, (low, high), step, "angle [deg]")
    highest = max(np.nanmax(tensions), frame.max_force) * 1.08
    tension = _Axes(canvas, _TENSION_PLOT, begin, (-0.04 * highest, highest), _tick_step(highest), "tension [N]")
    (first, below), pitch = ((24, 13), 22) if frame.wearer is None else ((10, 9), 19)
    for k, ((name, color, width), values) in enumerate(zip(_ANGLES, angles, strict=True)):
        if not np.isnan(values[-1]):
            angle.curve(canvas, times, values, color, width)
            _paint_key(canvas, _ANGLE_PLOT[0] + first + pitch * k, name, f"{values[-1]:.1f}°", color)
    for k, ((name, color, width), values) in enumerate(zip(_TENSIONS, tensions, strict=True)):
        if not np.isnan(values[-1]):
            tension.curve(canvas, times, values, color, width)
            _paint_key(canvas, _TENSION_PLOT[0] + below + pitch * k, name, f"{values[-1]:.1f} N", color)
    if frame.wearer is not None:
        y = _TENSION_PLOT[0] + below + pitch * len(_TENSIONS)
        paint_assistance(canvas, (_KEY_LEFT, y), _KEY_RIGHT, frame.wearer.assistance)
    for second in range(math.ceil(begin), math.floor(begin + STRIP_SECONDS) + 1):
        canvas.text(str(second), (angle.x(second), _TENSION_PLOT[1] + 13), 11, MUTED, align=0.5)
    canvas.text("time [s]", (_KEY_LEFT, _TENSION_PLOT[1] + 13), 11, MUTED)


def _curves(frame: Frame) -> tuple[float | None, ...]:
    """Return the time [s], and a frame's points in the curves of `_ANGLES` [rad] and `_TENSIONS` [N]."""
    worn = frame.wearer
    arm = (None, None) if worn is None else (worn.elbow_angle, worn.intention)
    angles = frame.setpoint, frame.joint_angle, *arm
    return frame.time, *angles, frame.tension_setpoint, frame.force_biceps, frame.force_triceps


class _Axes:
    """One plot of the curves, which draws its frame, grid and ticks when made."""

    def __init__(
        self, canvas: Canvas, rows: tuple[int, int], begin: float, limits: Point, step: float, name: str
    ) -> None:
        self._rows, self._begin, self._limits = rows, begin, limits
        top, bottom = rows
        for second in range(math.ceil(begin), math.floor(begin + STRIP_SECONDS) + 1):
            canvas.line((self.x(second), top), (self.x(second), bottom), GRID)
        for k in range(math.ceil(limits[0] / step), math.floor(limits[1] / step) + 1):
            y = self.y(k * step)
            canvas.line((_PLOT_LEFT, y), (_PLOT_RIGHT, y), GRID)
            canvas.text(f"{k * step:g}".replace("-", "\N{MINUS SIGN}"), (_PLOT_LEFT - 7, y), 11, MUTED, align=1.0)
        canvas.line((_PLOT_LEFT, top), (_PLOT_LEFT, bottom), FAINT)
        canvas.line((_PLOT_LEFT, bottom), (_PLOT_RIGHT, bottom), FAINT)
        canvas.text(name, (26, 0.5 * (top + bottom)), 11, MUTED, align=0.5, upright=True)

    def x(self, time: Any) -> Any:
        return _PLOT_LEFT + (time - self._begin) / STRIP_SECONDS * (_PLOT_RIGHT - _PLOT_LEFT)

    def y(self, value: Any) -> Any:
        (top, bottom), (low, high) = self._rows, self._limits
        return bottom - (value - low) / (high - low) * (bottom - top)

    def curve(
        self, canvas: Canvas, times: NDArray[np.float64], values: NDArray[np.float64], color: Color, width: float
    ) -> None:
        top, bottom = self._rows
        canvas.clip((_PLOT_LEFT, top - 2, _PLOT_RIGHT - _PLOT_LEFT + 2, bottom - top + 4))
        x, y = self.x(times), self.y(values)
        canvas.curve(np.column_stack((x, y)), color, width)
        canvas.disc((float(x[-1]), float(y[-1])), width + 0.5, color)
        canvas.clip(None)


def _paint_key(canvas: Canvas, y: float, name: str, value: str, color: Color) -> None:
    canvas.line((_KEY_LEFT, y), (_KEY_LEFT + 14, y), color, 3.0)
    canvas.text(name, (_KEY_LEFT + 20, y), 11, MUTED)
    canvas.text(value, (_KEY_RIGHT, y), 12, color, align=1.0, bold=True)


def _tick_step(highest: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that there are at most five steps to `highest`."""
    power = 10.0 ** math.floor(math.log10(highest / 5.0))
    return next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor * 5.0 >= highest)
