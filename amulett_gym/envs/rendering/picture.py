"""Painting of a frame: the arm with its strings above, curves of the last seconds below.

Shapes are drawn at twice the size and scaled down, for smooth edges; text is drawn last, at its final size. Positions
are in pixels of the final picture, y downwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from importlib.util import find_spec
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from amulett_gym.envs.rendering.frame import STRIP_SECONDS, Frame

SIZE = (720, 560)
_OVERSAMPLING = 2

Point = tuple[float, float]
Color = tuple[int, int, int]

_PAGE, _CARD, _GRID = (241, 244, 248), (255, 255, 255), (228, 232, 238)
_FAINT, _MUTED, _INK = (190, 199, 209), (104, 117, 132), (31, 41, 55)
_BEAM, _FOREARM = (214, 220, 228), (72, 90, 112)
_BICEPS, _TRICEPS, _SETPOINT, _EXTERNAL = (15, 118, 178), (199, 98, 20), (28, 145, 90), (204, 36, 48)

_TENSION_COLORS = ((250, 207, 155), (250, 150, 100), (228, 85, 95), (176, 52, 122), (112, 31, 128), (52, 16, 92))
"""From no force to saturation, in even steps of brightness (matplotlib's magma): readable without colour vision."""

_ARM_CARD, _STRIP_CARD = (10, 10, 700, 322), (10, 340, 700, 210)
_PLOT_LEFT, _PLOT_RIGHT = 66, 560
_ANGLE_PLOT, _TENSION_PLOT = (354, 432), (446, 520)
_KEY_LEFT = 574

_JOINT: Point = (352.0, 236.0)
_PULLEY = 44.0  # joint pulley's radius
_FOREARM_LENGTH, _FOREARM_WIDTH = 172.0, 24.0
_SCALE_RADIUS = 190.0
_DRIVE_X, _BEAM_LEFT = 100.0, 58.0
_SPRING_LENGTH = 44.0
_ABOVE, _BELOW = -1.0, 1.0  # sides of the upper arm: biceps, triceps
_SPRING_AT = {_ABOVE: 306.0, _BELOW: 250.0}  # where the springs end when the arm is straight
_BAR = (556.0, 76.0, 138.0, 9.0)  # colour bar: left, top, width, height
_GAUGE = (256.0, 314.0, 192.0, 6.0)  # of the joint stiffness: left, top, width, height
_STRETCH = 2.0  # magnification of a spring's stretch, relative to the pulleys' scale


def size_of(arms: int) -> tuple[int, int]:
    """Return the width and height of a picture of several arms, on a grid that is nearly square."""
    columns = math.ceil(math.sqrt(arms))
    return columns * SIZE[0], math.ceil(arms / columns) * SIZE[1]


def paint_all(histories: Sequence[Sequence[Frame]], titles: Sequence[str]) -> pygame.Surface:
    """Paint each arm's last frame, with its past, side by side."""
    pictures = [paint(past[-1], past, title) for past, title in zip(histories, titles, strict=True)]
    if len(pictures) == 1:
        return pictures[0]
    whole = pygame.Surface(size_of(len(pictures)), depth=32)
    whole.fill(_PAGE)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, whole.get_width() // SIZE[0])
        whole.blit(picture, (column * SIZE[0], row * SIZE[1]))
    return whole


def paint(frame: Frame, history: Sequence[Frame], title: str) -> pygame.Surface:
    """Return a picture of `SIZE`, 32 bit: the arm in `frame`, and curves of `history`, which ends with `frame`."""
    canvas = _Canvas(_background().copy())
    x, y, width, height = _ARM_CARD
    canvas.clip((x + 1, y + 1, width - 2, height - 2))
    _paint_strings(canvas, frame)
    _paint_drives(canvas, frame)
    if frame.obstacle_angle is not None:
        _paint_obstacle(canvas, frame, frame.obstacle_angle)
    _paint_setpoint(canvas, frame.setpoint)
    _paint_forearm(canvas, frame)
    if frame.push_torque != 0.0:
        _paint_push(canvas, frame)
    _paint_tension_scale(canvas, frame)
    _paint_stiffness(canvas, frame)
    canvas.clip(None)
    canvas.text(title, (24, 31), 15, bold=True)
    canvas.text(f"{frame.time:.2f} s", (696, 31), 15, align=1.0, bold=True)
    if frame.agonist is None:
        canvas.text("position-only control", (24, 52), 11, _MUTED)
    if frame.failure:
        canvas.text(f"failed: {frame.failure}", (360, 31), 13, _EXTERNAL, align=0.5, bold=True)
    _paint_strip(canvas, frame, history)
    return canvas.finish()


class _Canvas:
    """Draws shapes on an enlarged surface, and text on the final one."""

    def __init__(self, surface: pygame.Surface) -> None:
        self._surface = surface
        self._texts: list[tuple[pygame.Surface, Point, float]] = []

    def clip(self, area: tuple[float, float, float, float] | None) -> None:
        self._surface.set_clip(None if area is None else pygame.Rect([round(_OVERSAMPLING * side) for side in area]))

    def line(self, start: Point, end: Point, color: Color, width: float = 1.0) -> None:
        # As a polygon: pygame's thick lines are cut off along an axis, and their width depends on the direction.
        length = math.dist(start, end)
        if length > 0.0:
            dx, dy = (end[0] - start[0]) * 0.5 * width / length, (end[1] - start[1]) * 0.5 * width / length
            ends = [(start, -1), (start, 1), (end, 1), (end, -1)]
            self.polygon([(point[0] - side * dy, point[1] + side * dx) for point, side in ends], color)

    def lines(self, points: Sequence[Point], color: Color, width: float = 1.0) -> None:
        for start, end in pairwise(points):
            self.line(start, end, color, width)
        for point in points:
            self.disc(point, 0.5 * width, color)

    def curve(self, points: NDArray[np.float64], color: Color, width: float) -> None:
        if len(points) > 1:
            pixels = (points * _OVERSAMPLING).tolist()
            pygame.draw.lines(self._surface, color, False, pixels, round(width * _OVERSAMPLING))

    def dashes(self, start: Point, end: Point, color: Color, width: float, dash: float = 7.0, gap: float = 5.0) -> None:
        length, at = math.dist(start, end), 0.0
        while at < length:
            stop = _between(start, end, min(at + dash, length) / length)
            self.line(_between(start, end, at / length), stop, color, width)
            at += dash + gap

    def polygon(self, points: Sequence[Point], color: Color) -> None:
        pygame.draw.polygon(self._surface, color, [(_OVERSAMPLING * x, _OVERSAMPLING * y) for x, y in points])

    def disc(self, center: Point, radius: float, color: Color) -> None:
        pixels = (_OVERSAMPLING * center[0], _OVERSAMPLING * center[1])
        pygame.draw.circle(self._surface, color, pixels, _OVERSAMPLING * radius)

    def ring(self, center: Point, radius: float, edge: Color, fill: Color, width: float = 1.5) -> None:
        self.disc(center, radius + 0.5 * width, edge)
        self.disc(center, radius - 0.5 * width, fill)

    def box(self, area: tuple[float, float, float, float], color: Color, radius: float = 0.0) -> None:
        rectangle = pygame.Rect([round(_OVERSAMPLING * side) for side in area])
        pygame.draw.rect(self._surface, color, rectangle, border_radius=round(_OVERSAMPLING * radius))

    def text(self, text: str, at: Point, size: int, color: Color = _INK, align: float = 0.0, **style: bool) -> float:
        """Write text (`bold`, `upright`), vertically centred on `at`; return its width.

        `align` is 0 if the text begins at `at`, 0.5 if it is centred there, 1 if it ends there.
        """
        label = _label(text, size, color, **style)
        self._texts.append((label, at, align))
        return float(label.get_width())

    def finish(self) -> pygame.Surface:
        picture = pygame.transform.smoothscale(self._surface, SIZE)
        for label, (x, y), align in self._texts:
            picture.blit(label, (round(x - align * label.get_width()), round(y - 0.5 * label.get_height())))
        return picture


@lru_cache(maxsize=1)
def _background() -> pygame.Surface:
    """Return the enlarged parts that never change: cards, upper arm, angle scale, colour bar."""
    surface = pygame.Surface((SIZE[0] * _OVERSAMPLING, SIZE[1] * _OVERSAMPLING), depth=32)
    surface.fill(_PAGE)
    canvas = _Canvas(surface)
    for card in (_ARM_CARD, _STRIP_CARD):
        canvas.box((card[0] - 1, card[1] - 1, card[2] + 2, card[3] + 2), _GRID, 9)
        canvas.box(card, _CARD, 8)
    for degrees in range(-20, 121, 10):
        major = degrees % 30 == 0
        angle = math.radians(degrees)
        start, end = _polar(_SCALE_RADIUS, angle), _polar(_SCALE_RADIUS + (8 if major else 5), angle)
        canvas.line(start, end, _MUTED if major else _FAINT, 1.5 if major else 1.0)
    canvas.lines([_polar(_SCALE_RADIUS, math.radians(degrees)) for degrees in range(-20, 121)], _FAINT, 1.0)
    # The upper arm is fixed to the ground, and carries both motors.
    x, y = _JOINT
    for k in range(8):
        canvas.line((_BEAM_LEFT, y - 36 + 10 * k), (_BEAM_LEFT - 10, y - 28 + 10 * k), _FAINT, 1.5)
    canvas.line((_BEAM_LEFT, y - 40), (_BEAM_LEFT, y + 44), _MUTED, 2.0)
    canvas.box((_BEAM_LEFT, y - 11, x - _BEAM_LEFT, 22), _MUTED, 3)
    canvas.box((_BEAM_LEFT + 1.5, y - 9.5, x - _BEAM_LEFT, 19), _BEAM, 2)
    canvas.box((_DRIVE_X - 26, y - 62, 52, 124), _MUTED, 9)
    canvas.box((_DRIVE_X - 24.5, y - 60.5, 49, 121), _BEAM, 8)
    left, top, width, height = _BAR
    for column in range(int(width) * _OVERSAMPLING):
        share = column / (width * _OVERSAMPLING - 1)
        canvas.box((left + column / _OVERSAMPLING, top, 1 / _OVERSAMPLING, height), _tension_color(share))
    return surface


def _paint_strings(canvas: _Canvas, frame: Frame) -> None:
    """Draw both strings: around the drive's pulley, over the spring, around the joint's pulley."""
    scale = _PULLEY / frame.joint_radius
    for side, force, deflection in (
        (_ABOVE, frame.force_biceps, frame.deflection_biceps),
        (_BELOW, frame.force_triceps, frame.deflection_triceps),
    ):
        share = force / frame.max_force
        color = _tension_color(share) if force > 0.0 else _FAINT
        thickness = 2.0 + 2.5 * min(share, 1.0)
        y = _JOINT[1] + side * _PULLEY
        spring_end = _SPRING_AT[side] + side * _PULLEY * frame.joint_angle
        spring_end = min(max(spring_end, _DRIVE_X + 80.0), _JOINT[0] - 18.0)
        spring_start = spring_end - _SPRING_LENGTH - _STRETCH * scale * max(deflection, 0.0)
        spring_start = max(spring_start, _DRIVE_X + 24.0)
        slack = scale * max(-deflection, 0.0)
        leaves_at = -side * max(-side * frame.joint_angle, math.pi / 2)
        leaves = _polar(_PULLEY, leaves_at)
        _paint_string(canvas, (_DRIVE_X, y), (spring_start, y), slack, color, thickness)
        _paint_string(canvas, (spring_end, y), leaves, slack, color, thickness)
        _paint_spring(canvas, spring_start, spring_end, y, color)
        steps = 1 + int(abs(leaves_at - frame.joint_angle) / 0.1)
        arc = [leaves_at + (frame.joint_angle - leaves_at) * k / steps for k in range(steps + 1)]
        canvas.lines([_polar(_PULLEY, angle) for angle in arc], color, thickness)
        text = f"{force:.1f} N" if force > 0.0 else "slack"
        canvas.text(text, (_DRIVE_X + 34, y - side * 18), 12, _INK if force > 0.0 else _EXTERNAL)


def _paint_string(canvas: _Canvas, start: Point, end: Point, slack: float, color: Color, thickness: float) -> None:
    """Draw a piece of string; a slack one sags by its spare length."""
    length = math.dist(start, end)
    sag = min(math.sqrt(0.375 * length * slack), 14.0)
    pieces = 12 if sag > 0.5 else 1
    points = []
    for k in range(pieces + 1):
        x, y = _between(start, end, k / pieces)
        points.append((x, y + 4.0 * sag * (k / pieces) * (1.0 - k / pieces)))
    canvas.lines(points, color, thickness)


def _paint_spring(canvas: _Canvas, left: float, right: float, y: float, color: Color) -> None:
    coils, lead, height = 7, 4.0, 8.0
    pitch = (right - left - 2.0 * lead) / (2 * coils)
    heights = [0.0, *(height, -height) * (coils - 1), height, 0.0]
    zigzag = [(left + lead + pitch * k, y + offset) for k, offset in enumerate(heights)]
    canvas.lines([(left, y), *zigzag, (right, y)], color, 2.0)
    for x in (left, right):
        canvas.disc((x, y), 3.0, color)


def _paint_drives(canvas: _Canvas, frame: Frame) -> None:
    """Draw both motors with their names and turned pulleys, and mark the agonist."""
    radius = min(max(_PULLEY * frame.drive_radius / frame.joint_radius, 9.0), 20.0)
    for side, name, angle, color in (
        (_ABOVE, "biceps", frame.drive_biceps, _BICEPS),
        (_BELOW, "triceps", frame.drive_triceps, _TRICEPS),
    ):
        center = (_DRIVE_X, _JOINT[1] + side * (_PULLEY - radius))
        canvas.ring(center, radius, color, _CARD, 2.5)
        canvas.line(center, _polar(radius - 1.0, angle, center), color, 3.0)
        canvas.disc(center, 3.0, color)
        at = (_DRIVE_X - 26, _JOINT[1] + side * 75)
        width = canvas.text(name, at, 13, color, bold=True)
        if frame.agonist == -side:
            canvas.box((at[0] + width + 7, at[1] - 8, 58, 17), color, 8)
            canvas.text("agonist", (at[0] + width + 36, at[1]), 11, _CARD, align=0.5, bold=True)


def _paint_setpoint(canvas: _Canvas, setpoint: float) -> None:
    canvas.dashes(_polar(_PULLEY, setpoint), _polar(_SCALE_RADIUS, setpoint), _SETPOINT, 2.0)
    tip = _polar(_SCALE_RADIUS - 1.0, setpoint)
    sides = [_polar(_SCALE_RADIUS + 12.0, setpoint + turn) for turn in (-0.035, 0.035)]
    canvas.polygon([tip, *sides], _SETPOINT)


def _paint_forearm(canvas: _Canvas, frame: Frame) -> None:
    angle, wide, narrow = frame.joint_angle, 0.5 * _FOREARM_WIDTH, 0.36 * _FOREARM_WIDTH
    for grow, color in ((0.0, _FOREARM), (-2.0, _tint(_FOREARM, 0.25))):
        ends = ((0.0, wide, 1), (_FOREARM_LENGTH, narrow, 1), (_FOREARM_LENGTH, narrow, -1), (0.0, wide, -1))
        canvas.polygon([_offset(along, side * (half + grow), angle) for along, half, side in ends], color)
        canvas.disc(_polar(_FOREARM_LENGTH, angle), narrow + grow, color)
    canvas.line(_polar(_FOREARM_LENGTH + narrow, angle), _polar(_SCALE_RADIUS, angle), _FOREARM, 2.0)
    canvas.ring(_JOINT, _PULLEY - 6.0, _FOREARM, _CARD, 2.0)
    for turn in (0.0, math.pi / 2, math.pi, 3 * math.pi / 2):
        canvas.line(_JOINT, _polar(_PULLEY - 7.0, angle + turn), _FOREARM if turn == 0.0 else _FAINT, 3.0)
    canvas.ring(_JOINT, 8.0, _FOREARM, _CARD, 3.0)
    if frame.payload_mass > 0.0:
        x, y = _polar(_FOREARM_LENGTH, angle)
        canvas.disc((x, y), 17.0, _INK)
        canvas.text(f"{frame.payload_mass:.2g}", (x, y - 4), 11, _CARD, align=0.5, bold=True)
        canvas.text("kg", (x, y + 7), 9, _CARD, align=0.5)


def _paint_obstacle(canvas: _Canvas, frame: Frame, angle: float) -> None:
    """Draw a hatched block that the forearm's edge touches at the obstacle's angle."""
    touched = frame.contact_torque != 0.0
    edge, fill = (_EXTERNAL, _tint(_EXTERNAL, 0.75)) if touched else (_MUTED, _tint(_MUTED, 0.8))
    near, far, depth = 0.5 * _FOREARM_LENGTH, 0.86 * _FOREARM_LENGTH, 30.0

    def corner(along: float, into: float) -> Point:
        return _offset(along, frame.obstacle_side * (0.42 * _FOREARM_WIDTH + into), angle)

    canvas.polygon([corner(near, 0.0), corner(far, 0.0), corner(far, depth), corner(near, depth)], fill)
    start = near - depth
    while start < far:
        low, high = max(start, near), min(start + depth, far)
        canvas.line(corner(low, low - start), corner(high, high - start), edge, 1.25)
        start += 9.0
    canvas.line(corner(near, 0.0), corner(far, 0.0), edge, 3.0)
    if touched:
        _paint_torque(canvas, "contact", frame.contact_torque, corner(near, 0.0), corner(near, depth + 16.0))


def _paint_push(canvas: _Canvas, frame: Frame) -> None:
    """Draw an arrow onto the forearm; its length grows with the torque relative to that of a saturated spring."""
    side = math.copysign(1.0, frame.push_torque)
    strength = min(abs(frame.push_torque) / (frame.max_force * frame.joint_radius), 1.0)
    along, begin = 0.8 * _FOREARM_LENGTH, 0.5 * _FOREARM_WIDTH
    length = 30.0 + 50.0 * strength

    def point(distance: float, shift: float = 0.0) -> Point:
        return _offset(along + shift, -side * (begin + distance), frame.joint_angle)

    canvas.line(point(10.0), point(length), _EXTERNAL, 5.0)
    canvas.polygon([point(0.0), point(15.0, 9.0), point(15.0, -9.0)], _EXTERNAL)
    _paint_torque(canvas, "push", frame.push_torque, point(0.0), point(length + 4.0))


def _paint_torque(canvas: _Canvas, name: str, torque: float, tip: Point, tail: Point) -> None:
    """Write a torque next to the tail of its arrow or block, clear of it in every direction."""
    length = math.dist(tip, tail)
    x, y = tail[0] + 66.0 * (tail[0] - tip[0]) / length, tail[1] + 11.0 * (tail[1] - tip[1]) / length
    at = (min(max(x, 80.0), 630.0), min(max(y, 50.0), 320.0))
    canvas.text(f"{name} {torque:+.2f} N m".replace("-", "\N{MINUS SIGN}"), at, 12, _EXTERNAL, align=0.5, bold=True)


def _paint_tension_scale(canvas: _Canvas, frame: Frame) -> None:
    """Label the colour bar of the string tensions and the angle scale; mark the present forces."""
    left, top, width, height = _BAR
    canvas.text("string tension [N]", (left + 0.5 * width, top - 19), 11, _MUTED, align=0.5)
    for share in (0.0, 0.5, 1.0):
        canvas.text(f"{share * frame.max_force:.0f}", (left + share * width, top + height + 15), 11, _MUTED, align=0.5)
    for force, color, y, side in (
        (frame.force_biceps, _BICEPS, top - 1, -1),
        (frame.force_triceps, _TRICEPS, top + height + 1, 1),
    ):
        x = left + width * min(force / frame.max_force, 1.0)
        canvas.polygon([(x, y), (x - 4.5, y + 7 * side), (x + 4.5, y + 7 * side)], color)
    for degrees in (0, 30, 60, 90, 120):
        angle = math.radians(degrees)
        canvas.text(f"{degrees}°", _polar(_SCALE_RADIUS + 22, angle), 11, _MUTED, align=0.5 - 0.35 * math.cos(angle))


def _paint_stiffness(canvas: _Canvas, frame: Frame) -> None:
    """Write the joint stiffness below the joint, over a gauge from 0 to its maximum."""
    left, top, width, height = _GAUGE
    canvas.text("joint stiffness", (left, top - 12), 11, _MUTED)
    canvas.text(f"{frame.joint_stiffness:.1f} N m/rad", (left + width, top - 12), 12, _FOREARM, align=1.0, bold=True)
    share = min(frame.joint_stiffness / frame.max_stiffness, 1.0)
    for end, color in ((width, _GRID), (max(share * width, height), _FOREARM)):
        canvas.box((left, top, end, height), color, 0.5 * height)


def _paint_strip(canvas: _Canvas, frame: Frame, history: Sequence[Frame]) -> None:
    """Draw the curves: angle with its setpoint above, tensions with theirs below."""
    values = attrgetter("time", "setpoint", "joint_angle", "tension_setpoint", "force_biceps", "force_triceps")
    rows = np.array([values(past) for past in history], dtype=np.float64)  # a tension setpoint of None becomes NaN
    rows[:, 1:3] = np.degrees(rows[:, 1:3])
    begin = max(frame.time - STRIP_SECONDS, 0.0)
    low, high = min(rows[:, 1:3].min(), -5.0), max(rows[:, 1:3].max(), 95.0)
    step = 30.0 if high - low < 150.0 else 90.0
    angle = _Axes(canvas, _ANGLE_PLOT, begin, (low, high), step, "angle [deg]")
    highest = max(np.nanmax(rows[:, 3:]), frame.max_force) * 1.08
    tension = _Axes(canvas, _TENSION_PLOT, begin, (-0.04 * highest, highest), _tick_step(highest), "tension [N]")
    angle.curve(canvas, rows[:, 0], rows[:, 1], _SETPOINT, 1.5)
    angle.curve(canvas, rows[:, 0], rows[:, 2], _FOREARM, 2.0)
    if frame.tension_setpoint is not None:
        tension.curve(canvas, rows[:, 0], rows[:, 3], _SETPOINT, 1.5)
    tension.curve(canvas, rows[:, 0], rows[:, 4], _BICEPS, 2.0)
    tension.curve(canvas, rows[:, 0], rows[:, 5], _TRICEPS, 2.0)
    for second in range(math.ceil(begin), math.floor(begin + STRIP_SECONDS) + 1):
        canvas.text(str(second), (angle.x(second), _TENSION_PLOT[1] + 13), 11, _MUTED, align=0.5)
    canvas.text("time [s]", (_KEY_LEFT, _TENSION_PLOT[1] + 13), 11, _MUTED)
    _paint_key(canvas, _ANGLE_PLOT[0] + 24, "setpoint", f"{math.degrees(frame.setpoint):.1f}°", _SETPOINT)
    _paint_key(canvas, _ANGLE_PLOT[0] + 46, "joint", f"{math.degrees(frame.joint_angle):.1f}°", _FOREARM)
    if frame.tension_setpoint is not None:
        _paint_key(canvas, _TENSION_PLOT[0] + 13, "setpoint", f"{frame.tension_setpoint:.1f} N", _SETPOINT)
    _paint_key(canvas, _TENSION_PLOT[0] + 35, "biceps", f"{frame.force_biceps:.1f} N", _BICEPS)
    _paint_key(canvas, _TENSION_PLOT[0] + 57, "triceps", f"{frame.force_triceps:.1f} N", _TRICEPS)


class _Axes:
    """One plot of the curves, which draws its frame, grid and ticks when made."""

    def __init__(
        self, canvas: _Canvas, rows: tuple[int, int], begin: float, limits: Point, step: float, name: str
    ) -> None:
        self._rows, self._begin, self._limits = rows, begin, limits
        top, bottom = rows
        for second in range(math.ceil(begin), math.floor(begin + STRIP_SECONDS) + 1):
            canvas.line((self.x(second), top), (self.x(second), bottom), _GRID)
        for k in range(math.ceil(limits[0] / step), math.floor(limits[1] / step) + 1):
            y = self.y(k * step)
            canvas.line((_PLOT_LEFT, y), (_PLOT_RIGHT, y), _GRID)
            canvas.text(f"{k * step:g}".replace("-", "\N{MINUS SIGN}"), (_PLOT_LEFT - 7, y), 11, _MUTED, align=1.0)
        canvas.line((_PLOT_LEFT, top), (_PLOT_LEFT, bottom), _FAINT)
        canvas.line((_PLOT_LEFT, bottom), (_PLOT_RIGHT, bottom), _FAINT)
        canvas.text(name, (26, 0.5 * (top + bottom)), 11, _MUTED, align=0.5, upright=True)

    def x(self, time: Any) -> Any:
        return _PLOT_LEFT + (time - self._begin) / STRIP_SECONDS * (_PLOT_RIGHT - _PLOT_LEFT)

    def y(self, value: Any) -> Any:
        (top, bottom), (low, high) = self._rows, self._limits
        return bottom - (value - low) / (high - low) * (bottom - top)

    def curve(
        self, canvas: _Canvas, times: NDArray[np.float64], values: NDArray[np.float64], color: Color, width: float
    ) -> None:
        top, bottom = self._rows
        canvas.clip((_PLOT_LEFT, top - 2, _PLOT_RIGHT - _PLOT_LEFT + 2, bottom - top + 4))
        x, y = self.x(times), self.y(values)
        canvas.curve(np.column_stack((x, y)), color, width)
        canvas.disc((float(x[-1]), float(y[-1])), width + 0.5, color)
        canvas.clip(None)


def _paint_key(canvas: _Canvas, y: float, name: str, value: str, color: Color) -> None:
    canvas.line((_KEY_LEFT, y), (_KEY_LEFT + 14, y), color, 3.0)
    canvas.text(name, (_KEY_LEFT + 20, y), 11, _MUTED)
    canvas.text(value, (698, y), 12, color, align=1.0, bold=True)


def _polar(radius: float, angle: float, center: Point = _JOINT) -> Point:
    return center[0] + radius * math.cos(angle), center[1] - radius * math.sin(angle)


def _offset(along: float, offset: float, angle: float) -> Point:
    """Return the point `along` the forearm at `angle`, moved by `offset` to its flexion side."""
    x, y = _polar(along, angle)
    return x - offset * math.sin(angle), y - offset * math.cos(angle)


def _between(start: Point, end: Point, share: float) -> Point:
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])


