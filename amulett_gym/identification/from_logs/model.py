"""What a device with given parameters would have measured in the recordings: readings without noise.

In closed loop the sensors' noise moves the joint: its readings there are the mean over devices with noise of their own,
one in each lane of a block.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from amulett_gym.identification.from_logs.noise import rough_noise
from amulett_gym.identification.from_logs.physics import NUISANCES, PARAMETERS, Seen, device, physics_of
from amulett_gym.identification.from_logs.recording import (
    CHANNELS,
    FORCES,
    SLIDERS,
    Inputs,
    Piece,
    Recording,
    at_rows,
    blocks_of,
    cut,
    inputs_of,
)
from amulett_gym.profile import Profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import LANES, ORIENTATIONS, load_arm
from amulett_gym.simulation.replay import replay_commands, replay_setpoints, start_at_commands, start_in_balance
from amulett_gym.tasks.scenario import empty_rows

Values = NDArray[np.float64]

_KEYS = np.uint64(0x6669742D6C6F6773) + np.arange(LANES, dtype=np.uint64)  # of the noise; no log's seed by chance
_DEVICES = 16  # simulated at once: bounds the memory
_ABOVE_FLOOR = 1.1  # estimated forces below so many floors are not compared: their noise is clipped


@dataclass(frozen=True)
class Part:
    """Cells of one channel of one piece in the stacked data: rows of the log, and where they are."""

    channel: str
    block: int
    lane: int
    cells: slice
    known: NDArray[np.bool_]  # of the piece's rows


class Model:
    """The recordings, cut, and what they measured, beside what devices predict.

    Parameters
    ----------
    template : Profile
        Loop, and what is not fitted.
    recordings : sequence of Recording
    whole : bool
        Whether they are cut only at gaps, as for a prediction.

    Attributes
    ----------
    seen : tuple of Seen
        Parameters that the recordings may depend on.
    pieces : tuple of Piece
        All of them, block by block.
    measured : ndarray, shape (cells,)
        Angles [rad], sliders [m] and forces [N], by piece and channel (`parts`).
    """

    def __init__(self, template: Profile, recordings: Sequence[Recording], whole: bool = False) -> None:
        self.template = _with_noise(template, 0.0, 0.0)
        self.noisy = _noisy(template, recordings)
        self.period = template.loop.control_period
        self.blocks = blocks_of(cut(recordings, self.period, whole))
        self.pieces = tuple(piece for block in self.blocks for piece in block)
        channels = {name for each in recordings for name in each.channels}
        known = physics_of(template)
        open_loop = any(each.open_loop for each in recordings)
        own = {"encoder_bias"} | ({"command_delay", "zero_biceps", "zero_triceps"} if open_loop else set())
        own |= {f"slider_bias_{name.removeprefix('slider_')}" for name in SLIDERS if name in channels}
        self.seen: tuple[Seen, ...] = (
            *(each for each in PARAMETERS if each.name in known),
            *(each for each in NUISANCES if each.name in own),
        )
        self.parts: list[Part] = []
        cells = []
        for block, pieces in enumerate(self.blocks):
            for lane, piece in enumerate(pieces):
                for channel in piece.recording.channels:
                    values = piece.recording.columns[channel][piece.rows]
                    usable = np.isfinite(values)
                    if channel in FORCES:
                        usable &= values > _ABOVE_FLOOR * template.sensors.force_floor
                    first = self.parts[-1].cells.stop if self.parts else 0
                    self.parts.append(Part(channel, block, lane, slice(first, first + int(usable.sum())), usable))
                    cells.append(values[usable])
        self.measured: Values = np.concatenate(cells)

    def channel_of(self) -> NDArray[np.int64]:
        """Return the channel of each cell, an index into `CHANNELS`."""
        found = np.empty(self.measured.size, dtype=np.int64)
        for part in self.parts:
            found[part.cells] = CHANNELS.index(part.channel)
        return found

    def piece_of(self, part: Part) -> Piece:
        """Return the piece that a part belongs to."""
        return self.blocks[part.block][part.lane]

    def profile(self, values: Mapping[str, float]) -> Profile:
        """Return the device with the given values, with exact sensors."""
        return device(self.template, values)

    @property
    def open_cells(self) -> NDArray[np.bool_]:
        """Whether each cell is of a recording with commands."""
        found = np.empty(self.measured.size, dtype=bool)
        for part in self.parts:
            found[part.cells] = self.piece_of(part).recording.open_loop
        return found

    def draws(self, values: Mapping[str, float], count: int) -> Values:
        """Return readings in closed loop with `count` times `LANES` other draws of the noise; 0 in open loop.

        They have the shape (draws, cells).
        """
        found = np.zeros((count * LANES, self.measured.size))
        for block, pieces in enumerate(self.blocks):
            if not pieces[0].recording.open_loop:
                inputs, profile = inputs_of(pieces, self.template), device(self.noisy, values)
                keys = _KEYS + np.arange(LANES, (count + 1) * LANES, LANES, dtype=np.uint64)[:, None]
                outputs = self._replay_setpoints([profile] * count, [inputs] * count, keys)
                for part in self.parts:
                    if part.block == block:
                        signals = (
                            outputs[..., CHANNELS.index(part.channel)].transpose(0, 2, 1).reshape(count * LANES, -1)
                        )
                        for draw, signal in enumerate(signals):
                            found[draw, part.cells] = at_rows(pieces[0], signal, self.period)[part.known]
        return found

    def predict(
        self,
        devices: Sequence[Mapping[str, float]],
        slider_noise: float = 0.0,
        states: Values | None = None,
        noise: bool = True,
    ) -> Values:
        """Return the readings that devices with these values would give, shape (devices, cells).

        Parameters
        ----------
        devices : sequence of mapping
            Values of `seen`.
        slider_noise : float
            Standard deviation [m]: a slider's reading is clipped at 0 after its noise, so a slack string reads more
            than 0 in the mean.
        states : ndarray, shape (devices, pieces, 2), optional
            Added to angle [rad] and velocity [rad/s] at each piece's begin; 0 if None.
        noise : bool
            Whether the sensors have noise in closed loop.
        """
        if states is None:
            states = np.zeros((len(devices), len(self.pieces), 2))
        chunks = [slice(k, k + _DEVICES) for k in range(0, len(devices), _DEVICES)]
        return np.concatenate([self._predict(devices[each], slider_noise, states[each], noise) for each in chunks])

    def _predict(
        self, devices: Sequence[Mapping[str, float]], slider_noise: float, states: Values, noise: bool
    ) -> Values:
        profiles = [self.profile(values) for values in devices]
        found = np.empty((len(devices), self.measured.size))
        first = 0
        for block, pieces in enumerate(self.blocks):
            inputs = [inputs_of(pieces, self.template, values.get("command_delay", 0.0)) for values in devices]
            offsets = np.zeros((len(devices), LANES, 2))
            offsets[:, : len(pieces)] = states[:, first : first + len(pieces)]
            first += len(pieces)
            closed = not pieces[0].recording.open_loop
            if closed:
                own = [device(self.noisy, values) for values in devices] if noise else profiles
                keys = np.tile(_KEYS, (len(devices), 1))
                outputs = self._replay_setpoints(own, inputs, keys).mean(axis=2, keepdims=True)
            else:
                outputs = self._replay_commands(profiles, devices, inputs, offsets)
            for part in self.parts:
                if part.block == block:
                    piece, channel = pieces[part.lane], CHANNELS.index(part.channel)
                    for k, values in enumerate(devices):
                        signal = at_rows(piece, outputs[k, :, part.lane, channel], self.period)[part.known]
                        found[k, part.cells] = self._read(part.channel, signal, values, 0.0 if closed else slider_noise)
        return found

    def _read(self, channel: str, signal: Values, values: Mapping[str, float], slider_noise: float) -> Values:
        if channel == "angle":
            return signal + values.get("encoder_bias", 0.0)
        if channel in FORCES:
            return signal
        biased = signal + values.get(f"slider_bias_{channel.removeprefix('slider_')}", 0.0)
        if slider_noise <= 0.0:
            return np.maximum(biased, 0.0)
        place = biased / slider_noise
        density = np.exp(-0.5 * place * place) / np.sqrt(2.0 * np.pi)
        return np.asarray(biased * ndtr(place) + slider_noise * density)

    def _replay_setpoints(
        self, profiles: Sequence[Profile], inputs: Sequence[Inputs], keys: NDArray[np.uint64]
    ) -> Values:
        """Return the outputs of devices in their loop, with a key of the noise for each lane."""
        simulation = _simulation(profiles)
        rows = np.concatenate([_scenarios(each, profile) for each, profile in zip(inputs, profiles, strict=True)])
        rows["noise_key"] = keys.ravel()
        start_in_balance(simulation, rows)
        first, second = np.stack([each.first for each in inputs]), np.stack([each.second for each in inputs])
        return replay_setpoints(simulation, first, second, np.arange(len(profiles)))

    def _replay_commands(
        self,
        profiles: Sequence[Profile],
        devices: Sequence[Mapping[str, float]],
        inputs: Sequence[Inputs],
        offsets: Values,
    ) -> Values:
        """Return the outputs of devices whose drives get the logged commands."""
        simulation = _simulation(profiles)
        first = np.stack([each.first for each in inputs])
        second = np.stack([each.second for each in inputs])
        rows = np.concatenate([_scenarios(each, profile) for each, profile in zip(inputs, profiles, strict=True)])
        first += np.array([values.get("zero_biceps", 0.0) for values in devices])[:, None, None]
        second += np.array([values.get("zero_triceps", 0.0) for values in devices])[:, None, None]
        angle, velocity = (np.stack(each) for each in zip(*((own.angle, own.velocity) for own in inputs), strict=True))
        angle[:, -1] += offsets[:, :, 0]
        velocity[:, -1] += offsets[:, :, 1]
        start_at_commands(simulation, rows, angle[:, 0].ravel(), first[:, 0].ravel(), second[:, 0].ravel())
        return replay_commands(simulation, first, second, np.arange(len(profiles)), (angle, velocity))


def _simulation(profiles: Sequence[Profile]) -> Simulation:
    """Return a simulation with a block of each device."""
    simulation = Simulation(profiles, LANES * len(profiles))
    simulation.assign(np.arange(len(profiles)), np.arange(len(profiles)))
    return simulation


def _scenarios(inputs: Inputs, profile: Profile) -> NDArray[np.void]:
    """Return the scenarios of a block's lanes: initial posture and payload."""
    rows = empty_rows(LANES, profile)
    rows["orientation"] = ORIENTATIONS.index("profile")
    rows["initial_angle"] = inputs.angle[-1]
    if not inputs.pieces[0].recording.open_loop:
        rows["initial_tension"] = inputs.second[0]
    for lane, piece in enumerate(inputs.pieces):
        if piece.recording.payload is not None:
            rows["payload_mass"][lane] = piece.recording.payload.mass
            rows["payload_arm"][lane] = piece.recording.payload.arm
    load_arm(rows, profile)
    return rows


