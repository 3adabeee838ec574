"""Features of an observation: the same quantities at the resolution that decides about the tension.

An observation's range covers all that can happen. What decides about the tension is a small part of it: a tuned law
distinguishes errors of 2 deg from none (`parametric`), which is 2 % of the range, and strings go slack within half a
newton of where the force estimation ends. A small network learns such edges slowly, and needs large weights for them.
Features are smooth steps of the relevant width, and some products that hand-tuned laws use.

All of them are computed from one observation: they add nothing that the device could not measure.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.action import TENSION_RANGE, tension_of
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.laws.worn_inputs import cuff_features

Values = NDArray[np.floating[Any]]

_ERROR, _, _VELOCITY, _TIME, _TENSION, _ = (float(scale) for scale in OBSERVATION_SCALES.values())
_FLOOR = 5.3
"""Slightly above the least force that is estimated [N]."""


def _columns(observations: Values, tension_range: tuple[float, float]) -> dict[str, Values]:
    """Return the features by name, each of shape (N,)."""
    shown = dict(zip(OBSERVATIONS, observations.T, strict=False))
    error, velocity = math.degrees(_ERROR) * shown["position_error"], math.degrees(_VELOCITY) * shown["joint_velocity"]
    time, agonist = _TIME * np.maximum(shown["time_since_move"], 0.0), shown["agonist"]
    biceps, triceps = _TENSION * shown["estimated_tension_biceps"], _TENSION * shown["estimated_tension_triceps"]
    flexes = agonist > 0.0
    pulling, other = np.where(flexes, biceps, triceps), np.where(flexes, triceps, biceps)
    setpoint = tension_of(shown["tension_setpoint"], *tension_range)
    excess = other - setpoint
    fine, coarse = np.tanh(error / 1.5), np.tanh(error / 5.0)
    slow, fast = np.tanh(velocity / 8.0), np.tanh(velocity / 30.0)
    return {
        # tanh(error / width), tanh(velocity / width)
        "error_1.5deg": fine,
        "error_5deg": coarse,
        "error_15deg": np.tanh(error / 15.0),
        "velocity_8deg_s": slow,
        "velocity_30deg_s": fast,
        "velocity_100deg_s": np.tanh(velocity / 100.0),
        # how recently the setpoint began to move: exp(-time / width)
        "recent_0.1s": np.exp(time / -0.1),
        "recent_0.4s": np.exp(time / -0.4),
        # whether the agonist is the drive that is needed: agonist (+1 or -1) times error or velocity
        "agonist_error_1.5deg": agonist * fine,
        "agonist_error_5deg": agonist * coarse,
        "agonist_velocity_30deg_s": agonist * fast,
        # whether the arm moves to its setpoint: error times velocity
        "approach_slow": fine * slow,
        "approach_fast": coarse * fast,
        # estimated forces, over 20 N
        "agonist_tension": pulling / _TENSION,
        "antagonist_tension": other / _TENSION,
        # tanh: the antagonist's force relative to the force estimation's floor, and to usual tensions
        "antagonist_floor": np.tanh((other - _FLOOR) / 0.5),
        "antagonist_7N": np.tanh((other - 7.0) / 2.0),
        # tanh(difference of the antagonist's force and its setpoint / width)
        "tension_error_0.5N": np.tanh(excess / 0.5),
        "tension_error_2N": np.tanh(excess / 2.0),
        "tension_error_6N": np.tanh(excess / 6.0),
        # tanh: the setpoint relative to the force estimation's floor
        "setpoint_floor": np.tanh(setpoint - _FLOOR),
    }


FEATURES = tuple(_columns(np.zeros((1, len(OBSERVATIONS))), TENSION_RANGE))
"""Names of the features, in order; all are in [-1, 1]."""

WORN_FEATURES = (*FEATURES, *cuff_features(np.zeros((1, len(WORN_OBSERVATIONS)))))
"""Names of the features in `Amulett/Worn-v0`."""


def features(observations: Values, tension_range: tuple[float, float], worn: bool = False) -> Values:
    """Return the features of a batch of observations, shape (N, len(FEATURES)), of the observations' type.

    Parameters
    ----------
    observations : ndarray, shape (N, 13) or wider
        Entries after those of `transition.OBSERVATIONS` are ignored.
    tension_range : (float, float)
        Tension setpoints at action -1 and +1 [N], by which the last of these entries is scaled.
    worn : bool
        Whether the observations are those of `Amulett/Worn-v0`; the features are then `WORN_FEATURES`.
    """
    found = _found(observations, tension_range, worn)
    return _fill(np.empty((len(observations), len(found)), dtype=observations.dtype), found)


def _found(observations: Values, tension_range: tuple[float, float], worn: bool) -> dict[str, Values]:
    return _columns(observations, tension_range) | (cuff_features(observations) if worn else {})


def _fill(rows: Values, found: dict[str, Values]) -> Values:
    """Write features, which are columns, into an array; return it."""
    for place, column in enumerate(found.values()):
        rows[:, place] = column
    return rows


def with_features(
    observations: Values,
    tension_range: tuple[float, float] | None,
    remembered: Values | None = None,
    worn: bool = False,
) -> NDArray[Any]:
    """Return the inputs of a network, shape (N, 13 + features + means + privileged entries), of the observations' type.

    Parameters
    ----------
    observations : ndarray, shape (N, 13) or wider
    tension_range : (float, float), optional
        As for `features`; None: there are none.
    remembered : ndarray, shape (N, means), optional
        What the policy remembers (`laws.memory`), which follows the features; privileged entries come last.
    worn : bool
        Whether the observations are those of `Amulett/Worn-v0`: 16 entries instead of 13.
    """
    if tension_range is None and remembered is None:
        return observations
    known = len(WORN_OBSERVATIONS if worn else OBSERVATIONS)
    found = {} if tension_range is None else _found(observations, tension_range, worn)
    means = known + len(found)  # where they begin
    privileged = means + (0 if remembered is None else remembered.shape[1])
    # Each part is written to its place at once: with thousands of devices, copies take as long as the features
    inputs = np.empty((len(observations), privileged + observations.shape[1] - known), dtype=observations.dtype)
    inputs[:, :known], inputs[:, privileged:] = observations[:, :known], observations[:, known:]
    _fill(inputs[:, known:means], found)
    if remembered is not None:
        inputs[:, means:privileged] = remembered
    return inputs
