"""Painting of a frame: the arm with its strings above, curves of the last seconds below.

Shapes are drawn at twice the size and scaled down, for smooth edges; text is drawn last, at its final size. Positions
are in pixels of the final picture, y downwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import pygame

from amulett_gym.envs.rendering.canvas import (
    BEAM,
    BICEPS,
    CARD,
    EXTERNAL,
    FAINT,
    FOREARM,
    FOREARM_LENGTH,
    FOREARM_WIDTH,
    GRID,
    INK,
    JOINT,
    MUTED,
    OVERSAMPLING,
    PAGE,
    SCALE_RADIUS,
    SETPOINT,
    SIZE,
    TRICEPS,
    Canvas,
    Color,
    Point,
    between,
    mixed,
    offset,
    polar,
    tint,
)
from amulett_gym.envs.rendering.curves import paint_curves
from amulett_gym.envs.rendering.frame import Frame
from amulett_gym.envs.rendering.wearer import HAND, LINK_LENGTH, paint_arm, paint_cuffs, paint_readouts

_TENSION_COLORS = ((250, 207, 155), (250, 150, 100), (228, 85, 95), (176, 52, 122), (112, 31, 128), (52, 16, 92))
"""From no force to saturation, in even steps of brightness (matplotlib's magma): readable without colour vision."""

_ARM_CARD, _STRIP_CARD = (10, 10, 700, 322), (10, 340, 700, 210)
_PULLEY = 44.0  # joint pulley's radius
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
    whole.fill(PAGE)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, whole.get_width() // SIZE[0])
        whole.blit(picture, (column * SIZE[0], row * SIZE[1]))
    return whole


def paint(frame: Frame, history: Sequence[Frame], title: str) -> pygame.Surface:
    """Return a picture of `SIZE`, 32 bit: the arm in `frame`, and curves of `history`, which ends with `frame`."""
    canvas = Canvas(_background().copy())
    x, y, width, height = _ARM_CARD
    canvas.clip((x + 1, y + 1, width - 2, height - 2))
    wearer = frame.wearer
    if wearer is not None:
        paint_arm(canvas, wearer)
    _paint_strings(canvas, frame)
    _paint_drives(canvas, frame)
    if frame.obstacle_angle is not None:
        _paint_obstacle(canvas, frame, frame.obstacle_angle)
    _paint_setpoint(canvas, frame.setpoint)
    _paint_forearm(canvas, frame)
    if wearer is not None:
        paint_cuffs(canvas, wearer, frame.joint_angle)
    if frame.payload_mass > 0.0:
        _paint_payload(canvas, frame)
    if frame.push_torque != 0.0:
        _paint_push(canvas, frame)
    if wearer is not None:
        paint_readouts(canvas, wearer)
    _paint_tension_scale(canvas, frame)
    _paint_stiffness(canvas, frame)
    canvas.clip(None)
    canvas.text(title, (24, 31), 15, bold=True)
    canvas.text(f"{frame.time:.2f} s", (696, 31), 15, align=1.0, bold=True)
    if frame.agonist is None:
        canvas.text("position-only control", (24, 52), 11, MUTED)
    if frame.failure:
        canvas.text(f"failed: {frame.failure}", (360, 31), 13, EXTERNAL, align=0.5, bold=True)
    paint_curves(canvas, frame, history)
    return canvas.finish()


@lru_cache(maxsize=1)
def _background() -> pygame.Surface:
    """Return the enlarged parts that never change: cards, upper arm, angle scale, colour bar."""
    surface = pygame.Surface((SIZE[0] * OVERSAMPLING, SIZE[1] * OVERSAMPLING), depth=32)
    surface.fill(PAGE)
    canvas = Canvas(surface)
    for card in (_ARM_CARD, _STRIP_CARD):
        canvas.box((card[0] - 1, card[1] - 1, card[2] + 2, card[3] + 2), GRID, 9)
        canvas.box(card, CARD, 8)
    for degrees in range(-20, 121, 10):
        major = degrees % 30 == 0
        angle = math.radians(degrees)
        start, end = polar(SCALE_RADIUS, angle), polar(SCALE_RADIUS + (8 if major else 5), angle)
        canvas.line(start, end, MUTED if major else FAINT, 1.5 if major else 1.0)
    canvas.lines([polar(SCALE_RADIUS, math.radians(degrees)) for degrees in range(-20, 121)], FAINT, 1.0)
    # The upper arm is fixed to the ground, and carries both motors.
    x, y = JOINT
    for k in range(8):
        canvas.line((_BEAM_LEFT, y - 36 + 10 * k), (_BEAM_LEFT - 10, y - 28 + 10 * k), FAINT, 1.5)
    canvas.line((_BEAM_LEFT, y - 40), (_BEAM_LEFT, y + 44), MUTED, 2.0)
    canvas.box((_BEAM_LEFT, y - 11, x - _BEAM_LEFT, 22), MUTED, 3)
    canvas.box((_BEAM_LEFT + 1.5, y - 9.5, x - _BEAM_LEFT, 19), BEAM, 2)
    canvas.box((_DRIVE_X - 26, y - 62, 52, 124), MUTED, 9)
    canvas.box((_DRIVE_X - 24.5, y - 60.5, 49, 121), BEAM, 8)
    left, top, width, height = _BAR
    for column in range(int(width) * OVERSAMPLING):
        share = column / (width * OVERSAMPLING - 1)
        canvas.box((left + column / OVERSAMPLING, top, 1 / OVERSAMPLING, height), _tension_color(share))
    return surface


def _paint_strings(canvas: Canvas, frame: Frame) -> None:
    """Draw both strings: around the drive's pulley, over the spring, around the joint's pulley."""
    scale = _PULLEY / frame.joint_radius
    for side, force, deflection in (
        (_ABOVE, frame.force_biceps, frame.deflection_biceps),
        (_BELOW, frame.force_triceps, frame.deflection_triceps),
    ):
        share = force / frame.max_force
        color = _tension_color(share) if force > 0.0 else FAINT
        thickness = 2.0 + 2.5 * min(share, 1.0)
        y = JOINT[1] + side * _PULLEY
        spring_end = _SPRING_AT[side] + side * _PULLEY * frame.joint_angle
        spring_end = min(max(spring_end, _DRIVE_X + 80.0), JOINT[0] - 18.0)
        spring_start = spring_end - _SPRING_LENGTH - _STRETCH * scale * max(deflection, 0.0)
        spring_start = max(spring_start, _DRIVE_X + 24.0)
        slack = scale * max(-deflection, 0.0)
        leaves_at = -side * max(-side * frame.joint_angle, math.pi / 2)
        leaves = polar(_PULLEY, leaves_at)
        _paint_string(canvas, (_DRIVE_X, y), (spring_start, y), slack, color, thickness)
        _paint_string(canvas, (spring_end, y), leaves, slack, color, thickness)
        _paint_spring(canvas, spring_start, spring_end, y, color)
        steps = 1 + int(abs(leaves_at - frame.joint_angle) / 0.1)
        arc = [leaves_at + (frame.joint_angle - leaves_at) * k / steps for k in range(steps + 1)]
        canvas.lines([polar(_PULLEY, angle) for angle in arc], color, thickness)
        text = f"{force:.1f} N" if force > 0.0 else "slack"
        canvas.text(text, (_DRIVE_X + 34, y - side * 18), 12, INK if force > 0.0 else EXTERNAL)


def _paint_string(canvas: Canvas, start: Point, end: Point, slack: float, color: Color, thickness: float) -> None:
    """Draw a piece of string; a slack one sags by its spare length."""
    length = math.dist(start, end)
    sag = min(math.sqrt(0.375 * length * slack), 14.0)
    pieces = 12 if sag > 0.5 else 1
    points = []
    for k in range(pieces + 1):
        x, y = between(start, end, k / pieces)
        points.append((x, y + 4.0 * sag * (k / pieces) * (1.0 - k / pieces)))
    canvas.lines(points, color, thickness)


def _paint_spring(canvas: Canvas, left: float, right: float, y: float, color: Color) -> None:
    coils, lead, height = 7, 4.0, 8.0
    pitch = (right - left - 2.0 * lead) / (2 * coils)
    heights = [0.0, *(height, -height) * (coils - 1), height, 0.0]
    zigzag = [(left + lead + pitch * k, y + offset) for k, offset in enumerate(heights)]
    canvas.lines([(left, y), *zigzag, (right, y)], color, 2.0)
    for x in (left, right):
        canvas.disc((x, y), 3.0, color)


def _paint_drives(canvas: Canvas, frame: Frame) -> None:
    """Draw both motors with their names and turned pulleys, and mark the agonist."""
    radius = min(max(_PULLEY * frame.drive_radius / frame.joint_radius, 9.0), 20.0)
    for side, name, angle, color in (
        (_ABOVE, "biceps", frame.drive_biceps, BICEPS),
        (_BELOW, "triceps", frame.drive_triceps, TRICEPS),
    ):
        center = (_DRIVE_X, JOINT[1] + side * (_PULLEY - radius))
        canvas.ring(center, radius, color, CARD, 2.5)
        canvas.line(center, polar(radius - 1.0, angle, center), color, 3.0)
        canvas.disc(center, 3.0, color)
        at = (_DRIVE_X - 26, JOINT[1] + side * 75)
        width = canvas.text(name, at, 13, color, bold=True)
        if frame.agonist == -side:
            canvas.box((at[0] + width + 7, at[1] - 8, 58, 17), color, 8)
            canvas.text("agonist", (at[0] + width + 36, at[1]), 11, CARD, align=0.5, bold=True)


def _paint_setpoint(canvas: Canvas, setpoint: float) -> None:
    canvas.dashes(polar(_PULLEY, setpoint), polar(SCALE_RADIUS, setpoint), SETPOINT, 2.0)
    tip = polar(SCALE_RADIUS - 1.0, setpoint)
    sides = [polar(SCALE_RADIUS + 12.0, setpoint + turn) for turn in (-0.035, 0.035)]
    canvas.polygon([tip, *sides], SETPOINT)


def _paint_forearm(canvas: Canvas, frame: Frame) -> None:
    angle, wide, narrow = frame.joint_angle, 0.5 * FOREARM_WIDTH, 0.36 * FOREARM_WIDTH
    length = FOREARM_LENGTH if frame.wearer is None else LINK_LENGTH
    for grow, color in ((0.0, FOREARM), (-2.0, tint(FOREARM, 0.25))):
        ends = ((0.0, wide, 1), (length, narrow, 1), (length, narrow, -1), (0.0, wide, -1))
        canvas.polygon([offset(along, side * (half + grow), angle) for along, half, side in ends], color)
        canvas.disc(polar(length, angle), narrow + grow, color)
    canvas.line(polar(FOREARM_LENGTH + narrow, angle), polar(SCALE_RADIUS, angle), FOREARM, 2.0)
    canvas.ring(JOINT, _PULLEY - 6.0, FOREARM, CARD, 2.0)
    for turn in (0.0, math.pi / 2, math.pi, 3 * math.pi / 2):
        canvas.line(JOINT, polar(_PULLEY - 7.0, angle + turn), FOREARM if turn == 0.0 else FAINT, 3.0)
    canvas.ring(JOINT, 8.0, FOREARM, CARD, 3.0)


def _paint_payload(canvas: Canvas, frame: Frame) -> None:
    """Draw a weight at the end of the forearm, or in the wearer's hand."""
    worn = frame.wearer
    x, y = polar(FOREARM_LENGTH, frame.joint_angle) if worn is None else polar(HAND, worn.elbow_angle)
    canvas.disc((x, y), 17.0, INK)
    canvas.text(f"{frame.payload_mass:.2g}", (x, y - 4), 11, CARD, align=0.5, bold=True)
    canvas.text("kg", (x, y + 7), 9, CARD, align=0.5)


def _paint_obstacle(canvas: Canvas, frame: Frame, angle: float) -> None:
    """Draw a hatched block that the forearm's edge touches at the obstacle's angle."""
    touched = frame.contact_torque != 0.0
    edge, fill = (EXTERNAL, tint(EXTERNAL, 0.75)) if touched else (MUTED, tint(MUTED, 0.8))
    near, far, depth = 0.5 * FOREARM_LENGTH, 0.86 * FOREARM_LENGTH, 30.0

    def corner(along: float, into: float) -> Point:
        return offset(along, frame.obstacle_side * (0.42 * FOREARM_WIDTH + into), angle)

    canvas.polygon([corner(near, 0.0), corner(far, 0.0), corner(far, depth), corner(near, depth)], fill)
    start = near - depth
    while start < far:
        low, high = max(start, near), min(start + depth, far)
        canvas.line(corner(low, low - start), corner(high, high - start), edge, 1.25)
        start += 9.0
    canvas.line(corner(near, 0.0), corner(far, 0.0), edge, 3.0)
    if touched:
        _paint_torque(canvas, "contact", frame.contact_torque, corner(near, 0.0), corner(near, depth + 16.0))


def _paint_push(canvas: Canvas, frame: Frame) -> None:
    """Draw an arrow onto the forearm, or the wearer's hand.

    Its length grows with the torque relative to that of a saturated spring.
    """
    side = math.copysign(1.0, frame.push_torque)
    strength = min(abs(frame.push_torque) / (frame.max_force * frame.joint_radius), 1.0)
    angle, along, begin = frame.joint_angle, 0.8 * FOREARM_LENGTH, 0.5 * FOREARM_WIDTH
    if frame.wearer is not None:
        angle, along, begin = frame.wearer.elbow_angle, HAND, 20.0
    length = 30.0 + 50.0 * strength

    def point(distance: float, shift: float = 0.0) -> Point:
        return offset(along + shift, -side * (begin + distance), angle)

    canvas.line(point(10.0), point(length), EXTERNAL, 5.0)
    canvas.polygon([point(0.0), point(15.0, 9.0), point(15.0, -9.0)], EXTERNAL)
    if frame.wearer is None:
        _paint_torque(canvas, "push", frame.push_torque, point(0.0), point(length + 4.0))
    else:  # beside the arrow, it would cover the scale of the cuffs
        text = _torque_text("push", frame.push_torque)
        canvas.text(text, (694, 176), 12, EXTERNAL, align=1.0, bold=True)


def _paint_torque(canvas: Canvas, name: str, torque: float, tip: Point, tail: Point) -> None:
    """Write a torque next to the tail of its arrow or block, clear of it in every direction."""
    length = math.dist(tip, tail)
    x, y = tail[0] + 66.0 * (tail[0] - tip[0]) / length, tail[1] + 11.0 * (tail[1] - tip[1]) / length
    at = (min(max(x, 80.0), 630.0), min(max(y, 50.0), 320.0))
    canvas.text(_torque_text(name, torque), at, 12, EXTERNAL, align=0.5, bold=True)


def _torque_text(name: str, torque: float) -> str:
    return f"{name} {torque:+.2f} N m".replace("-", "\N{MINUS SIGN}")


def _paint_tension_scale(canvas: Canvas, frame: Frame) -> None:
    """Label the colour bar of the string tensions and the angle scale; mark the present forces."""
    left, top, width, height = _BAR
    canvas.text("string tension [N]", (left + 0.5 * width, top - 19), 11, MUTED, align=0.5)
    for share in (0.0, 0.5, 1.0):
        canvas.text(f"{share * frame.max_force:.0f}", (left + share * width, top + height + 15), 11, MUTED, align=0.5)
    for force, color, y, side in (
        (frame.force_biceps, BICEPS, top - 1, -1),
        (frame.force_triceps, TRICEPS, top + height + 1, 1),
    ):
        x = left + width * min(force / frame.max_force, 1.0)
        canvas.polygon([(x, y), (x - 4.5, y + 7 * side), (x + 4.5, y + 7 * side)], color)
    for degrees in (0, 30, 60, 90, 120):
        angle = math.radians(degrees)
        canvas.text(f"{degrees}°", polar(SCALE_RADIUS + 22, angle), 11, MUTED, align=0.5 - 0.35 * math.cos(angle))


def _paint_stiffness(canvas: Canvas, frame: Frame) -> None:
    """Write the joint stiffness below the joint, over a gauge from 0 to its maximum."""
    left, top, width, height = _GAUGE
    canvas.text("joint stiffness", (left, top - 12), 11, MUTED)
    canvas.text(f"{frame.joint_stiffness:.1f} N m/rad", (left + width, top - 12), 12, FOREARM, align=1.0, bold=True)
    share = min(frame.joint_stiffness / frame.max_stiffness, 1.0)
    for end, color in ((width, GRID), (max(share * width, height), FOREARM)):
        canvas.box((left, top, end, height), color, 0.5 * height)


def _tension_color(share: float) -> Color:
    """Return the colour of a string force, given as a share of the springs' saturation force."""
    at = min(max(share, 0.0), 1.0) * (len(_TENSION_COLORS) - 1)
    k = min(int(at), len(_TENSION_COLORS) - 2)
    return mixed(_TENSION_COLORS[k], _TENSION_COLORS[k + 1], at - k)
