"""The fit of a device to its recordings: least squares from several starts, and the posterior about the best one.

The posterior is normal in the search's coordinates, with the curvature of the sum of squares at its minimum (Laplace's
approximation). Where residuals are correlated, so many rows count as one (`noise.Whiteness.time`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.noise import Whiteness, rough_noise, whiteness
from amulett_gym.identification.from_logs.physics import Seen
from amulett_gym.identification.from_logs.prior import Prior, prior_of, starts
from amulett_gym.identification.from_logs.recording import CHANNELS, Recording
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import LANES
from amulett_gym.workers.call import ALONE, Call, Workers
from amulett_gym.workers.run import results

Values = NDArray[np.float64]

DETERMINED = 0.5
"""Largest posterior standard deviation, as a part of the prior one, with which a parameter counts as determined."""

LEVEL, QUANTILE = 0.9, 1.6449
"""Of the intervals."""

_STATE = (np.radians(0.5), np.radians(20.0))
"""Standard deviations of a piece's angle and velocity at its begin, as measured [rad], [rad/s]."""

_COARSE, _CELLS = 10.0, 8000
"""Of a start's search: factor of the noise in its first part, where the way to the minimum is smoother, and cells."""

_DRAWS = 8
"""Blocks of draws of the noise, by which the intervals in closed loop are found."""

_SIGNS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
_CLEAR = 1.1  # rms of residuals over the noise of the readings, below which a start has found the device
_STEP, _STEP_CLOSED = 1e-5, 0.02  # of a finite difference, in standard deviations of the prior; noise switches agonists
_FAR = 6.0  # bound of the search, in those


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter with its 90 % interval, and whether the logs determine it or the prior does."""

    seen: Seen
    value: float
    low: float
    high: float
    prior_low: float
    prior_high: float
    determined: bool


@dataclass(frozen=True)
class Fit:
    """The outcome.

    Attributes
    ----------
    model : Model
    prior : Prior
    place, covariance : ndarray
        Mean and covariance of the posterior, in the search's coordinates.
    noise : mapping of str to float
        Root mean square of the residuals by channel [rad], [m], [N].
    whiteness : mapping of str to Whiteness
    information : ndarray, shape (parameters, parameters)
        Inverse covariance by the logs alone, without the prior.
    predicted : ndarray, shape (cells,)
        Readings without noise, beside `model.measured`.
    starts : tuple of float
        Half the sum of weighted squares that each start reached, best first.
    """

    model: Model
    prior: Prior
    place: Values
    covariance: Values
    information: Values
    predicted: Values
    noise: Mapping[str, float]
    whiteness: Mapping[str, Whiteness]
    starts: tuple[float, ...]

    @property
    def values(self) -> dict[str, float]:
        """The most probable values."""
        return values_at(self.prior.seen, self.place)

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Each parameter with its interval."""
        deviation, before = np.sqrt(np.diag(self.covariance)), self.prior.deviation
        return tuple(
            Estimate(
                each,
                each.value(self.place[k]),
                each.value(self.place[k] - QUANTILE * deviation[k]),
                each.value(self.place[k] + QUANTILE * deviation[k]),
                each.value(self.prior.mean[k] - QUANTILE * before[k]),
                each.value(self.prior.mean[k] + QUANTILE * before[k]),
                bool(deviation[k] <= DETERMINED * before[k]),
            )
            for k, each in enumerate(self.prior.seen)
        )


def values_at(seen: tuple[Seen, ...], place: Values) -> dict[str, float]:
    """Return the named values at a place of the search."""
    return {each.name: each.value(x) for each, x in zip(seen, place.tolist(), strict=True)}


