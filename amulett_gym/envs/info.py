"""``info``, what `reset` and `step` return beside the observation.

It is flat, with the same keys and types in every step of an environment: each value is a finite float, but for two
numbers that stand for names, `failure` and `device`, which are ints. The vector environments have the same keys with
arrays, and as Gymnasium's, for each key a mask, ``"_" + key``, of the devices that it tells something of.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.episodes import Episodes, Report
from amulett_gym.envs.transition import FIRST_TERM
from amulett_gym.simulation.layout import LANES

_BY_STIFFNESS = "stiffness_setpoint"


def info_of(episodes: Episodes, values: list[float], device: int = 0) -> dict[str, Any]:
    """Return the info of a single device.

    Parameters
    ----------
    episodes : Episodes
    values : list of float
        The device's report without the reward.
    device : int
    """
    info: dict[str, Any] = episodes.entries.copy()  # faster than a dict that grows
    info.update(zip(episodes.entries, values))  # noqa: B905, being strict takes time
    info["failure"] = int(info["failure"])
    if not episodes.by_stiffness:
        del info[_BY_STIFFNESS]
    if episodes.names is not None:
        info["device"] = int(episodes.simulation.which[device // LANES])
    return info


def infos_of(episodes: Episodes, report: Report, devices: NDArray[np.int64] | None = None) -> dict[str, Any]:
    """Return the info of several devices, with the masks.

    Parameters
    ----------
    episodes : Episodes
    report : ndarray, shape (len(devices), report_size)
    devices : ndarray of int, optional
        Those of the report; None: all.
    """
    info: dict[str, Any] = dict(zip(episodes.entries, report.T[FIRST_TERM:], strict=True))
    info["failure"] = info["failure"].astype(np.int64)
    if not episodes.by_stiffness:
        del info[_BY_STIFFNESS]
    if episodes.names is not None:
        info["device"] = episodes.kinds_of(devices)
    return masked(info, np.ones(len(report), dtype=bool))


def final_of(info: dict[str, Any], observations: NDArray[np.float32], devices: NDArray[np.int64]) -> dict[str, Any]:
    """Return what the info of a step has of the episodes that ended in it, in Gymnasium's mode SAME_STEP.

    Parameters
    ----------
    info : dict
        That of `devices` before their next episodes began, as of `infos_of`.
    observations : ndarray of float32, shape (N, observation_size)
        The observations with it.
    devices : ndarray of int
        Those whose episode ended, at least one.
    """
    final = np.full(len(observations), None, dtype=object)
    for device in devices:
        final[device] = observations[device].copy()
    found = of_some(info, devices, len(observations))
    return masked({"final_obs": final, "final_info": found}, found["_failure"])


def of_some(info: dict[str, Any], devices: NDArray[np.int64], count: int) -> dict[str, Any]:
    """Return the info of all of `count` devices that has that of some of them, and 0 for the others."""
    found = {}
    for key, values in info.items():
        if not key.startswith("_"):
            found[key] = np.zeros(count, dtype=values.dtype)
            found[key][devices] = values
    mask = np.zeros(count, dtype=bool)
    mask[devices] = True
    return masked(found, mask)


def masked(info: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Return an info with the mask of each entry; all of them are the same array."""
    return info | dict.fromkeys(_masks_of(tuple(info)), mask)


@cache  # there are few different ones, and an info is made in each step
def _masks_of(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of entries' masks."""
    return tuple(f"_{key}" for key in keys)
