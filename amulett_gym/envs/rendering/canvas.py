"""What pictures are painted with: shapes, text, colours, and places along the arm.

Shapes are drawn at twice the size and scaled down, for smooth edges; text is drawn last, at its final size. Positions
are in pixels of the final picture, y downwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import NDArray

SIZE = (720, 560)
OVERSAMPLING = 2

Point = tuple[float, float]
Color = tuple[int, int, int]

PAGE, CARD, GRID = (241, 244, 248), (255, 255, 255), (228, 232, 238)
FAINT, MUTED, INK = (190, 199, 209), (104, 117, 132), (31, 41, 55)
BEAM, FOREARM = (214, 220, 228), (72, 90, 112)
BICEPS, TRICEPS, SETPOINT, EXTERNAL = (15, 118, 178), (199, 98, 20), (28, 145, 90), (204, 36, 48)

JOINT: Point = (352.0, 236.0)
FOREARM_LENGTH, FOREARM_WIDTH = 172.0, 24.0
SCALE_RADIUS = 190.0


class Canvas:
    """Draws shapes on an enlarged surface, and text on the final one."""

    def __init__(self, surface: pygame.Surface) -> None:
        self._surface = surface
        self._texts: list[tuple[pygame.Surface, Point, float]] = []

    def clip(self, area: tuple[float, float, float, float] | None) -> None:
        """Draw shapes within an area (left, top, width, height) only; None: everywhere."""
        self._surface.set_clip(None if area is None else pygame.Rect([round(OVERSAMPLING * side) for side in area]))

    def line(self, start: Point, end: Point, color: Color, width: float = 1.0) -> None:
        """Draw a line with square ends."""
        # As a polygon: pygame's thick lines are cut off along an axis, and their width depends on the direction.
        length = math.dist(start, end)
        if length > 0.0:
            dx, dy = (end[0] - start[0]) * 0.5 * width / length, (end[1] - start[1]) * 0.5 * width / length
            ends = [(start, -1), (start, 1), (end, 1), (end, -1)]
            self.polygon([(point[0] - side * dy, point[1] + side * dx) for point, side in ends], color)

    def lines(self, points: Sequence[Point], color: Color, width: float = 1.0) -> None:
        """Draw lines from point to point with round ends and joints."""
        for start, end in pairwise(points):
            self.line(start, end, color, width)
        for point in points:
            self.disc(point, 0.5 * width, color)

    def curve(self, points: NDArray[np.float64], color: Color, width: float) -> None:
        """Draw many short lines, points of shape (N, 2)."""
        if len(points) > 1:
            pixels = (points * OVERSAMPLING).tolist()
            pygame.draw.lines(self._surface, color, False, pixels, round(width * OVERSAMPLING))

    def dashes(self, start: Point, end: Point, color: Color, width: float, dash: float = 7.0, gap: float = 5.0) -> None:
        """Draw a dashed line."""
        length, at = math.dist(start, end), 0.0
        while at < length:
            stop = between(start, end, min(at + dash, length) / length)
            self.line(between(start, end, at / length), stop, color, width)
            at += dash + gap

    def polygon(self, points: Sequence[Point], color: Color) -> None:
        """Fill a polygon."""
        pygame.draw.polygon(self._surface, color, [(OVERSAMPLING * x, OVERSAMPLING * y) for x, y in points])

    def disc(self, center: Point, radius: float, color: Color) -> None:
        """Fill a circle."""
        pixels = (OVERSAMPLING * center[0], OVERSAMPLING * center[1])
        pygame.draw.circle(self._surface, color, pixels, OVERSAMPLING * radius)

    def ring(self, center: Point, radius: float, edge: Color, fill: Color, width: float = 1.5) -> None:
        """Fill a circle with an edge of a width, half of it on either side of the radius."""
        self.disc(center, radius + 0.5 * width, edge)
        self.disc(center, radius - 0.5 * width, fill)

    def box(self, area: tuple[float, float, float, float], color: Color, radius: float = 0.0) -> None:
        """Fill a rectangle (left, top, width, height), with rounded corners if there is a radius."""
        rectangle = pygame.Rect([round(OVERSAMPLING * side) for side in area])
        pygame.draw.rect(self._surface, color, rectangle, border_radius=round(OVERSAMPLING * radius))

    @contextmanager
    def translucent(self, share: float) -> Iterator[None]:
        """Blend what is drawn meanwhile with what was there before; 0: nothing of it is seen, 1: all."""
        area = self._surface.get_clip()
        before = self._surface.subsurface(area).copy()
        yield
        before.set_alpha(round(255 * (1.0 - share)))
        self._surface.blit(before, area)

    def text(self, text: str, at: Point, size: int, color: Color = INK, align: float = 0.0, **style: bool) -> float:
        """Write text (`bold`, `upright`), vertically centred on `at`; return its width.

        `align` is 0 if the text begins at `at`, 0.5 if it is centred there, 1 if it ends there.
        """
        label = _label(text, size, color, **style)
        self._texts.append((label, at, align))
        return float(label.get_width())

    def finish(self) -> pygame.Surface:
        """Return the picture, of `SIZE`."""
        picture = pygame.transform.smoothscale(self._surface, SIZE)
        for label, (x, y), align in self._texts:
            picture.blit(label, (round(x - align * label.get_width()), round(y - 0.5 * label.get_height())))
        return picture


def polar(radius: float, angle: float, center: Point = JOINT) -> Point:
    """Return the point at a distance from the centre, in the direction of an angle [rad] of the joint."""
    return center[0] + radius * math.cos(angle), center[1] - radius * math.sin(angle)


def offset(along: float, offset: float, angle: float) -> Point:
    """Return the point `along` the forearm at `angle`, moved by `offset` to its flexion side."""
    x, y = polar(along, angle)
    return x - offset * math.sin(angle), y - offset * math.cos(angle)


def between(start: Point, end: Point, share: float) -> Point:
    """Return the point at a share of the way from `start` to `end`."""
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])


def tint(color: Color, share: float) -> Color:
    """Return a colour mixed with a share of white."""
    return mixed(color, (255, 255, 255), share)


def mixed(first: Color, second: Color, share: float) -> Color:
    """Return a mixture of two colours with a share of the second."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue


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