def fit(
    base: Profile,
    recordings: Sequence[Recording],
    fleet: Sequence[Profile],
    tried: int = 6,
    report: Callable[[str], object] = lambda text: None,
    workers: Workers = ALONE,
) -> Fit:
    """Return the device that explains recordings best, with the plausible devices as prior.

    Parameters
    ----------
    base : Profile
        Loop, sensors and damping of the device; what ends its springs and whether drives stall are the fleet's.
    recordings : sequence of Recording
    fleet : sequence of Profile
        Plausible devices; the search starts from those of them that explain the recordings best.
    tried : int
        Most starts; there are no more when the residuals of one are hardly larger than the readings' noise.
    report : callable
        Called with a sentence after each stage.
    workers : Workers
        They search from plausible devices, whether or not these starts are needed then; they change no result.

    Raises
    ------
    AmulettError
        If a recording cannot be used.
    """
    kinds: dict[object, list[Profile]] = {}
    for profile in fleet or (base,):
        kinds.setdefault(_kind(profile), []).append(profile)
    found = []
    for members in kinds.values():
        model = Model(_like(base, members[0]), recordings)
        found += [(score, model, start) for score, start in _screen(model, members)]
    found.sort(key=lambda each: each[0])
    report(f"{len(found)} plausible devices compared with the logs")
    begins = {number: found[number // 2 % len(found)] for number in range(0, tried, 2)}
    calls = {}
    for number, (_, model, start) in begins.items():
        members = kinds[_kind(model.template)]
        calls[f"start {number + 1}"] = Call(_search_from, (model.template, recordings, members, start))
    searched, ended = results(calls, workers), dict[str, tuple[Values, float]]()
    best: tuple[float, _Search, Values] | None = None
    reached = []
    for number in range(tried):
        if best is not None and number % 2:  # from the best so far, with other drives: their limits make other minima
            _, search, vector = best
            vector, cost = search.run(search.with_other_drives(vector, number // 2))
        else:
            _, model, start = begins[number]
            search = _searches(model, kinds[_kind(model.template)], start)[1]
            name = f"start {number + 1}"
            while name not in ended:
                ended.update([next(searched)])
            vector, cost = ended[name]
        reached.append(cost)
        left = max(value / search.noise[name] for name, value in search.residual_noise(vector).items())
        report(f"start {number + 1} of at most {tried}: residuals of {left:.3g} times the noise")
        if best is None or cost < best[0]:
            best = cost, search, vector
        if left < _CLEAR:
            break
    searched.close()  # ends starts that are not needed
    assert best is not None
    _, search, vector = best
    model = search.model
    for _ in range(2):
        search = _Search(model, search.prior, search.weighing_noise(vector))
        vector, _ = search.run(vector)
    report("refined with all rows")
    return search.result(vector, tuple(sorted(reached)))


def information_of(model: Model, fit: Fit) -> Values:
    """Return the information of other recordings about a fitted device, with the noise of the fit."""
    search = _Search(model, fit.prior, fit.noise)
    return search.information(search.vector(fit.values), {name: test.time for name, test in fit.whiteness.items()})


def _kind(profile: Profile) -> object:
    """Return what makes two devices differ in more than numbers."""
    spring, drives = profile.spring, profile.drives
    return (
        spring.beyond,
        spring.stop_stiffness,
        spring.measured_curve is None or str(spring.measured_curve),
        drives.stall_torque is None,
        drives.rate_limit_deg is None,
        drives.lag > 0.0,
    )


def _like(base: Profile, member: Profile) -> Profile:
    """Return the base with springs and drives of the kind of a plausible device, and its own limit of commands."""
    drives = member.drives.model_copy(update={"command_limit_deg": base.drives.command_limit_deg})
    return base.model_copy(update={"spring": member.spring, "drives": drives})


def _first_noise(model: Model) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for part in model.parts:
        if part.cells.stop > part.cells.start:
            found.setdefault(part.channel, []).append(rough_noise(model.measured[part.cells]))
    return {channel: float(np.median(values)) for channel, values in found.items()}


def _noise_at(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Return the noise of the readings by channel, in closed loop with what the sensors' noise makes the joint do."""
    noise, closed = _first_noise(model), ~model.open_cells
    if closed.any():
        draws, channels = model.draws(values, 1), model.channel_of()
        for channel in noise:
            own = closed & (channels == CHANNELS.index(channel))
            noise[channel] = (
                max(noise[channel], float(draws[:, own].std(axis=0).mean())) if own.any() else noise[channel]
            )
    return noise


def _slider_noise(noise: Mapping[str, float]) -> float:
    values = [value for channel, value in noise.items() if channel.startswith("slider")]
    return float(np.mean(values)) if values else 0.0


def _screen(model: Model, members: Sequence[Profile]) -> list[tuple[float, dict[str, float]]]:
    """Return the weighted sum of squares of plausible devices, with their values."""
    noise = _first_noise(model)
    devices = starts(model.seen, members)
    apart = (model.predict(devices, _slider_noise(noise)) - model.measured) / _weights(model, noise)
    return list(zip((apart**2).sum(axis=1).tolist(), devices, strict=True))


def _searches(model: Model, members: Sequence[Profile], start: Mapping[str, float]) -> tuple[_Search, _Search]:
    """Return the coarse and the fine search from a plausible device, with the others of its kind as prior."""
    prior, noise, stride = prior_of(model.seen, members), _noise_at(model, start), -(-model.measured.size // _CELLS)
    coarse = {name: _COARSE * value for name, value in noise.items()}
    return _Search(model, prior, coarse, stride), _Search(model, prior, noise, stride)


def _search_from(
    template: Profile, recordings: Sequence[Recording], members: Sequence[Profile], start: Mapping[str, float]
) -> tuple[Values, float]:
    """Return the vector that the searches from a plausible device find, and half its sum of squares."""
    coarse, fine = _searches(Model(template, recordings), members, start)
    vector, _ = coarse.run(coarse.vector(start), 3e-3, 20)
    return fine.run(vector)


def _weights(model: Model, noise: Mapping[str, float]) -> Values:
    return np.array([noise.get(channel, 1.0) for channel in CHANNELS])[model.channel_of()]


class _Search:
    """Least squares with given noise.

    The vector of the search has the parameters, in standard deviations of the prior from its mean, and then angle and
    velocity at each piece's begin, in `_STATE` from those measured.
    """

    def __init__(self, model: Model, prior: Prior, noise: Mapping[str, float], stride: int = 1) -> None:
        self.model, self.prior, self.noise, self.used = model, prior, noise, slice(None, None, stride)
        self.count = len(prior.seen)
        self.weights = _weights(model, noise)
        deviation = prior.deviation
        self.root = np.linalg.inv(np.linalg.cholesky(prior.covariance / np.outer(deviation, deviation)))
        edges = [(_edge(each, each.low, -np.inf), _edge(each, each.high, np.inf)) for each in prior.seen]
        low, high = (np.array(edges).T - prior.mean) / deviation
        states = np.full(2 * len(model.pieces), _FAR)
        self.low = np.concatenate([np.maximum(low, -_FAR), -states])
        self.high = np.concatenate([np.minimum(high, _FAR), states])

    def vector(self, values: Mapping[str, float]) -> Values:
        """Return the search's vector of named values, with the states as measured."""
        place = np.array([each.place(values[each.name]) for each in self.prior.seen])
        scaled = (place - self.prior.mean) / self.prior.deviation
        return np.concatenate([scaled, np.zeros(2 * len(self.model.pieces))])

    def run(self, vector: Values, tolerance: float = 1e-6, most: int = 40) -> tuple[Values, float]:
        """Return the vector of the least sum of squares from a start, and half that sum.

        It ends when a step lowers the sum by less than its `tolerance`-th part, or after `most` evaluations.
        """
        start = np.clip(vector, self.low + 1e-6, self.high - 1e-6)
        limits = (self.low, self.high)
        found = least_squares(self._residuals, start, self._jacobian, limits, xtol=1e-6, ftol=tolerance, max_nfev=most)
        return found.x, float(found.cost)

    def with_other_drives(self, vector: Values, number: int) -> Values:
        """Return a vector with one of the drives' limits a standard deviation from its prior mean, the other at it."""
        signs = dict(zip(("stall_torque", "rate_limit"), _SIGNS[number % len(_SIGNS)], strict=True))
        moved = vector.copy()
        for k, each in enumerate(self.prior.seen):
            moved[k] = signs.get(each.name, vector[k])
        return moved

    def place(self, vector: Values) -> Values:
        """Return the parameters' coordinates (`Seen.place`)."""
        return np.asarray(self.prior.mean + self.prior.deviation * vector[: self.count])

    def _predict(self, vectors: Values, noise: bool = True) -> Values:
        devices = [values_at(self.prior.seen, self.place(each)) for each in vectors]
        states = vectors[:, self.count :].reshape(len(vectors), -1, 2) * _STATE
        return self.model.predict(devices, _slider_noise(self.noise), states, noise)

    def _residuals(self, vector: Values) -> Values:
        data = ((self._predict(vector[None])[0] - self.model.measured) / self.weights)[self.used]
        return np.concatenate([data, self.root @ vector[: self.count], vector[self.count :]])

    def _jacobian(self, vector: Values) -> Values:
        slopes = self._slopes(vector)[self.used]
        states = len(vector) - self.count
        before = np.zeros((len(vector), len(vector)))
        before[: self.count, : self.count] = self.root
        before[self.count :, self.count :] = np.eye(states)
        return np.concatenate([slopes, before])

    def _slopes(self, vector: Values, noise: bool = True) -> Values:
        """Return the derivatives of the weighted residuals; a piece's state moves its own cells alone."""
        size = _STEP if self.model.open_cells.all() or not noise else _STEP_CLOSED
        step = np.where(vector[: self.count] + size <= self.high[: self.count], size, -size)
        moved = np.zeros((self.count + 3, len(vector)))
        moved[1 : self.count + 1, : self.count] = np.diag(step)
        moved[-2, self.count :: 2] = moved[-1, self.count + 1 :: 2] = _STEP
        found = self._predict(vector + moved, noise)
        apart = (found[1:] - found[0]) / self.weights
        slopes = np.zeros((apart.shape[1], len(vector)))
        slopes[:, : self.count] = (apart[: self.count] / step[:, None]).T
        sizes = np.cumsum([0, *(len(block) for block in self.model.blocks)])
        for part in self.model.parts:
            column = self.count + 2 * int(sizes[part.block] + part.lane)
            slopes[part.cells, column : column + 2] = apart[-2:, part.cells].T / _STEP
        return slopes

    def residual_noise(self, vector: Values) -> dict[str, float]:
        """Return the root mean square of the residuals of each channel."""
        apart = self._predict(vector[None])[0] - self.model.measured
        channels = self.model.channel_of()
        return {CHANNELS[k]: max(float(np.sqrt(np.mean(apart[channels == k] ** 2))), 1e-9) for k in np.unique(channels)}

    def weighing_noise(self, vector: Values) -> dict[str, float]:
        """Return `residual_noise`, in closed loop raised for correlated rows."""
        noise = self.residual_noise(vector)
        if self.model.open_cells.all():
            return noise
        tests = self._whiteness(self._predict(vector[None])[0])
        return {channel: value * np.sqrt(tests[channel].time) for channel, value in noise.items()}

    def _whiteness(self, predicted: Values) -> dict[str, Whiteness]:
        apart, parts = predicted - self.model.measured, self.model.parts
        return {name: whiteness([apart[part.cells] for part in parts if part.channel == name]) for name in self.noise}

    def covariance_by_draws(self, vector: Values) -> Values:
        """Return the covariance of the parameters with the spread of the scores over draws of the noise in closed loop.

        It is that of the estimator, to first order: what other draws and other devices of the prior would have given.
        The derivatives are those without noise: those of a few draws have noise, which would pass for information.
        """
        slopes, states = self._slopes(vector, False), np.eye(len(vector) - self.count)
        prior = np.zeros((len(vector), len(vector)))
        prior[: self.count, : self.count] = self.root.T @ self.root
        prior[self.count :, self.count :] = states
        draws = self.model.draws(values_at(self.prior.seen, self.place(vector)), _DRAWS) / self.weights
        scores = (draws - draws.mean(axis=0)) @ slopes
        spread = (1.0 + 1.0 / LANES) * scores.T @ scores / (len(draws) - 1)
        open_loop = slopes[self.model.open_cells]
        inverse = np.linalg.inv(slopes.T @ slopes + prior)
        whole = inverse @ (spread + open_loop.T @ open_loop + prior) @ inverse
        scale = np.diag(self.prior.deviation)
        return np.asarray(scale @ whole[: self.count, : self.count] @ scale)

    def information(self, vector: Values, times: Mapping[str, float]) -> Values:
        """Return the inverse covariance of the parameters by the logs, whatever the states are.

        `times` are rows that count as one, by channel.
        """
        rows = np.array([times.get(name, 1.0) for name in CHANNELS])[self.model.channel_of()]
        slopes = self._slopes(vector) / np.sqrt(rows)[:, None]
        whole = slopes.T @ slopes
        cross, states = whole[: self.count, self.count :], whole[self.count :, self.count :]
        inner = whole[: self.count, : self.count] - cross @ np.linalg.solve(states + np.eye(len(states)), cross.T)
        scale = np.diag(1.0 / self.prior.deviation)
        return np.asarray(scale @ inner @ scale)

    def result(self, vector: Values, reached: tuple[float, ...]) -> Fit:
        """Return the fit at the vector of the minimum."""
        predicted = self._predict(vector[None])[0]
        tests, before = self._whiteness(predicted), np.linalg.inv(self.prior.covariance)
        if self.model.open_cells.all():
            information = self.information(vector, {name: test.time for name, test in tests.items()})
            covariance = np.linalg.inv(information + before)
        else:
            covariance = self.covariance_by_draws(vector)
            information = np.linalg.inv(covariance) - before
        place, noise = self.place(vector), self.residual_noise(vector)
        return Fit(self.model, self.prior, place, covariance, information, predicted, noise, tests, reached)


def _edge(seen: Seen, bound: float, none: float) -> float:
    if (seen.logarithmic and bound <= 0.0) or not np.isfinite(bound):
        return none
    return seen.place(bound)
