"""What is known of a device before its log: the distribution of the plausible devices, widened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulett_gym.identification.from_logs.physics import Seen, physics_of
from amulett_gym.profile import Profile

Values = NDArray[np.float64]

WIDER = 1.5
"""Factor of the plausible devices' standard deviations."""


@dataclass(frozen=True)
class Prior:
    """A normal distribution of the search's coordinates (`Seen.place`).

    Attributes
    ----------
    seen : tuple of Seen
    mean, deviation : ndarray, shape (parameters,)
    covariance : ndarray, shape (parameters, parameters)
    """

    seen: tuple[Seen, ...]
    mean: Values
    covariance: Values

    @property
    def deviation(self) -> Values:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def prior_of(seen: tuple[Seen, ...], fleet: Sequence[Profile]) -> Prior:
    """Return the prior by a fleet's devices: their mean, and their covariance times `WIDER` squared plus `Seen.spread`.

    What only some devices have is counted over those. Nuisances have mean 0.
    """
    physics = [each for each in seen if not each.nuisance]
    places = np.full((len(fleet), len(seen)), np.nan)
    for row, profile in enumerate(fleet):
        known = physics_of(profile)
        for column, each in enumerate(physics):
            if each.name in known:
                places[row, column] = each.place(known[each.name])
    mean, covariance = np.zeros(len(seen)), np.zeros((len(seen), len(seen)))
    count = len(physics)
    if fleet:
        mean[:count] = np.nanmean(places[:, :count], axis=0)
        apart = np.nan_to_num(places[:, :count] - mean[:count])
        covariance[:count, :count] = WIDER**2 * apart.T @ apart / len(fleet)
    return Prior(seen, mean, covariance + np.diag([each.spread**2 for each in seen]))


def starts(seen: tuple[Seen, ...], profiles: Sequence[Profile]) -> list[dict[str, float]]:
    """Return the values of devices as starts of the search; nuisances are 0."""
    found = []
    for profile in profiles:
        known = physics_of(profile)
        found.append({each.name: 0.0 if each.nuisance else known[each.name] for each in seen})
    return found
