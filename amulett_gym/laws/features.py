"""What a learned policy sees beside the observation: the same quantities as through a magnifying glass.

An observation spans all that can happen. What decides about the tension happens within a small part of that: a tuned
law distinguishes errors of 2 deg from none (`parametric`): 2 % of the range. And strings go slack within half a
newton of where the force estimation ends. A small network learns such edges slowly, and its weights have to grow large
for them. Features are smooth steps of the width that matters, and a few products that every hand-made law has.

All of it is computed from one observation: nothing is added that the device could not know.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.action import tension_of
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS

FEATURES = (
    # tanh(error / width)
    "error_1.5deg",
    "error_5deg",
    "error_15deg",
    # tanh(velocity / width)
    "velocity_8deg_s",
    "velocity_30deg_s",
    "velocity_100deg_s",
    # how recently the setpoint began to move: exp(-time / width)
    "recent_0.1s",
    "recent_0.4s",
    # whether the drive that pulls is the one that has to: agonist (+1 or -1) times error or velocity
    "agonist_error_1.5deg",
    "agonist_error_5deg",
    "agonist_velocity_30deg_s",
    # whether the arm moves to its setpoint: error times velocity
    "approach_slow",
    "approach_fast",
    # by the force estimates: of the drive that pulls and of the other one, over 20 N
    "agonist_tension",
    "antagonist_tension",
    # tanh: the antagonist's against the force estimation's floor, and against tensions that are in use
    "antagonist_floor",
    "antagonist_7N",
    # how far the antagonist's tension is from its setpoint: tanh(difference / width)
    "tension_error_0.5N",
    "tension_error_2N",
    "tension_error_6N",
    # tanh: the setpoint against the force estimation's floor
    "setpoint_floor",
)
"""Names of the features, in order; all are in [-1, 1]."""

_ERROR, _, _VELOCITY, _TIME, _TENSION, _ = (float(scale) for scale in OBSERVATION_SCALES.values())
_FLOOR = 5.3
"""Just above the least force that is estimated [N]."""


def features(observations: NDArray[np.floating[Any]], tension_range: tuple[float, float]) -> NDArray[np.floating[Any]]:
    """Return the features of a batch of observations.

    Parameters
    ----------
    observations : ndarray, shape (N, 13) or wider
        What follows the entries of `transition.OBSERVATIONS` is not looked at.
    tension_range : (float, float)
        Tension setpoints at action -1 and +1 [N], by which the last of these entries is scaled.

    Returns
    -------
    ndarray, shape (N, len(FEATURES))
        Of the observations' type.
    """
    shown = dict(zip(OBSERVATIONS, observations.T, strict=False))
    error, velocity = math.degrees(_ERROR) * shown["position_error"], math.degrees(_VELOCITY) * shown["joint_velocity"]
    time, agonist = _TIME * np.maximum(shown["time_since_move"], 0.0), shown["agonist"]
    biceps, triceps = _TENSION * shown["estimated_tension_biceps"], _TENSION * shown["estimated_tension_triceps"]
    pulling, other = np.where(agonist > 0.0, biceps, triceps), np.where(agonist > 0.0, triceps, biceps)
    setpoint = tension_of(shown["tension_setpoint"], *tension_range)
    fine, coarse = np.tanh(error / 1.5), np.tanh(error / 5.0)
    slow, fast = np.tanh(velocity / 8.0), np.tanh(velocity / 30.0)
    columns = {
        "error_1.5deg": fine,
        "error_5deg": coarse,
        "error_15deg": np.tanh(error / 15.0),
        "velocity_8deg_s": slow,
        "velocity_30deg_s": fast,
        "velocity_100deg_s": np.tanh(velocity / 100.0),
        "recent_0.1s": np.exp(-time / 0.1),
        "recent_0.4s": np.exp(-time / 0.4),
        "agonist_error_1.5deg": agonist * fine,
        "agonist_error_5deg": agonist * coarse,
        "agonist_velocity_30deg_s": agonist * fast,
        "approach_slow": fine * slow,
        "approach_fast": coarse * fast,
        "agonist_tension": pulling / _TENSION,
        "antagonist_tension": other / _TENSION,
        "antagonist_floor": np.tanh((other - _FLOOR) / 0.5),
        "antagonist_7N": np.tanh((other - 7.0) / 2.0),
        "tension_error_0.5N": np.tanh((other - setpoint) / 0.5),
        "tension_error_2N": np.tanh((other - setpoint) / 2.0),
        "tension_error_6N": np.tanh((other - setpoint) / 6.0),
        "setpoint_floor": np.tanh(setpoint - _FLOOR),
    }
    return np.stack([columns[name] for name in FEATURES], axis=1)


def with_features(observations: NDArray[np.floating[Any]], tension_range: tuple[float, float]) -> NDArray[Any]:
    """Return what a network with features sees, shape (N, 13 + len(FEATURES) + what there is beyond the 13).

    The features follow the observation; privileged entries, if there are any, come last.
    """
    known = len(OBSERVATIONS)
    seen = features(observations, tension_range)
    return np.concatenate([observations[:, :known], seen, observations[:, known:]], axis=1)