def _noisy(template: Profile, recordings: Sequence[Recording]) -> Profile:
    """Return a profile with the sensors' noise as the logs in closed loop show it, where they have a row per tick.

    Elsewhere it is that of the template, with its rounding as noise too.
    """
    sensors, period = template.sensors, template.loop.control_period
    step = 2.0 * np.pi / 2**sensors.encoder_bits if sensors.encoder_bits else 0.0
    angle = float(np.hypot(np.radians(sensors.encoder_noise_deg), step / np.sqrt(12.0)))
    slider = sensors.potentiometer_noise
    for recording in recordings:
        if not recording.open_loop and np.median(np.diff(recording.columns["time"])) < 1.5 * period:
            known = {name: values[np.isfinite(values)] for name, values in recording.columns.items()}
            angle = rough_noise(known["angle"])
            slider = float(np.mean([rough_noise(known[name]) for name in SLIDERS if name in known] or [slider]))
    return _with_noise(template, angle, slider)


def _with_noise(profile: Profile, angle: float, slider: float) -> Profile:
    """Return a profile whose sensors have noise [rad], [m], and do not round."""
    noise = {"encoder_noise_deg": float(np.degrees(angle)), "potentiometer_noise": slider}
    sensors = profile.sensors.model_copy(update={"encoder_bits": 0, "potentiometer_bits": 0, **noise})
    return profile.model_copy(update={"sensors": sensors})
