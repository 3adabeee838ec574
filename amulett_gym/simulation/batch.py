"""A batch of one or more simulated devices: the interface to the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import look_up, steepest_slope
from amulett_gym.profile import MOST_TENSION, Profile
from amulett_gym.simulation import kernel, layout
from amulett_gym.simulation.layout import (
    CONTROLS,
    DRIVES,
    LANES,
    LOOPS,
    Control,
    Loop,
    Paths,
    pack_loop,
    pack_parameters,
    words,
    zeros,
)


class Simulation:
    """Devices with one profile, each in its own scenario.

    Parameters
    ----------
    profile : Profile
    num_devices : int
        At least 1.
    control : str
        One of `layout.CONTROLS`, or `layout.DRIVES`.
    tension_law : {"agent", "eq6", "eq6-printed"}
        Source of the tension setpoint: :meth:`command_tension`, or eq. 6 inside the loop, at control rate.

    Attributes
    ----------
    parameters, scenarios, states : ndarray
        The records that the kernel reads and writes (see :mod:`amulett_gym.simulation.layout`).
    paths : layout.Paths or None
        None unless a device's setpoint is a path.
    loop : layout.Loop or None
        Gains and memory of a loop that is not the paper's.

    Raises
    ------
    AmulettError
        If a name is unknown or there is no device.
    """

    def __init__(
        self, profile: Profile, num_devices: int = 1, control: Control = "decentralized", tension_law: str = "agent"
    ) -> None:
        if num_devices < 1:
            raise AmulettError(f"num_devices is {num_devices}; at least 1 is needed")
        self.profile = profile
        self.num_devices = num_devices
        self.control = control
        self.parameters = pack_parameters(profile, control, tension_law)
        num_blocks = -(-num_devices // LANES)
        self.scenarios = np.zeros(num_blocks, dtype=layout.SCENARIO_BLOCK)
        self.states = zeros(num_blocks, layout.STATE_BLOCK)
        self.paths: Paths | None = None
        self.loop: Loop | None = None
        if control in (*LOOPS, DRIVES):
            self.loop = pack_loop(profile, control), zeros(num_blocks, layout.LOOP_BLOCK)

    @property
    def control_period(self) -> float:
        """Time between two control ticks [s]."""
        return float(self.parameters["control_period"][0])

    @property
    def max_force(self) -> float:
        """Force at which the springs saturate [N]."""
        return float(look_up(self.parameters["force_table"][0], 1.0))

    @property
    def max_stiffness(self) -> float:
        """Joint stiffness with both strings at their largest stiffness [N m/rad]."""
        p = self.parameters[0]
        slope = steepest_slope(p["force_table"]) * p["inverse_max_deflection"]
        return float(2.0 * slope * p["joint_radius"] ** 2)

    def reset(
        self,
        scenarios: NDArray[np.void],
        devices: NDArray[np.int64] | None = None,
        paths: Sequence[NDArray[np.void]] | None = None,
    ) -> None:
        """Reset devices to rest in their initial posture.

        Parameters
        ----------
        scenarios : ndarray of `SCENARIO`
            One for each of the devices.
        devices : ndarray of int, optional
            All if None.
        paths : sequence of ndarray of `PATH`, optional
            One for each of the devices (`tasks.scenario.pack_path`), empty where its setpoint follows moves.

        Raises
        ------
        AmulettError
            If an initial posture needs a string force or a drive angle out of range, or a scenario's path is missing.
        """
        devices = np.arange(self.num_devices) if devices is None else devices
        self._check_posture(scenarios)
        lengths = np.array([len(path) for path in paths]) if paths else np.zeros(len(scenarios), dtype=np.int64)
        if ((lengths > 0) != (scenarios["move_count"] == layout.ON_PATH)).any():
            raise AmulettError("a scenario whose setpoint is a path has to be reset with it (paths=...)")
        self._keep_paths(devices, paths or [])
        block, lane = np.divmod(devices, LANES)
        for own, new in zip(words(self.scenarios, LANES), words(np.ascontiguousarray(scenarios), 1), strict=True):
            own[block, :, lane] = new[..., 0]
        words(self.states, LANES)[0][block, :, lane] = 0
        kernel.settle(self.parameters, self.scenarios, self.states, self.paths, self.loop, devices)

    def command_tension(self, tension: ArrayLike) -> None:
        """Set the tension setpoint of each device [N], scalar or shape (num_devices,), until the next call.

        Raises
        ------
        AmulettError
            If the absolute value of a tension is NaN or more than 1e6 N.
        """
        if not (np.abs(tension) <= MOST_TENSION).all():
            raise AmulettError(f"the tension command is {tension!r}; at most {MOST_TENSION:,.0f} N are allowed")
        block, lane = np.divmod(np.arange(self.num_devices), LANES)
        self.states["tension_command"][block, lane] = tension
        self.states["tension_rate"][block, lane] = 0.0

    def command_mean(self, angle: ArrayLike) -> None:
        """Set the mean angle of each device's drives [rad], scalar or shape (num_devices,), until the next call.

        Raises
        ------
        AmulettError
            If the loop is not `layout.DRIVES`, or an angle is not finite.
        """
        if self.loop is None or self.loop[0]["loop"][0] != len(LOOPS):
            raise AmulettError(f"only the loop '{DRIVES}' takes a mean drive angle; make it with control='{DRIVES}'")
        if not np.isfinite(angle).all():
            raise AmulettError(f"the mean drive angle is {angle!r}; it has to be finite")
        block, lane = np.divmod(np.arange(self.num_devices), LANES)
        self.loop[1]["mean_command"][block, lane] = angle
        self.loop[1]["mean_rate"][block, lane] = 0.0

    def advance(self, ticks: int) -> None:
        """Simulate a number of control ticks."""
        kernel.advance(self.parameters, self.scenarios, self.states, self.paths, self.loop, self.num_devices, ticks)

    def read(self, name: str) -> NDArray[Any]:
        """Return a copy of one quantity of the state (see `layout.STATE_NAMES`), shape (num_devices,)."""
        return self.states[name].reshape(-1)[: self.num_devices].copy()

    def read_scenarios(self, devices: NDArray[np.int64]) -> NDArray[np.void]:
        """Return a copy of the given devices' scenarios, `SCENARIO` records of shape (len(devices),)."""
        block, lane = np.divmod(devices, LANES)
        copies = np.zeros(block.size, dtype=layout.SCENARIO)  # gaps are zero, so that records can be hashed
        for copy, own in zip(words(copies, 1), words(self.scenarios, LANES), strict=True):
            copy[..., 0] = own[block, :, lane]
        return copies

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all data that an episode changes."""
        memory = {} if self.loop is None else {"loop": self.loop[1].copy(), "control": self.control}
        return {
            "scenarios": self.scenarios.copy(),
            "states": self.states.copy(),
            "paths": deepcopy(self.paths),
            **memory,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot taken by `get_state` from a simulation of the same size and loop; else AmulettError."""
        if state["states"].shape != self.states.shape:
            raise AmulettError(
                f"the snapshot holds {state['states'].size} blocks of devices; this simulation has {self.states.size}"
            )
        if (found := state.get("control", CONTROLS[0])) != (self.control if self.loop is not None else CONTROLS[0]):
            raise AmulettError(f"the snapshot is of the loop '{found}'; this simulation has '{self.control}'")
        self.scenarios[...] = state["scenarios"]
        self.states[...] = state["states"]
        self.paths = deepcopy(state["paths"])
        if self.loop is not None:
            self.loop[1][...] = state["loop"]

    def read_path(self, device: int) -> NDArray[np.void]:
        """Return a copy of one device's setpoint path, records of `PATH`; empty if its setpoint follows moves."""
        if self.paths is None:
            return np.zeros(0, dtype=layout.PATH)
        parts, places = self.paths
        first, count = (places[name][divmod(device, LANES)] for name in ("first", "count"))
        return parts[first : first + count].copy()

    def _keep_paths(self, devices: NDArray[np.int64], paths: Sequence[NDArray[np.void]]) -> None:
        """Set new paths of some devices, and keep those of the others."""
        found = dict(zip(devices.tolist(), paths, strict=False))
        if self.paths is not None:
            others = np.setdiff1d(np.flatnonzero(self.paths[1]["count"]), devices).tolist()
            found |= {device: self.read_path(device) for device in others}
        found = {device: path for device, path in found.items() if path.size}
        self.paths = None
        if found:
            places = zeros(self.states.size, layout.PLACE_BLOCK)
            block, lane = np.divmod(list(found), LANES)
            places["count"][block, lane] = lengths = [path.size for path in found.values()]
            places["first"][block, lane] = np.cumsum(lengths) - lengths
            self.paths = np.concatenate(list(found.values())), places

    def _check_posture(self, scenarios: NDArray[np.void]) -> None:
        """Refuse a start that the strings cannot hold or the drives cannot reach."""
        p = self.parameters[0]
        angle, tension = scenarios["initial_angle"], scenarios["initial_tension"]
        side = scenarios["obstacle_side"]
        depth = np.maximum(side * (angle - scenarios["obstacle_angle"]), 0.0)
        contact = side * scenarios["obstacle_stiffness"] * depth
        needed = (scenarios["static_torque"] * np.sin(angle) + contact) / p["joint_radius"]
        biceps_is_agonist = needed >= 0 if p["fixed_agonist"] == 0 else np.full(needed.shape, p["fixed_agonist"] > 0)
        if p["tension_loop"]:
            agonist = tension + np.where(biceps_is_agonist, needed, -needed)
        else:
            agonist, tension = np.abs(needed), np.zeros_like(tension)
        # Forces of the profile's springs at the same deflection.
        weakest = np.minimum(scenarios["spring_biceps_factor"], scenarios["spring_triceps_factor"])
        most, least = np.maximum(agonist, tension) / weakest, np.minimum(agonist, tension)
        if (most > self.max_force).any() or (least < 0).any():
            worst = int(np.argmax(np.maximum(most - self.max_force, -least)))
            force = most[worst] if most[worst] > self.max_force else least[worst]
            raise AmulettError(
                f"scenario {worst} starts with a string force of {force:.2f} N (its tension and the load of weight "
                f"and contact at {np.degrees(angle[worst]):.1f} deg); the springs give 0 to {self.max_force:.2f} N"
            )
        stretch = p["position_only_offset"] * p["drive_radius"]
        if p["tension_loop"]:
            forces = np.append(p["force_table"][:, 0], self.max_force)
            stretch = np.interp(most, forces, np.linspace(0.0, 1.0 / p["inverse_max_deflection"], forces.size))
        smallest = np.minimum(scenarios["pulley_biceps_factor"], scenarios["pulley_triceps_factor"])
        turn = (np.abs(angle) * p["joint_radius"] + stretch) / (smallest * p["drive_radius"])
        if (turn > p["command_limit"]).any():
            worst = int(np.argmax(turn))
            raise AmulettError(
                f"scenario {worst} may start with a drive turned by {np.degrees(turn[worst]):.1f} deg; the profile's "
                f"command_limit_deg is {np.degrees(p['command_limit']):.1f}"
            )
