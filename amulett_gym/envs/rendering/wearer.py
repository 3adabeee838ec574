"""Painting of the arm that wears the device: the forearm behind the link, two cuffs, the intention as a ghost."""

from __future__ import annotations

from amulett_gym.envs.rendering.canvas import (
    BICEPS,
    CARD,
    FAINT,
    FOREARM_LENGTH,
    GRID,
    INK,
    JOINT,
    MUTED,
    TRICEPS,
    Canvas,
    Color,
    Point,
    mixed,
    offset,
    polar,
    tint,
)
from amulett_gym.envs.rendering.frame import WearerFrame

ELBOW, INTENTION = (146, 98, 68), (124, 77, 189)
"""Colours of the wearer's arm and of what the wearer intends."""

HAND = 162.0
"""From the elbow to the grip, where pushes act and payloads are held."""

LINK_LENGTH = 128.0
"""Of the device's link: it ends behind the second cuff, so that the hand is seen."""

CUFF_RANGE = 1.0
"""Cuff torque with the darkest colour [N m]."""

_SKIN = (240, 218, 200)
_ELBOW_HALF, _WRIST, _WRIST_HALF, _PALM_HALF = 23.0, 136.0, 13.0, 16.5
_CUFFS, _CUFF_HALF = (66.0, 108.0), 8.0  # places along the forearm; half of a cuff's width
_NEUTRAL = (247, 247, 247)
_FLEXING, _EXTENDING = mixed(BICEPS, INK, 0.25), mixed(TRICEPS, INK, 0.1)
"""Ends of the cuffs' colours: blue and orange differ for all kinds of colour vision, and darken with the torque."""
_BAR = (580.0, 131.0, 114.0, 9.0)  # colour bar of the cuff torque: left, top, width, height
_BARS = (82.0, 64.0)  # of the activations: left, width


def paint_arm(canvas: Canvas, wearer: WearerFrame) -> None:
    """Draw the wearer's forearm with hand, and before it the intended one as a translucent ghost."""
    if wearer.intention is not None:
        with canvas.translucent(0.45):
            _paint_forearm(canvas, wearer.intention, INTENTION, tint(INTENTION, 0.6))
    _paint_forearm(canvas, wearer.elbow_angle, ELBOW, _SKIN)


def _paint_forearm(canvas: Canvas, angle: float, edge: Color, fill: Color) -> None:
    corners = ((0.0, _ELBOW_HALF), (70.0, 22.0), (_WRIST, _WRIST_HALF), (HAND - 12.0, _PALM_HALF), (HAND + 8.0, 14.0))
    outline = [(along, half, 1.0) for along, half in corners] + [(along, half, -1.0) for along, half in corners[::-1]]
    for grow, color in ((0.0, edge), (-1.75, fill)):
        canvas.polygon([offset(along, side * (half + grow), angle) for along, half, side in outline], color)
        canvas.disc(JOINT, _ELBOW_HALF + grow, color)
        canvas.disc(polar(HAND + 8.0, angle), 14.0 + grow, color)
        thumb = offset(HAND - 14.0, 13.0, angle), offset(HAND + 6.0, 18.0, angle)
        canvas.lines(thumb, color, 9.0 + 2.0 * grow)


def paint_cuffs(canvas: Canvas, wearer: WearerFrame, joint_angle: float) -> None:
    """Draw the bands from the forearm's edges to the device's link, coloured by their torque."""
    if wearer.cuff_torque is None:
        return
    for at in _CUFFS:
        for grow, color in ((0.0, INK), (-1.25, cuff_color(wearer.cuff_torque))):
            reach, half = 26.0 - 6.0 * at / FOREARM_LENGTH + grow, _CUFF_HALF + grow
            across = ((reach, wearer.elbow_angle), (0.0, joint_angle), (-reach, wearer.elbow_angle))
            near, far = ([offset(at + end, side, angle) for side, angle in across] for end in (-half, half))
            canvas.polygon([*near, *far[::-1]], color)


def cuff_color(torque: float) -> Color:
    """Return the colour of a torque [N m] on the elbow: blue flexes, orange extends, almost white is none."""
    share = min(abs(torque) / CUFF_RANGE, 1.0)
    return mixed(_NEUTRAL, _FLEXING if torque > 0.0 else _EXTENDING, share)


def paint_readouts(canvas: Canvas, wearer: WearerFrame) -> None:
    """Write the activations as bars, and the scale of the cuffs' colours with the present torque."""
    width = canvas.text("wearer", (24, 72), 12, ELBOW, bold=True)
    state = "outside the device" if wearer.cuff_torque is None else "relaxed" if wearer.intention is None else ""
    if state:
        long = 12.0 + 6.2 * len(state)
        canvas.box((24 + width + 8, 64, long, 17), ELBOW, 8)
        canvas.text(state, (24 + width + 8 + 0.5 * long, 72), 11, CARD, align=0.5, bold=True)
    left, long = _BARS
    for y, name, activation in ((91.0, "flexor", wearer.flexor), (108.0, "extensor", wearer.extensor)):
        canvas.text(name, (24, y), 11, MUTED)
        for end, color in ((long, GRID), (long * min(activation, 1.0), ELBOW)):
            canvas.box((left, y - 3.0, end, 6.0), color)
        canvas.text(f"{100.0 * activation:.0f} %", (left + long + 36, y), 11, INK, align=1.0)
    if wearer.cuff_torque is not None:
        _paint_cuff_scale(canvas, wearer.cuff_torque)


def _paint_cuff_scale(canvas: Canvas, torque: float) -> None:
    left, top, width, height = _BAR
    canvas.text("cuff torque [N m]", (left + 0.5 * width, top - 11), 11, MUTED, align=0.5)
    canvas.box((left - 1, top - 1, width + 2, height + 2), FAINT)
    columns = 57
    for column in range(columns):
        share = 2.0 * column / (columns - 1) - 1.0
        canvas.box((left + column * width / columns, top, width / columns, height), cuff_color(share * CUFF_RANGE))
    for share, label in ((-1.0, f"\N{MINUS SIGN}{CUFF_RANGE:g}"), (0.0, "0"), (1.0, f"{CUFF_RANGE:g}")):
        canvas.text(label, (left + 0.5 * (1.0 + share) * width, top + height + 15), 11, MUTED, align=0.5)
    x = left + 0.5 * (1.0 + min(max(torque / CUFF_RANGE, -1.0), 1.0)) * width
    y = top + height + 1
    canvas.polygon([(x, y), (x - 4.5, y + 7), (x + 4.5, y + 7)], INK)


def paint_assistance(canvas: Canvas, at: Point, right: float, assistance: float) -> None:
    """Write the assistance behind a small gauge of it."""
    x, y = at
    for end, color in ((14.0, GRID), (14.0 * assistance, INK)):
        canvas.box((x, y - 4.0, end, 8.0), color)
    canvas.text("assistance", (x + 20, y), 11, MUTED)
    canvas.text(f"{100.0 * assistance:.0f} %", (right, y), 12, INK, align=1.0, bold=True)