def _tint(color: Color, share: float) -> Color:
    return _mixed(color, (255, 255, 255), share)


def _tension_color(share: float) -> Color:
    """Return the colour of a string force, given as a share of the springs' saturation force."""
    at = min(max(share, 0.0), 1.0) * (len(_TENSION_COLORS) - 1)
    k = min(int(at), len(_TENSION_COLORS) - 2)
    return _mixed(_TENSION_COLORS[k], _TENSION_COLORS[k + 1], at - k)


def _mixed(first: Color, second: Color, share: float) -> Color:
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue


def _tick_step(highest: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that there are at most five steps to `highest`."""
    power = 10.0 ** math.floor(math.log10(highest / 5.0))
    return next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor * 5.0 >= highest)


@lru_cache(maxsize=4000)
def _label(text: str, size: int, color: Color, bold: bool = False, upright: bool = False) -> pygame.Surface:
    try:
        label = _font(size, bold).render(text, True, color)
    except pygame.error:  # another environment's close() called pygame.quit(), which invalidates fonts
        _font.cache_clear()
        label = _font(size, bold).render(text, True, color)
    return pygame.transform.rotate(label, 90) if upright else label


@cache
def _font(size: int, bold: bool) -> pygame.font.Font:
    pygame.font.init()
    return pygame.font.Font(_font_file(bold), size)


def _font_file(bold: bool) -> Path | None:
    """Return matplotlib's font, so that pictures look the same on every computer; None (pygame's own) without it."""
    found = find_spec("matplotlib")
    for folder in (found.submodule_search_locations or []) if found else []:
        path = Path(folder) / "mpl-data" / "fonts" / "ttf" / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
        if path.is_file():
            return path
    return None
