"""A log cut into pieces that a batch of devices replays, and the readings that the pieces predict.

With logged commands a log is replayed in pieces side by side, each with its own initial state (multiple shooting): at
low preload the joint is hardly damped, so that a wrong state at the log's begin would be remembered for long. The
drives' state is that after a warm-up in which the joint is led along the measured angle; the joint's angle and velocity
at its end are measured, and fitted. A gap begins a new piece.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import LANES
from amulett_gym.tasks.scenario import Payload

Values = NDArray[np.float64]

COMMANDS = ("command_biceps", "command_triceps")
SLIDERS = ("slider_biceps", "slider_triceps")
FORCES = ("force_biceps", "force_triceps")
CHANNELS = ("angle", *SLIDERS, *FORCES)
"""Measured columns that are compared, in the order of `simulation.replay.OUTPUTS`."""

WARM_UP = 1.5
"""Time that is simulated before a piece is compared, so that the drives forget their start [s]: ten lags."""

_GAP = 5.0  # sampling periods without a row begin a new piece
_AROUND = 0.06  # rows by which angle and velocity at a piece's begin are estimated [s]
_SHORTEST = 3.0  # a piece [s], without its warm-up


@dataclass(frozen=True)
class Recording:
    """A log with what its file does not say.

    Attributes
    ----------
    name : str
    columns : mapping of str to ndarray, shape (rows,)
        By the names of a log (`amulett_gym.logs.Log`), SI units and radians; NaN where a cell is missing.
    payload : Payload, optional
        Weight on the arm during the log.
    released : bool
        Whether the arm was displaced at the first row, at rest, and let go then.
    begin, end : float
        Only rows in this time are compared with the simulation [s].
    """

    name: str
    columns: Mapping[str, Values]
    payload: Payload | None = None
    released: bool = False
    begin: float = -math.inf
    end: float = math.inf

    @property
    def open_loop(self) -> bool:
        """Whether it has both drives' commands."""
        return all(name in self.columns for name in COMMANDS)

    @property
    def channels(self) -> tuple[str, ...]:
        """The measured columns that are compared: the angle, and the sliders or else the estimated forces."""
        pair = SLIDERS if any(name in self.columns for name in SLIDERS) else FORCES
        return tuple(name for name in ("angle", *pair) if name in self.columns)


@dataclass(frozen=True)
class Piece:
    """A part of a recording.

    Attributes
    ----------
    recording : Recording
    start, begin, end : float
        It is replayed from `start`, and compared from `begin` to before `end` [s].
    rows : ndarray of int
        In the comparison.
    angle, velocity : float
        Of the joint at `begin` [rad], [rad/s], by the rows about it; in closed loop at `start`, at rest.
    """

    recording: Recording
    start: float
    begin: float
    end: float
    rows: NDArray[np.int64] = field(repr=False)
    angle: float
    velocity: float


def cut(recordings: Sequence[Recording], control_period: float, whole: bool = False) -> list[Piece]:
    """Return the pieces of recordings, about as many as fill a block of devices; if `whole`, cut only at gaps.

    Raises
    ------
    AmulettError
        If a log has no column that is needed, or nothing of it is left after the warm-up.
    """
    spans = [(each, *span) for each in recordings for span in _spans(each)]
    total = sum(end - begin for _, _, begin, end in spans)
    longest = max(total / LANES * (1.0 + 1e-9), _SHORTEST)
    pieces = []
    for recording, start, begin, end in spans:
        several = recording.open_loop and not whole
        count = max(math.ceil((end - begin) / longest), 1) if several else 1
        edges = [begin + _on_grid(edge - begin, control_period) for edge in np.linspace(begin, end, count + 1)[:-1]]
        edges.append(end + control_period)
        time = recording.columns["time"]
        for first, last in pairwise(edges):
            rows = np.flatnonzero((time >= first - 1e-9) & (time < last - 1e-9))
            if rows.size:
                before = first - _on_grid(WARM_UP, control_period) if recording.open_loop else start
                state = _state(recording, start, first)
                pieces.append(Piece(recording, before, first, last, rows, *state))
    for recording in recordings:
        if np.nanmin(recording.columns["angle"]) == np.nanmax(recording.columns["angle"]):
            raise AmulettError(f"{recording.name}: the angle never changes, so there is nothing to fit or predict")
        if not any(piece.recording is recording for piece in pieces):
            raise AmulettError(
                f"{recording.name} has no rows to compare with a simulation: the first {WARM_UP:g} s of each part "
                "without a gap only let the simulated drives forget their start"
            )
    return pieces


def _on_grid(time: float, period: float) -> float:
    """Return the longest whole number of periods that is not more than a time [s]."""
    return math.floor(time / period + 1e-6) * period


