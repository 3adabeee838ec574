"""Calls to be made by workers, and where the workers are."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar

from amulett_gym.errors import AmulettError, install_extra

T = TypeVar("T")

MOST_LOST = 3
"""Workers in a row that a call may lose without keeping anything; after that it is given up."""


@dataclass(frozen=True)
class Workers:
    """How many calls are made at a time, and where.

    Attributes
    ----------
    number : int, optional
        Most calls at a time. None: one on this machine, or as many as the cluster has processors.
    ray : str, optional
        Address of a Ray cluster: ``auto``, ``HOST:PORT`` or ``ray://HOST:PORT``. None: this machine.
    """

    number: int | None = None
    ray: str | None = None

    @property
    def alone(self) -> bool:
        """Whether calls are made one after the other in this process."""
        return self.ray is None and self.number in (None, 1)

    def words(self) -> str:
        """Return the workers in words, such as ``2 processes``."""
        if self.ray is None:
            return "1 process" if self.alone else f"{self.number} processes"
        return f"Ray cluster {self.ray}" + ("" if self.number is None else f", {self.number} at a time")


ALONE = Workers()
"""Calls are made one after the other in this process."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """A call of a function of a module, with arguments and a result that can be pickled.

    The function may call `report.advance`, and `report.keep` if the call has a folder.

    Attributes
    ----------
    work : callable
    arguments : tuple
    folder : Path, optional
        Folder in which the call keeps its parts, so that it continues if it is made again; the first argument of
        `work`. On a cluster that is a copy, whose changes `report.keep` and the end of the call bring back.
    files : tuple of str
        The only files and folders in `folder` that `work` uses. Empty: all, and the folder is locked for the call.
    """

    work: Callable[..., T]
    arguments: tuple[Any, ...] = ()
    folder: Path | None = None
    files: tuple[str, ...] = ()

    def make(self, folder: Path | None = None) -> T:
        """Return the call's result, made in its folder or in a copy of it."""
        place = self.folder if folder is None else folder
        return self.work(*(() if place is None else (place,)), *self.arguments)


def chosen(number: int | None, ray: str | None) -> Workers:
    """Return the workers that the options `--workers` and `--ray` choose.

    Raises
    ------
    AmulettError
        If the number is below 1, Ray is not installed, or the address is none.
    """
    if number is not None and number < 1:
        raise AmulettError(f"--workers is {number}; it has to be at least 1")
    if ray is not None:
        check_ray(ray)
    return Workers(number, ray)


def check_ray(address: str) -> None:
    """Raise an AmulettError if Ray is not installed, or the address is none."""
    if find_spec("ray") is None:
        raise AmulettError(f"--ray needs Ray, which is not installed here: {install_extra('ray')}")
    if address != "auto" and not re.fullmatch(r"(ray://)?[^\s/:]+:\d+", address):
        raise AmulettError(
            f"--ray '{address}' is no address of a cluster; write auto (the one that this machine is part of), "
            "HOST:PORT or ray://HOST:PORT"
        )


def named(error: Exception, where: str) -> Exception:
    """Return an error that names where it occurred: in its message if it is an AmulettError, else in a note."""
    if isinstance(error, AmulettError):
        error.args = (f"{where}: {error}", *error.args[1:])
    else:
        error.add_note(f"amulett: in {where}")
    return error


def lost(name: str, reason: str) -> AmulettError:
    """Return the error for a call that has lost too many workers."""
    return AmulettError(
        f"{name}: its worker was killed {MOST_LOST + 1} times ({reason}), perhaps for lack of memory. What is finished "
        "is kept: run the same command again, with fewer --workers"
    )
