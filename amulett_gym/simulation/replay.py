"""Replay of logged inputs on a batch of devices: drive commands (open loop), or setpoints of the paper's loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.jit.compiled import compiled
from amulett_gym.simulation import layout
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.equilibrium import settle
from amulett_gym.simulation.kernel import act, begin_motion, move
from amulett_gym.simulation.layout import LANES, words

OUTPUTS = ("measured_angle", "measured_biceps", "measured_triceps", "estimate_biceps", "estimate_triceps")
"""What `replay` returns: the sensors' readings [rad], [m] and the estimated string forces [N]."""

Inputs = NDArray[np.float64]


def start_at_commands(
    simulation: Simulation, scenarios: NDArray[np.void], angle: Inputs, biceps: Inputs, triceps: Inputs
) -> None:
    """Start all devices at rest at an angle, with their drives at their commands [rad], in balance or not.

    Parameters
    ----------
    scenarios : ndarray of `layout.SCENARIO`, shape (num_devices,)
    angle, biceps, triceps : ndarray, shape (num_devices,)
    """
    _place(simulation, scenarios)
    states, blocks = simulation.states, (simulation.states.size, LANES)
    states["angle"] = states["measured_angle"] = angle.reshape(blocks)
    states["command_biceps"] = states["drive_biceps"] = biceps.reshape(blocks)
    states["command_triceps"] = states["drive_triceps"] = triceps.reshape(blocks)


def start_in_balance(simulation: Simulation, scenarios: NDArray[np.void]) -> None:
    """Start all devices in their scenarios' posture, as `Simulation.reset` does, but whether they can hold it or not.

    Parameters
    ----------
    scenarios : ndarray of `layout.SCENARIO`, shape (num_devices,)
    """
    _place(simulation, scenarios)
    blocks = simulation.which, simulation.scenarios, simulation.states
    others = None, simulation.loop, simulation.extended
    settle(simulation.parameters, *blocks, *others, np.arange(simulation.num_devices))


def _place(simulation: Simulation, scenarios: NDArray[np.void]) -> None:
    for own, new in zip(words(simulation.scenarios, LANES), words(scenarios, 1), strict=True):
        own[...] = new.reshape(own.shape[0], LANES, own.shape[1]).transpose(0, 2, 1)
    words(simulation.states, LANES)[0][...] = 0


def replay_commands(
    simulation: Simulation,
    biceps: Inputs,
    triceps: Inputs,
    chosen: NDArray[np.int64],
    joint: tuple[Inputs, Inputs] | None = None,
) -> Inputs:
    """Return the sensor readings of devices whose drives get the given commands instead of those of their loop.

    Parameters
    ----------
    simulation : Simulation
        With whole blocks of devices, started by the caller (`start_at_commands`).
    biceps, triceps : ndarray, shape (sets, ticks, LANES)
        Sets of commands [rad] during each tick, by the lane of a device in its block.
    chosen : ndarray of int, shape (blocks,)
        Each block's set.
    joint : two ndarrays, shape (sets, first ticks, LANES), optional
        Angle [rad] and velocity [rad/s] at the beginning of the first ticks, in which the joint is led.

    Returns
    -------
    ndarray, shape (blocks, ticks, LANES, 5)
        `OUTPUTS` at the beginning of each tick, what the loop would act on in it.
    """
    return _run(simulation, biceps, triceps, chosen, joint, None)


def replay_setpoints(simulation: Simulation, setpoint: Inputs, tension: Inputs, chosen: NDArray[np.int64]) -> Inputs:
    """Return the sensor readings of devices whose loop gets the given setpoints in each tick.

    Parameters
    ----------
    simulation : Simulation
        With whole blocks of devices, reset by the caller, and the tension law ``"agent"``.
    setpoint, tension : ndarray, shape (sets, ticks, LANES)
        Sets of position setpoints [rad] and tension setpoints [N] in each tick, by the lane of a device in its block.
    chosen : ndarray of int, shape (blocks,)
        Each block's set.

    Returns
    -------
    ndarray, shape (blocks, ticks, LANES, 5)
        As of `replay_commands`.
    """
    return _run(simulation, setpoint, tension, chosen, None, True)


def _run(
    simulation: Simulation,
    first: Inputs,
    second: Inputs,
    chosen: NDArray[np.int64],
    joint: tuple[Inputs, Inputs] | None,
    closed: bool | None,
) -> Inputs:
    if simulation.num_devices % LANES:
        raise AmulettError(f"num_devices is {simulation.num_devices}; a replay needs whole blocks of {LANES}")
    found = np.empty((simulation.states.size, first.shape[1], LANES, len(OUTPUTS)))
    blocks = simulation.which, simulation.scenarios, simulation.states
    loop = None if closed is None else simulation.loop
    led, speed = joint or (np.empty((len(first), 0, LANES)),) * 2
    inputs, path = (
        (np.ascontiguousarray(one, dtype=np.float64), np.ascontiguousarray(other, dtype=np.float64))
        for one, other in ((first, second), (led, speed))
    )
    _advance(simulation.parameters, *blocks, loop, simulation.extended, *inputs, *path, chosen, closed, found)
    return found


@compiled
def _advance(p, which, c_blocks, s_blocks, loop, extended, first, second, angle, velocity, chosen, closed, found):
    """Advance whole blocks by a tick for each row of the inputs; `closed` is None or True, whether the loop runs."""
    motion = np.empty(1, dtype=layout.MOTION_BLOCK)
    begin, end = np.uint64(0), np.uint64(layout.LANES)
    for block in range(s_blocks.shape[0]):
        own, m = which[block], motion[0]
        parameters, c, s = p[own], c_blocks[block], s_blocks[block]
        for i in range(layout.LANES):
            m.counting[i] = 0.0
        inputs = chosen[block]
        for row in range(first.shape[1]):
            _read(s, found[block, row])
            if row < angle.shape[1]:
                _lead(s, angle[inputs, row], velocity[inputs, row])
            _set(s, first[inputs, row], second[inputs, row], closed)
            if closed is not None:
                act(parameters, s, m, loop, own, block, begin, end)
            begin_motion(parameters, c, s, m, begin, end)
            move(parameters, c, s, m, begin, end, extended)


@compiled
def _read(s, row):
    for i in range(layout.LANES):
        row[i, 0], row[i, 1], row[i, 2] = s.measured_angle[i], s.measured_biceps[i], s.measured_triceps[i]
        row[i, 3], row[i, 4] = s.estimate_biceps[i], s.estimate_triceps[i]


@compiled
def _lead(s, angle, velocity):
    for i in range(layout.LANES):
        s.angle[i], s.velocity[i] = angle[i], velocity[i]


@compiled
def _set(s, first, second, closed):
    for i in range(layout.LANES):
        if closed is None:
            s.command_biceps[i], s.command_triceps[i] = first[i], second[i]
        else:
            s.setpoint_jump[i] = first[i] - s.setpoint[i]
            s.setpoint[i] = first[i]
            s.tension_command[i], s.tension_rate[i] = second[i], 0.0
