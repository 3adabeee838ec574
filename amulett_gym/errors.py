"""Errors of wrong input; they name the key, the value, the allowed ones, the nearest choice."""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Iterable
from importlib.metadata import version

_LONGEST = 100  # characters of a name that are shown, and of one for which the nearest is searched


class AmulettError(ValueError):
    """Wrong input: a configuration, a name, a file or an action that cannot be used."""


class UnexpectedKeyword(AmulettError, TypeError):
    """A keyword that an environment does not take: also a TypeError, by which other programs try what it takes."""


class ToolMissing(AmulettError):
    """A compiler or the simulated microcontroller is not installed; the message says how to install it."""


class OtherLoopWarning(UserWarning):
    """A policy acts in another control loop, or in one with other settings, than that which it was trained for."""


def other_version(what: str, found: int, known: int, remedy: str) -> AmulettError:
    """Return the error for a file (`what`) of a format version other than the `known` one.

    `remedy` says what to do about an older file; a newer one needs a newer amulett-gym.
    """
    hint = "update amulett-gym" if found > known else remedy
    return AmulettError(f"{what}: 'version' is {str(found)[:20]}; this amulett-gym reads {known}: {hint}")


def install_extra(extra: str) -> str:
    """Return the commands that install an extra of amulett-gym, which is on no package index."""
    wheel = f"amulett_gym-{version('amulett-gym')}-py3-none-any.whl"
    return f"pip install -e '.[{extra}]' in a checkout, or pip install './{wheel}[{extra}]' where the wheel file is"


def nearest(name: str, choices: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the choice nearest to `name`, or an empty string."""
    if len(name) > _LONGEST:
        return ""
    choices = list(choices)
    same = [choice for choice in choices if choice.lower() == name.lower()]
    matches = same or difflib.get_close_matches(name, choices, n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def unknown(kind: str, name: str, choices: Iterable[str]) -> AmulettError:
    """Return the error for a name that is not among the valid `choices`; `kind` is e.g. ``"suite"``."""
    listed = sorted(choices)
    return AmulettError(f"unknown {kind} '{shorten(name)}'; choose from {', '.join(listed)}{nearest(name, listed)}")


def refuse_worn(what: str) -> AmulettError:
    """Return the error for what cannot be done in the environment with a wearer."""
    return AmulettError(
        f"{what} cannot be done in Amulett/Worn-v0: its actions, suites and costs are not those of the other "
        "environments, Amulett/Drives-v0, Amulett/Scaling-v0 and Amulett/Tension-v0; choose one of these, or compare "
        "learned policies of worn devices by 'amulett wearer --policy FOLDER'"
    )


def shorten(text: str, most: int = _LONGEST) -> str:
    """Return `text`, cut after `most` characters."""
    return text if len(text) <= most else f"{text[:most]}..."


def warn_deprecated(message: str) -> None:
    """Issue a DeprecationWarning at the user's line: the first frame outside of ours, Gymnasium's and pydantic's."""
    level, frame = 1, sys._getframe()
    inner = ("amulett_gym", "amulett_agents", "gymnasium", "pydantic")
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in inner:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, DeprecationWarning, stacklevel=level)