def _state(recording: Recording, start: float, begin: float) -> tuple[float, float]:
    """Return angle and velocity of the joint at the begin of a piece of an uninterrupted part."""
    time, angle = recording.columns["time"], recording.columns["angle"]
    known = np.isfinite(angle)
    if not recording.open_loop or (recording.released and start == begin):
        return float(np.interp(begin if recording.open_loop else start, time[known], angle[known])), 0.0
    near = np.argsort(np.abs(time[known] - begin))
    count = max(int((np.abs(time[known] - begin) <= _AROUND).sum()), 5)
    near = near[:count]
    terms = np.polynomial.polynomial.polyfit(time[known][near] - begin, angle[known][near], min(3, near.size - 1))
    return float(terms[0]), float(terms[1]) if terms.size > 1 else 0.0


def _spans(recording: Recording) -> list[tuple[float, float, float]]:
    """Return uninterrupted parts of a recording: their start, and begin and end of the comparison."""
    inputs = COMMANDS if recording.open_loop else ("setpoint", "tension_setpoint")
    missing = [name for name in ("time", "angle", *inputs) if name not in recording.columns]
    if missing:
        raise AmulettError(
            f"{recording.name} has no column {missing[0]}; a fit needs time, angle, and both drives' commands "
            f"({', '.join(COMMANDS)}), or setpoint and tension_setpoint"
        )
    known = np.isfinite(np.stack([recording.columns[name] for name in ("time", *inputs)])).all(axis=0)
    time = recording.columns["time"][known]
    if time.size < 2:
        return []
    breaks = np.flatnonzero(np.diff(time) > _GAP * float(np.median(np.diff(time)))) + 1
    found = []
    for part in np.split(time, breaks):
        start, end = float(part[0]), min(float(part[-1]), recording.end)
        released = recording.released and start == float(time[0])
        begin = max(start + (0.0 if released else WARM_UP), recording.begin)
        if end > begin:
            found.append((start, begin, end))
    return found


@dataclass(frozen=True)
class Inputs:
    """Inputs of a block of pieces at control rate, rows of `LANES` values; lanes left over repeat the last piece."""

    pieces: tuple[Piece, ...]
    first: Values  # shape (ticks, LANES): command of the biceps, or setpoint
    second: Values  # command of the triceps, or tension setpoint
    angle: Values  # shape (warm-up + 1, LANES): of the joint during and at the end of the warm-up [rad]
    velocity: Values  # [rad/s]


def blocks_of(pieces: Sequence[Piece]) -> list[tuple[Piece, ...]]:
    """Return the pieces in blocks: of at most `LANES` in open loop, long ones first, and of one in closed loop."""
    own = sorted((each for each in pieces if each.recording.open_loop), key=lambda each: each.start - each.end)
    found = [tuple(own[k : k + LANES]) for k in range(0, len(own), LANES)]
    return found + [(each,) for each in pieces if not each.recording.open_loop]


def inputs_of(pieces: tuple[Piece, ...], profile: Profile, delay: float = 0.0) -> Inputs:
    """Return the inputs of a block of pieces.

    A row's command acts from its time on, plus `delay` [s]. Between rows commands are interpolated, so that the delay
    may be a fraction of a period; setpoints are held.
    """
    period = profile.loop.control_period
    ticks = max(math.ceil((each.end - each.start) / period - 1e-6) for each in pieces) + 1
    lanes = [*pieces, *[pieces[-1]] * (LANES - len(pieces))]
    first, second = np.empty((ticks, LANES)), np.empty((ticks, LANES))
    for lane, piece in enumerate(lanes):
        columns = piece.recording.columns
        time = columns["time"]
        at = piece.start + period * np.arange(ticks) - (delay if piece.recording.open_loop else 0.0)
        names = COMMANDS if piece.recording.open_loop else ("setpoint", "tension_setpoint")
        for target, name in zip((first, second), names, strict=True):
            known = np.isfinite(columns[name])
            if piece.recording.open_loop:
                target[:, lane] = np.interp(at, time[known], columns[name][known])
            else:
                last = np.searchsorted(time[known], at + 1e-6 * period, side="right") - 1
                target[:, lane] = columns[name][known][np.maximum(last, 0)]
    warm_up = round((pieces[0].begin - pieces[0].start) / period) if pieces[0].recording.open_loop else 0
    joint = np.empty((warm_up + 1, LANES))
    for lane, piece in enumerate(lanes):
        time, measured = piece.recording.columns["time"], piece.recording.columns["angle"]
        known = np.isfinite(measured)
        joint[:, lane] = np.interp(piece.start + period * np.arange(warm_up + 1), time[known], measured[known])
    speed = np.diff(joint, axis=0, append=joint[-1:]) / period
    joint[-1], speed[-1] = np.array([[each.angle, each.velocity] for each in lanes]).T
    return Inputs(pieces, first, second, joint, speed)


def at_rows(piece: Piece, signal: Values, period: float) -> Values:
    """Return a signal of a piece, one value per control tick from its start, at the times of its rows."""
    place = (piece.recording.columns["time"][piece.rows] - piece.start) / period
    tick = np.clip(np.floor(place + 1e-6).astype(np.int64), 0, len(signal) - 2)
    part = np.clip(place - tick, 0.0, 1.0)
    part[part < 1e-6] = 0.0
    return np.asarray(signal[tick] * (1.0 - part) + signal[tick + 1] * part)
