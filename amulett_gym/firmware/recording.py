"""The simulation's own loop, tick by tick: what the controller read and what it commanded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.settings import Settings
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.firmware.lock_step import misses_tick
from amulett_gym.laws.contenders import Contender
from amulett_gym.laws.policies import named_policy
from amulett_gym.model.spring import look_up
from amulett_gym.simulation.batch import Simulation
from amulett_gym.tasks.scenario import Scenario

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Recording:
    """Control ticks of devices in the simulation.

    Attributes
    ----------
    begin : dict
        Where each device begins: the fields of `controller_begin` in ``controller.h``, each of shape (devices, ...).
    readings : dict
        What the controller reads in each tick, shape (ticks, devices): `angle` [rad], `biceps`, `triceps` [m],
        `setpoint`, `jump` [rad], `begins` and `late` (the flags).
    outputs : dict
        What the simulation's loop commands, shape (ticks, devices): `biceps`, `triceps` [rad], `tension_setpoint` [N],
        `agonist`.
    """

    begin: Columns
    readings: Columns
    outputs: Columns


class Reader:
    """What the controllers of a simulation's devices read in each tick; :meth:`read` is called before each one."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        devices = np.arange(simulation.num_devices)
        rows = simulation.read_scenarios(devices)
        self._may_be_late = np.flatnonzero(rows["late_probability"] > 0.0)
        self._seen, self._left = simulation.read("step_start"), np.zeros(devices.size)

    def read(self) -> Columns:
        """Return the readings for the next tick, each of shape (devices,)."""
        read = self._simulation.read
        start, jump = read("step_start"), read("setpoint_jump")
        late = self._late()
        found = {
            "angle": read("measured_angle"),
            "biceps": read("measured_biceps"),
            "triceps": read("measured_triceps"),
            "setpoint": read("setpoint"),
            "jump": jump - self._left,
            "begins": (start != self._seen).astype(np.uint8),
            "late": late.astype(np.uint8),
        }
        self._seen, self._left = start, np.where(late, jump, 0.0)  # a loop that misses its tick leaves the jump
        return found

    def _late(self) -> NDArray[np.bool_]:
        """Return which devices miss their next control tick."""
        late = np.zeros(self._simulation.num_devices, dtype=bool)
        for device in self._may_be_late:
            late[device] = misses_tick(self._simulation.scenarios, self._simulation.states, device)
        return late


def begin_of(simulation: Simulation) -> Columns:
    """Return where the devices of a simulation that was just reset begin: `Recording.begin`."""
    read = simulation.read
    rows = simulation.read_scenarios(np.arange(simulation.num_devices))

    def both(name: str) -> NDArray[Any]:
        return np.stack([read(f"{name}_biceps"), read(f"{name}_triceps")], axis=-1)

    return {
        "command": both("command"),
        "angle": read("angle"),
        "tension": read("tension_setpoint"),
        "estimate": both("estimate"),
        "difference": read("measured_difference"),
        "output": read("position_output"),
        "offset": both("offset"),
        "tension_integral": read("tension_integral"),
        "averaged_angle": read("angle") + rows["encoder_bias"],
        "averaged_slider": _averaged_sliders(simulation, rows),
        "agonist": read("agonist").astype(np.int8),
    }


def read_outputs(simulation: Simulation) -> Columns:
    """Return what the loop commanded in the last tick: `Recording.outputs`, each of shape (devices,)."""
    read = simulation.read
    return {
        "biceps": read("command_biceps"),
        "triceps": read("command_triceps"),
        "tension_setpoint": read("tension_setpoint"),
        "agonist": read("agonist").astype(np.int8),
    }


def record(
    contender: Contender,
    settings: Settings,
    steps: int,
    num_devices: int = 1,
    seed: int = 0,
    scenarios: Sequence[Scenario] | None = None,
) -> Recording:
    """Run a law in the simulation and return every control tick.

    Parameters
    ----------
    contender, settings
        As `firmware.laws.choose` returns them; the settings' suite and split have the scenarios.
    steps : int
        Agent steps.
    num_devices, seed : int
        Device i plays the episode of ``seed + i``.
    scenarios : sequence of Scenario, optional
        One for each device, instead of the suite's.
    """
    env = TensionVectorEnv(**{**settings.given, "tension_range": settings.tension_range}, num_envs=num_devices)
    observations, _ = env.reset(seed=seed, options=None if scenarios is None else {"scenario": list(scenarios)})
    act = None if contender.policy_name is None else named_policy(contender.policy_name, env)
    simulation, ticks, actions = env.episodes.simulation, settings.ticks(settings.profile), None
    begin, reader = begin_of(simulation), Reader(simulation)
    readings, outputs = list[Columns](), list[Columns]()
    for _ in range(steps):
        if act is not None:
            actions = np.asarray(act(observations), dtype=np.float64)[:, 0]
        for tick in range(ticks):
            if actions is not None and tick == settings.action_delay:
                env.episodes.begin_ramps(actions)
            readings.append(reader.read())
            simulation.advance(1)
            outputs.append(read_outputs(simulation))
        if actions is not None:
            env.episodes.end_ramps(actions)
            observations = env.episodes.observe()
    return Recording(begin, _stacked(readings), _stacked(outputs))


def _stacked(rows: list[Columns]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _averaged_sliders(simulation: Simulation, rows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return what both sliders read in the mean at rest [m], shape (devices, 2)."""
    found = np.zeros((rows.size, 2))
    for device, row in enumerate(rows):
        p = simulation.parameters_of(device)
        angle = float(simulation.read("angle")[device]) * float(p["joint_radius"])
        for k, (name, way) in enumerate((("biceps", 1.0), ("triceps", -1.0))):
            radius = float(p["drive_radius"]) * float(row[f"pulley_{name}_factor"])
            turned = float(simulation.read(f"drive_{name}")[device]) * radius
            position = way * (turned - angle) * float(p["inverse_max_deflection"])
            found[device, k] = look_up(p["spring_table"], position) + float(row[f"slider_bias_{name}"])
    return found
