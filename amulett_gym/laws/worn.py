"""Baselines of a worn device: from observations of `Amulett/Worn-v0` to co-contraction and assistance.

Each is a frozen group of named parameters; `WornLaw` makes a policy of one. None learns, and each knows only what the
device measures.

``constant`` never changes; its admittance follows the wearer always alike. ``eq6`` is the paper's eq. 6: the
co-contraction falls with the measured position error. ``switched`` moves softly and holds stiffly: what the wearer is
doing is inferred from the present joint rate and cuff torque. ``latched`` does so by what happened before: it locks
where the wearer came to rest, and lets go when the cuff torque changes later on. At the cuff a tool's push and the
begin of a movement look alike; what differs is when they come.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from amulett_gym.envs.action import FEED_FORWARD_RANGE, tension_to_action
from amulett_gym.envs.transition import OBSERVATION_SCALES
from amulett_gym.envs.worn_transition import CUFF_SCALE, OBSERVATIONS
from amulett_gym.settings import Group

Values = NDArray[np.float64]

_ERROR, _RATE = (
    math.degrees(OBSERVATION_SCALES[name]) for name in ("position_error", "joint_velocity")
)  # [deg, deg/s]
_ERROR_AT, _RATE_AT, _CUFF_AT = map(OBSERVATIONS.index, ("position_error", "joint_velocity", "measured_cuff"))
_EXPONENT = 4.0  # of eq. 6
_LOWEST, _HIGHEST = FEED_FORWARD_RANGE


def _tension(default: float, meaning: str) -> Any:
    return Field(default=default, ge=_LOWEST, le=_HIGHEST, description=f"{meaning} [N]")


def _assistance(meaning: str) -> Any:
    return Field(default=1.0, ge=0, le=1, description=f"{meaning} [1]")


class Constant(Group):
    """A constant co-contraction and a constant assistance."""

    name: ClassVar[str] = "constant"
    remembers: ClassVar[int] = 0
    co_contraction: float = _tension(6.0, "tension of both strings")
    assistance: float = _assistance("assistance")

    def choose(self, rows: Values, memory: Values, period: float) -> tuple[ArrayLike, ArrayLike, Values]:
        """Return co-contractions [N], assistances [1] and the next memory.

        Parameters
        ----------
        rows : ndarray, shape (N, 16)
            Observations.
        memory : ndarray, shape (N, remembers)
            What the last call returned; zeros in the first step.
        period : float
            Time between two actions [s].
        """
        return self.co_contraction, self.assistance, memory


class Eq6(Group):
    """Eq. 6 for the co-contraction, by the size of the measured position error, with a constant assistance."""

    name: ClassVar[str] = "eq6"
    remembers: ClassVar[int] = 0
    nominal_tension: float = _tension(10.0, "tension without an error, sigma")
    minimum_tension: float = _tension(4.0, "tension from the offset on, sigma_min")
    error_offset: float = Field(default=30.0, gt=0, le=90, description="error from which it is the minimum [deg]")
    assistance: float = _assistance("assistance")

    def choose(self, rows: Values, memory: Values, period: float) -> tuple[ArrayLike, ArrayLike, Values]:
        """Return co-contractions [N], assistances [1] and the next memory; see `Constant.choose`."""
        error = np.abs(rows[:, _ERROR_AT]) * _ERROR
        share = np.maximum(1.0 - error / self.error_offset, 0.0) ** _EXPONENT
        return self.minimum_tension + (self.nominal_tension - self.minimum_tension) * share, self.assistance, memory


class Switched(Group):
    """Two levels of co-contraction and of assistance: one while moving, one while holding, with a smooth switch.

    The wearer moves where ``abs(rate) / speed + abs(cuff torque) / torque`` is above 1; `width` is the switch's width
    in this number. After a motion the level falls back within `hold` seconds.
    """

    name: ClassVar[str] = "switched"
    remembers: ClassVar[int] = 1
    moving_tension: float = _tension(1.0, "tension while moving")
    holding_tension: float = _tension(10.0, "tension while holding")
    moving_assistance: float = _assistance("assistance while moving")
    holding_assistance: float = Field(default=0.1, ge=0, le=1, description="assistance while holding [1]")
    speed: float = Field(default=10.0, gt=0, description="measured joint rate that counts as moving [deg/s]")
    torque: float = Field(default=0.6, gt=0, description="measured cuff torque that counts as moving [N m]")
    width: float = Field(default=0.1, gt=0, description="width of the switch [1]")
    hold: float = Field(default=0.15, gt=0, description="time after a motion until it counts as over [s]")

    def choose(self, rows: Values, memory: Values, period: float) -> tuple[ArrayLike, ArrayLike, Values]:
        """Return co-contractions [N], assistances [1] and the next memory; see `Constant.choose`."""
        rate, cuff = np.abs(rows[:, _RATE_AT]) * _RATE, np.abs(rows[:, _CUFF_AT]) * CUFF_SCALE
        beyond = (rate / self.speed + cuff / self.torque - 1.0) / self.width
        moving = np.maximum(0.5 * (1.0 + np.tanh(0.5 * beyond)), memory[:, 0] - period / self.hold)
        tension = self.holding_tension + moving * (self.moving_tension - self.holding_tension)
        assistance = self.holding_assistance + moving * (self.moving_assistance - self.holding_assistance)
        return tension, assistance, moving[:, None]


class Latched(Group):
    """Free and soft while the wearer moves, locked and stiff where they came to rest, until the cuff torque changes.

    It locks when the joint has been slower than `speed` for `still` seconds, at the earliest `least_motion` seconds
    after it let go. In the first `settling` seconds it stays locked: a load that comes on is carried. Then it lets go
    when the cuff torque leaves its mean, of the time constant `forgetting`, by more than `torque`.
    """

    name: ClassVar[str] = "latched"
    remembers: ClassVar[int] = 4
    moving_tension: float = _tension(1.0, "tension while free")
    holding_tension: float = _tension(12.0, "tension while locked")
    speed: float = Field(default=6.0, gt=0, description="measured joint rate below which the arm is still [deg/s]")
    still: float = Field(default=0.05, ge=0, description="time for which it has to be still [s]")
    least_motion: float = Field(default=0.4, ge=0, description="least time for which it is free [s]")
    settling: float = Field(default=0.5, ge=0, description="least time for which it is locked [s]")
    torque: float = Field(default=0.25, gt=0, description="change of the measured cuff torque that frees it [N m]")
    forgetting: float = Field(default=0.4, gt=0, description="time constant of the cuff torque's mean [s]")

    def choose(self, rows: Values, memory: Values, period: float) -> tuple[ArrayLike, ArrayLike, Values]:
        """Return co-contractions [N], assistances [1] and the next memory; see `Constant.choose`.

        The memory holds: whether it is free, for how long it has been free or locked [s], for how long the joint has
        been still [s], and the cuff torque's mean [N m].
        """
        rate, cuff = np.abs(rows[:, _RATE_AT]) * _RATE, rows[:, _CUFF_AT] * CUFF_SCALE
        was_free, since, still, mean = memory[:, 0] > 0.0, memory[:, 1] + period, memory[:, 2], memory[:, 3]
        still = np.where(rate < self.speed, still + period, 0.0)
        locks = was_free & (still > 0.0) & (still >= self.still) & (since >= self.least_motion)
        frees = ~was_free & (since >= self.settling) & (np.abs(cuff - mean) > self.torque)
        free = (was_free & ~locks) | frees
        settles = was_free | (since < self.settling)
        mean = np.where(settles, cuff, mean + (cuff - mean) * min(period / self.forgetting, 1.0))
        since = np.where(locks | frees, 0.0, since)
        tension = np.where(free, self.moving_tension, self.holding_tension)
        return tension, np.where(free, 1.0, 0.0), np.stack([free, since, still, mean], axis=1)


Settings = Constant | Eq6 | Switched | Latched

WORN_LAWS: dict[str, type[Constant] | type[Eq6] | type[Switched] | type[Latched]] = {
    law.name: law for law in (Constant, Eq6, Switched, Latched)
}
"""The baselines by name."""


class WornLaw:
    """A baseline as a policy: observations of `Amulett/Worn-v0` -> actions in [-1, 1].

    Parameters
    ----------
    settings : Constant, Eq6, Switched or Latched
    agent_period : float
        Time between two actions [s].
    tension_range : tuple of float
        The environment's, tensions at action -1 and 1 [N]; tensions beyond are clipped.
    """

    def __init__(
        self, settings: Settings, agent_period: float = 0.02, tension_range: tuple[float, float] = FEED_FORWARD_RANGE
    ) -> None:
        self.settings, self.agent_period, self.tension_range = settings, agent_period, tension_range
        self.reset(1)

    def reset(self, devices: int) -> None:
        """Begin an episode with so many devices."""
        self._memory = np.zeros((devices, self.settings.remembers))

    def __call__(self, observations: ArrayLike) -> NDArray[np.float32]:
        """Return the actions of a batch, shape (N, 2), for observations of shape (N, 16)."""
        rows = np.asarray(observations, dtype=np.float64)
        tension, assistance, self._memory = self.settings.choose(rows, self._memory, self.agent_period)
        return as_actions(tension, assistance, len(rows), self.tension_range)


def as_actions(
    tension: ArrayLike, assistance: ArrayLike, devices: int, tension_range: tuple[float, float] = FEED_FORWARD_RANGE
) -> NDArray[np.float32]:
    """Return the actions, shape (N, 2), of co-contractions [N] and assistances [1], scalars or of shape (N,)."""
    actions = np.empty((devices, 2), dtype=np.float32)
    limited = np.clip(np.asarray(tension, dtype=np.float64), *tension_range)
    actions[:, 0] = tension_to_action(limited, tension_range)
    actions[:, 1] = 2.0 * np.clip(np.asarray(assistance, dtype=np.float64), 0.0, 1.0) - 1.0
    return actions
