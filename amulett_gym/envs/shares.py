"""Shares of the devices' blocks in an agent step, which threads take one after the other, without the GIL.

One thread offers a step: it writes down where the step's arrays are, and counts from the first share again. All threads
that look out for shares take them; the step is done when all shares are. So a thread that comes late finds none left,
and nobody waits for it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray
from numpy.typing import NDArray

from amulett_gym.envs.action import ALL_NUMBERS, first_nan
from amulett_gym.jit.atomic import add, pointer, read, write
from amulett_gym.jit.compiled import compiled

NEXT, DONE, AWAKE, GIVEN, BEGINS = range(5)
"""Rows of the threads' turns.

The next share; the number of shares done; the number of threads that look out for shares; what a step is given; where
shares begin, and where the last one ends. They are at least a line of the processor's cache apart.
"""

SHARES, DEVICES, ENTRIES, REPORTED, ACTIONS, OBSERVATIONS, REPORT, MEANS = range(8)
"""What a step is given: numbers of shares, of devices, and of columns of its two tables; addresses of its arrays."""

_LINE = 8
"""Numbers in a line of the processor's cache."""

Turns = NDArray[np.int64]


def turns_of(blocks: int, threads: int) -> Turns:
    """Return turns of which all are taken, with the shares for threads that step so many blocks.

    Shares become smaller, so that threads end nearly together, though one starts late or its core is busy.
    """
    least, begins = math.ceil(blocks / (32 * threads)), [0]
    while begins[-1] < blocks:
        left = blocks - begins[-1]
        begins.append(begins[-1] + min(max(round(left / (1.5 * threads)), least), left))
    turns = np.zeros((BEGINS + 1, max(len(begins), _LINE)), dtype=np.int64)
    turns[BEGINS, : len(begins)] = begins
    turns[GIVEN, SHARES] = turns[NEXT, 0] = turns[DONE, 0] = len(begins) - 1
    return turns


@compiled
def offer(turns, means, actions, observations, report):
    """Offer the shares of one agent step, unless an action is NaN; return the first such device, or `ALL_NUMBERS`.

    All shares of the step before have to be done. `means` are None, those of the mean drive angle, or those of a worn
    device's assistance.
    """
    wrong = first_nan(means, actions)
    if wrong >= 0:
        return wrong
    given = turns[GIVEN]
    given[DEVICES], given[ENTRIES], given[REPORTED] = actions.size, observations.shape[1], report.shape[1]
    given[ACTIONS], given[OBSERVATIONS] = actions.ctypes.data, observations.ctypes.data
    given[REPORT] = report.ctypes.data
    if means is not None:
        given[MEANS] = means.ctypes.data
    write(turns[DONE], 0)
    write(turns[NEXT], 0)
    return ALL_NUMBERS


@compiled
def first_share(turns, looks):
    """Look out for shares and take one; return its first block and the one after its last.

    They are equal if none comes in so many looks: then the thread no longer looks out.
    """
    add(turns[AWAKE], 1)
    return _take_share(turns, looks)


@compiled
def next_share(turns, looks):
    """Count the share that the thread had as done, and take another one; return what :func:`first_share` does."""
    add(turns[DONE], 1)
    return _take_share(turns, looks)


@compiled
def _take_share(turns, looks):
    shares, begins = turns[GIVEN, SHARES], turns[BEGINS]
    while looks > 0:
        if read(turns[NEXT]) < shares:
            share = add(turns[NEXT], 1)
            if share < shares:
                return begins[share], begins[share + 1]
        looks -= 1
    add(turns[AWAKE], -1)
    return 0, 0


@compiled
def given_to(turns, means):
    """Return what the step is given of which a thread has a share: means, actions, observations, report.

    The means are None if `means` is None; of an array, only the type matters.
    """
    given = turns[GIVEN]
    devices = given[DEVICES]
    actions = carray(pointer(given[ACTIONS]), (devices,), np.float64)
    observations = carray(pointer(given[OBSERVATIONS]), (devices, given[ENTRIES]), np.float32)
    report = carray(pointer(given[REPORT]), (devices, given[REPORTED]), np.float64)
    return _means(given, means), actions, observations, report


@compiled
def _means(given, means):
    if means is None:
        return None
    return carray(pointer(given[MEANS]), (given[DEVICES],), np.float64)


@compiled
def withdraw(turns, looks):
    """Leave no share to others; return whether all that they took are done within so many looks."""
    shares = turns[GIVEN, SHARES]
    while read(turns[NEXT]) < shares:
        if add(turns[NEXT], 1) < shares:
            add(turns[DONE], 1)
    while looks > 0 and read(turns[DONE]) < shares:
        looks -= 1
    return looks > 0
