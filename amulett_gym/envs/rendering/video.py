"""Writing of pictures to a file, as an animated image or an encoded video."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError
from amulett_gym.storage.writing import atomic_path, check_writable

_IMAGES = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}
SUFFIXES = (*_IMAGES, ".mp4")
"""Endings of the files that can be written."""

_GIF_FPS = 50  # a GIF counts in units of 10 ms; players slow down one with less than two units between frames


def check_video(path: str | Path) -> None:
    """Raise an AmulettError for a wrong ending, a folder that cannot be written or an encoder that is not installed."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise AmulettError(f"the video '{path}' has to end with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    if suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise AmulettError(
            "writing .mp4 needs imageio-ffmpeg: install it with 'pip install imageio-ffmpeg', "
            f"or let the name end with {', '.join(_IMAGES)}"
        )
    check_writable(path)


def write_video(path: str | Path, pictures: Iterable[Any], rate: int, fps: int) -> tuple[int, float]:
    """Write pictures as a video that keeps real time.

    Parameters
    ----------
    path : str or Path
        Ends with one of `SUFFIXES`.
    pictures : iterable of ndarray of uint8, shape (height, width, 3)
    rate : int
        Pictures per second.
    fps : int
        Maximum of frames per second; if there are more pictures, some are left out.

    Returns
    -------
    frames : int
    seconds : float
        Length of the video [s].

    Raises
    ------
    AmulettError
        If the file cannot be written; no partial file is left.
    """
    path = Path(path)
    kind = path.suffix.lower()
    step = max(-(-rate // (min(fps, _GIF_FPS) if kind == ".gif" else fps)), 1)
    write = _write_mp4 if kind == ".mp4" else _write_images
    with atomic_path(path) as temporary:
        frames = write(temporary, islice(pictures, 0, None, step), rate / step)
    return frames, frames * step / rate


def _write_images(path: Path, pictures: Iterable[Any], rate: float) -> int:
    from PIL import Image

    kind = _IMAGES[path.suffix.lower()]
    images = []
    for picture in pictures:
        image = Image.fromarray(picture)
        if kind == "GIF":  # flat colours: dithering would only add noise
            image = image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        images.append(image)
    images[0].save(path, kind, save_all=True, append_images=images[1:], duration=round(1000 / rate), loop=0)
    return len(images)


def _write_mp4(path: Path, pictures: Iterable[Any], rate: float) -> int:
    import imageio_ffmpeg

    pictures = iter(pictures)
    first = next(pictures)
    count, size = 0, first.shape[1::-1]
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=rate, quality=8, ffmpeg_log_level="error")
    writer.send(None)
    try:
        for picture in chain([first], pictures):
            writer.send(picture)
            count += 1
    except BaseException:
        with suppress(OSError):  # report the first error, not the encoder's reaction to it
            writer.close()
        raise
    writer.close()
    if path.stat().st_size == 0:
        raise AmulettError(f"the encoder wrote nothing to '{path}'; a name that ends with .gif needs no encoder")
    return count
