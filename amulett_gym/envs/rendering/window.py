"""The renderer of the environments' render modes."""

from __future__ import annotations

import math
import os
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.rendering.frame import STRIP_SECONDS, Frame
from amulett_gym.errors import AmulettError, unknown

MODES = ("rgb_array", "human")
_MOST_FPS = 60
_DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")


class Renderer:
    """Draws one or more arms into an array or a window, with curves of the last seconds.

    Parameters
    ----------
    mode : {"rgb_array", "human"}
        An array needs no display. A window keeps real time; without a display it is invisible, as that of Gymnasium's
        own environments, so that their checks run anywhere.
    fps : float
        Frames per second of the window.
    titles : str
        One for each arm, written above it.

    Raises
    ------
    AmulettError
        If the mode is unknown, pygame is not installed, or the window cannot be opened.
    """

    def __init__(self, mode: str, fps: float, *titles: str) -> None:
        if mode not in MODES:
            raise unknown("render_mode", mode, MODES)
        self._pygame = _import_pygame()
        # To keep real time, only every `_stride`th frame is drawn where a display cannot show them all.
        self._stride = max(math.ceil(fps / _MOST_FPS), 1)
        self._fps, self._titles = fps, titles or ("AMULETT elbow",)
        self._histories: list[deque[Frame]] = [deque() for _ in self._titles]
        self._in_window = mode == "human"
        self._window: Any = self._open() if self._in_window else None
        self._clock, self._due = self._pygame.time.Clock(), 0

    @property
    def is_open(self) -> bool:
        """Whether there is an open window."""
        return self._window is not None

    def draw(self, *frames: Frame) -> NDArray[np.uint8] | None:
        """Draw a frame of each arm.

        Returns
        -------
        ndarray of uint8, shape (height, width, 3), or None for "human"
            After the user closes the window, the simulation continues and nothing is drawn.
        """
        from amulett_gym.envs.rendering.picture import paint_all

        for history, frame in zip(self._histories, frames, strict=True):
            _remember(history, frame)
        if self._in_window:
            self._handle_events()
            self._due -= 1
            if self._window is not None and self._due <= 0:
                self._due = self._stride
                self._window.blit(paint_all(self._histories, self._titles), (0, 0))
                self._pygame.display.flip()
                self._clock.tick(self._fps / self._stride)
            return None
        surface = paint_all(self._histories, self._titles)
        width, height = surface.get_size()
        pixels = bytearray(self._pygame.image.tobytes(surface, "RGB"))
        return np.frombuffer(pixels, dtype=np.uint8).reshape(height, width, 3)

    def clear(self) -> None:
        """Clear the curves for a new episode."""
        for history in self._histories:
            history.clear()

    def close(self) -> None:
        """Close the window, if there is one; may be called again."""
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    def _open(self) -> Any:
        from amulett_gym.envs.rendering.picture import size_of

        display = self._pygame.display
        try:
            with nullcontext() if has_display() else _invisible():
                display.init()
            window = display.set_mode(size_of(len(self._titles)))
        except self._pygame.error as error:
            raise AmulettError(
                f"cannot open a window: {error}; "
                "render_mode='rgb_array' needs none, nor does 'amulett play' with '--video FILE'"
            ) from error
        display.set_caption(" | ".join(self._titles))
        return window

    def _handle_events(self) -> None:
        pygame = self._pygame
        if not pygame.display.get_init():  # another environment's close() quit the display
            self._window = None
        for event in pygame.event.get() if self._window is not None else ():
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                self.close()
                return


def _remember(history: deque[Frame], frame: Frame) -> None:
    # After a restart or a return to a snapshot, frames of the abandoned future are dropped.
    while history and history[-1].time >= frame.time:
        history.pop()
    history.append(frame)
    # One frame before the left edge is kept, so that the curves reach it.
    while len(history) > 2 and history[1].time < frame.time - STRIP_SECONDS:
        history.popleft()


def has_display() -> bool:
    """Return whether a window would be visible, or a driver for an invisible one was chosen."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in _DISPLAY_VARIABLES)


def display_answers() -> bool:
    """Return whether a visible window can be opened: the display that the environment variables name may not exist."""
    if not has_display():
        return False
    pygame = _import_pygame()
    was_open = pygame.display.get_init()
    try:
        pygame.display.init()
        return bool(os.environ.get("SDL_VIDEODRIVER")) or pygame.display.get_driver() not in ("offscreen", "dummy")
    except pygame.error:
        return False
    finally:
        if not was_open:
            pygame.display.quit()


@contextmanager
def _invisible() -> Iterator[None]:
    """Choose SDL's driver for invisible windows; SDL's own choice would print errors on stderr first."""
    before = os.environ.get("SDL_VIDEODRIVER")
    os.environ["SDL_VIDEODRIVER"] = "dummy"
    try:
        yield
    finally:
        del os.environ["SDL_VIDEODRIVER"]
        if before is not None:
            os.environ["SDL_VIDEODRIVER"] = before


def _import_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise AmulettError("rendering needs pygame; install it with 'pip install pygame-ce'") from error
    return pygame
