"""Errors that name the key, the value, what is allowed and the nearest valid choice."""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Iterable
from importlib.metadata import version

_LONGEST = 100
"""Characters of a name that are shown, and of one for which the nearest is looked for."""


class AmulettError(ValueError):
    """Wrong input: a configuration, a name, a file or an action that cannot be used."""


def other_version(what: str, found: int, known: int, remedy: str) -> AmulettError:
    """Build the error for a file of another version of its format, for the caller to raise.

    Parameters
    ----------
    what : str
        The file.
    found, known : int
        Its version, and the one that is read here.
    remedy : str
        What to do about an older one; a newer one needs a newer amulett-gym.
    """
    hint = "update amulett-gym" if found > known else remedy
    return AmulettError(f"{what}: 'version' is {str(found)[:20]}; this amulett-gym reads {known}: {hint}")


def install_extra(extra: str) -> str:
    """Return the commands that install an extra of amulett-gym, which is on no package index."""
    wheel = f"amulett_gym-{version('amulett-gym')}-py3-none-any.whl"
    return f"pip install -e '.[{extra}]' in a checkout, or pip install './{wheel}[{extra}]' beside the wheel file"


def nearest(name: str, choices: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the choice nearest to `name`, or an empty string."""
    if len(name) > _LONGEST:
        return ""
    matches = difflib.get_close_matches(name, list(choices), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def unknown(kind: str, name: str, choices: Iterable[str]) -> AmulettError:
    """Build the error for a name that is not among `choices`.

    Parameters
    ----------
    kind : str
        What the name stands for, e.g. ``"suite"``.
    name : str
        The name that was given.
    choices : iterable of str
        The valid names.

    Returns
    -------
    AmulettError
        To be raised by the caller.
    """
    listed = sorted(choices)
    shown = name if len(name) <= _LONGEST else f"{name[:_LONGEST]}..."
    return AmulettError(f"unknown {kind} '{shown}'; choose from {', '.join(listed)}{nearest(name, listed)}")


def warn_deprecated(message: str) -> None:
    """Give a DeprecationWarning where the user wrote what it is about: above our, Gymnasium's and pydantic's frames."""
    level, frame = 1, sys._getframe()
    inner = ("amulett_gym", "amulett_agents", "gymnasium", "pydantic")
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in inner:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, DeprecationWarning, stacklevel=level)
