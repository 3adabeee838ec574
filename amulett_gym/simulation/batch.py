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
from amulett_gym.simulation import equilibrium, kernel, layout
from amulett_gym.simulation.layout import (
    CONTROLS,
    DRIVES,
    LANES,
    LOOPS,
    STATE_NAMES,
    Control,
    Loop,
    Paths,
    joined,
    pack_loop,
    pack_parameters,
    words,
    zeros,
)


class Simulation:
    """Devices with one profile or several, each in its own scenario.

    Parameters
    ----------
    profile : Profile or sequence of Profile
        Of all devices, or those that blocks of `LANES` devices may have (:meth:`assign`).
    num_devices : int
        At least 1.
    control : str
        One of `layout.CONTROLS`, or `layout.DRIVES`.
    tension_law : {"agent", "eq6", "eq6-printed"}
        Source of the tension setpoint: :meth:`command_tension`, or eq. 6 inside the loop, at control rate.

    Attributes
    ----------
    profiles : tuple of Profile
    parameters, scenarios, states : ndarray
        The records that the kernel reads and writes (see :mod:`amulett_gym.simulation.layout`); `parameters` has one
        for each profile.
    which : ndarray of int, shape (blocks,)
        Index of each block's profile.
    paths : layout.Paths or None
        None unless a device's setpoint is a path.
    loop : layout.Loop or None
        Gains and memory of a loop that is not the paper's.
    extended : True or None
        Whether springs of a profile go on beyond their table, or its drives stall.

    Raises
    ------
    AmulettError
        If a name is unknown or there is no device.
    """

    def __init__(
        self,
        profile: Profile | Sequence[Profile],
        num_devices: int = 1,
        control: Control = "decentralized",
        tension_law: str = "agent",
    ) -> None:
        if num_devices < 1:
            raise AmulettError(f"num_devices is {num_devices}; at least 1 is needed")
        self.profiles = (profile,) if isinstance(profile, Profile) else tuple(profile)
        if not self.profiles:
            raise AmulettError("there is no profile; at least 1 is needed")
        self.num_devices = num_devices
        self.control = control
        packed = (pack_parameters(each, control, tension_law) for each in self.profiles)
        self.parameters = joined(packed, layout.PARAMETERS)
        num_blocks = -(-num_devices // LANES)
        self.scenarios = np.zeros(num_blocks, dtype=layout.SCENARIO_BLOCK)
        self.states = zeros(num_blocks, layout.STATE_BLOCK)
        self.which = np.zeros(num_blocks, dtype=np.int64)
        self.extended = True if self.parameters["extended"].any() else None
        self.paths: Paths | None = None
        self.loop: Loop | None = None
        if control in (*LOOPS, DRIVES):
            gains = joined((pack_loop(each, control) for each in self.profiles), layout.LOOP_PARAMETERS)
            self.loop = gains, zeros(num_blocks, layout.LOOP_BLOCK)

    @property
    def profile(self) -> Profile:
        """The profile of all devices; AmulettError if there are several, as in the next three (see `profile_of`)."""
        self._check_alike()
        return self.profiles[0]

    @property
    def control_period(self) -> float:
        """Time between two control ticks [s]."""
        self._check_alike()
        return float(self.parameters["control_period"][0])

    @property
    def max_force(self) -> float:
        """Force at the end of the springs' table [N], at which they saturate if it is held beyond."""
        self._check_alike()
        return max_force(self.parameters[0])

    @property
    def max_stiffness(self) -> float:
        """Joint stiffness with both strings at their largest stiffness [N m/rad]."""
        self._check_alike()
        return max_stiffness(self.parameters[0])

    def profile_of(self, device: int) -> Profile:
        """Return the profile of one device."""
        return self.profiles[self.which[device // LANES]]

    def parameters_of(self, device: int) -> Any:
        """Return the record of `parameters` of one device."""
        return self.parameters[self.which[device // LANES]]

    def assign(self, blocks: NDArray[np.int64] | int, profiles: NDArray[np.int64] | Sequence[int] | int) -> None:
        """Give blocks of `LANES` devices other profiles; their devices have to be reset afterwards.

        Parameters
        ----------
        blocks, profiles : int or ndarray of int, shape (K,)
            Indices of blocks, and into `profiles`.

        Raises
        ------
        AmulettError
            If there is no such profile.
        """
        indices = np.asarray(profiles)
        if not ((indices >= 0) & (indices < len(self.profiles))).all():
            raise AmulettError(f"the profiles' indices are {profiles}; allowed are 0 to {len(self.profiles) - 1}")
        self.which[blocks] = indices

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
            If an initial posture needs a string force or a drive angle out of range, or stalls a drive, or a scenario's
            path is missing.
        """
        devices = np.arange(self.num_devices) if devices is None else devices
        which = self.which[devices // LANES]
        self._check_posture(scenarios, which)
        self._check_stall(scenarios, which)
        has_path = np.array([path.size > 0 for path in paths]) if paths else False
        if ((scenarios["move_count"] == layout.ON_PATH) != has_path).any():
            raise AmulettError("a scenario whose setpoint is a path has to be reset with it (paths=...)")
        self._keep_paths(devices, paths or [])
        block, lane = np.divmod(devices, LANES)
        for own, new in zip(words(self.scenarios, LANES), words(scenarios, 1), strict=True):
            own[block, :, lane] = new[..., 0]
        words(self.states, LANES)[0][block, :, lane] = 0
        self._settle(devices)

    def _settle(self, devices: NDArray[np.int64]) -> None:
        """Set the given devices' states, which are zero, to rest."""
        blocks = self.which, self.scenarios, self.states
        equilibrium.settle(self.parameters, *blocks, self.paths, self.loop, self.extended, devices)

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
        """Simulate a number of control ticks, of each device's own control period."""
        blocks = self.which, self.scenarios, self.states
        kernel.advance(self.parameters, *blocks, self.paths, self.loop, self.extended, self.num_devices, ticks)

    def read(self, name: str) -> NDArray[Any]:
        """Return a copy of one quantity of the state (see `layout.STATE_NAMES`), shape (num_devices,)."""
        return self.states[name].flatten()[: self.num_devices]

    def live(self, device: int) -> dict[str, NDArray[Any]]:
        """Return views of one device's whole state, arrays of shape () by the names of `layout.STATE_NAMES`."""
        block, lane = divmod(device, LANES)
        return {name: self.states[name][block, lane, ...] for name in STATE_NAMES}

    def read_scenarios(self, devices: NDArray[np.int64]) -> NDArray[np.void]:
        """Return a copy of the given devices' scenarios, `SCENARIO` records of shape (len(devices),)."""
        block, lane = np.divmod(devices, LANES)
        copies = np.zeros(block.size, dtype=layout.SCENARIO)  # gaps are zero, so that records can be hashed
        for copy, own in zip(words(copies, 1), words(self.scenarios, LANES), strict=True):
            copy[..., 0] = own[block, :, lane]
        return copies

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all data that an episode changes."""
        memory: dict[str, Any] = {} if self.loop is None else {"loop": self.loop[1].copy(), "control": self.control}
        if len(self.profiles) > 1:
            memory |= {"profiles": self._names, "which": self.which.copy()}
        return {
            "scenarios": self.scenarios.copy(),
            "states": self.states.copy(),
            "paths": deepcopy(self.paths),
            **memory,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot of `get_state`; AmulettError if it is of another size, loop or other profiles."""
        if state["states"].shape != self.states.shape:
            raise AmulettError(
                f"the snapshot holds {state['states'].size} blocks of devices; this simulation has {self.states.size}"
            )
        if (found := state.get("control", CONTROLS[0])) != (self.control if self.loop is not None else CONTROLS[0]):
            raise AmulettError(f"the snapshot is of the loop '{found}'; this simulation has '{self.control}'")
        names = self._names if len(self.profiles) > 1 else None
        if (found := state.get("profiles")) != names:
            raise AmulettError(
                f"the snapshot's devices are {found or 'of one profile'}; those of this simulation are "
                f"{names or 'of one profile'}"
            )
        if names is not None:
            self.which[...] = state["which"]
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
        """Set new paths of some devices, and keep those of the others.

        If nothing changes, `paths` stays the same object: for other paths, a step of several threads would start its
        threads anew.
        """
        had = self.paths is not None and self.paths[1]["count"].ravel()[devices].any()
        if not had and not any(path.size for path in paths):
            return
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
            self.paths = joined(found.values(), layout.PATH), places

    @property
    def _names(self) -> str:
        return ", ".join(profile.name for profile in self.profiles)

    def _check_alike(self) -> None:
        if len(self.profiles) > 1:
            raise AmulettError(
                f"the devices have {len(self.profiles)} profiles; ask for one device's: profile_of or parameters_of"
            )

    def _check_stall(self, scenarios: NDArray[np.void], which: NDArray[np.int64]) -> None:
        """Refuse a start in which the strings load a drive with its stall torque, so that it does not rest."""
        if self.extended is None:
            return  # no drive stalls
        stall = self.parameters["stall_torque"][which]
        if np.isinf(stall).all():
            return
        # Each in a block of its own, which names its profile.
        blocks, states = (zeros(which.size, kind) for kind in (layout.SCENARIO_BLOCK, layout.STATE_BLOCK))
        for own, new in zip(words(blocks, LANES), words(scenarios, 1), strict=True):
            own[:, :, 0] = new[..., 0]
        equilibrium.settle(
            self.parameters, which, blocks, states, None, None, self.extended, LANES * np.arange(which.size)
        )
        for name in ("biceps", "triceps"):
            force = states[f"force_{name}"][:, 0]
            load = force * scenarios[f"pulley_{name}_factor"] * self.parameters["drive_radius"][which]
            if (load >= stall * (1.0 - 1e-9)).any():
                worst = int(np.argmax(load / stall))
                raise AmulettError(
                    f"scenario {worst} starts with a string force of {force[worst]:.2f} N, a load of {load[worst]:.3g} "
                    f"N m on the drive of the {name}; the profile's drives.stall_torque is {stall[worst]:g} N m"
                )

    def _check_posture(self, scenarios: NDArray[np.void], which: NDArray[np.int64]) -> None:
        """Refuse a start that the strings cannot hold or the drives cannot reach; `which` are the profiles' indices."""

        def own(name: str) -> NDArray[np.float64]:
            return np.asarray(self.parameters[name][which])

        def turn(stretch: NDArray[np.float64]) -> NDArray[np.float64]:
            smallest = np.minimum(scenarios["pulley_biceps_factor"], scenarios["pulley_triceps_factor"])
            turned: NDArray[np.float64] = np.abs(angle) * own("joint_radius") + stretch
            return turned / (smallest * own("drive_radius"))

        angle, tension = scenarios["initial_angle"], scenarios["initial_tension"]
        side = scenarios["obstacle_side"]
        depth = np.maximum(side * (angle - scenarios["obstacle_angle"]), 0.0)
        contact = side * scenarios["obstacle_stiffness"] * depth
        needed = (scenarios["static_torque"] * np.sin(angle) + contact) / own("joint_radius")
        tension_loop = bool(self.parameters["tension_loop"][0])  # a batch has one loop
        if tension_loop:
            fixed = own("fixed_agonist")  # 0, or the sign of its torque: then its load may be negative
            agonist = tension + np.where(fixed == 0, np.abs(needed), fixed * needed)
        else:
            agonist, tension = np.abs(needed), np.zeros_like(tension)
        # Forces of the profile's springs at the same deflection.
        weakest = np.minimum(scenarios["spring_biceps_factor"], scenarios["spring_triceps_factor"])
        most, least = np.maximum(agonist, tension) / weakest, np.minimum(agonist, tension)
        limit = own("max_force")
        if ((most > limit) | (least < 0)).any():
            worst = int(np.argmax(np.maximum(most - limit, -least)))
            force = most[worst] if most[worst] > limit[worst] else least[worst]
            raise AmulettError(
                f"scenario {worst} starts with a string force of {force:.2f} N (its tension and the load of weight "
                f"and contact at {np.degrees(angle[worst]):.1f} deg); the springs give 0 to {limit[worst]:.2f} N"
            )
        limit = own("command_limit")
        if tension_loop:
            # No string stretches its spring beyond the table: where that fits, the tables need no search.
            if (turn(1.0 / own("inverse_max_deflection")) <= limit).all():
                return
            stretch = np.empty(len(scenarios))
            for kind in np.unique(which):
                rows = which == kind
                stretch[rows] = np.interp(most[rows], *_spring(self.parameters[kind]))
        else:
            stretch = own("position_only_offset") * own("drive_radius")
        turned = turn(stretch)
        if (turned > limit).any():
            worst = int(np.argmax(turned - limit))
            raise AmulettError(
                f"scenario {worst} may start with a drive turned by {np.degrees(turned[worst]):.1f} deg; the profile's "
                f"command_limit_deg is {np.degrees(limit[worst]):.1f}"
            )


def _spring(parameters: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return forces [N] of a profile's springs and the deflections [m] at which they give them, of a record."""
    forces = np.append(parameters["force_table"][:, 0], look_up(parameters["force_table"], 1.0))
    return forces, np.linspace(0.0, 1.0 / parameters["inverse_max_deflection"], forces.size)


def max_force(parameters: Any) -> float:
    """Return the force at the end of the springs' table [N], by a record of `layout.PARAMETERS`."""
    return float(parameters["max_force"])


def max_stiffness(parameters: Any) -> float:
    """Return the joint stiffness with both strings at their largest stiffness [N m/rad], by `layout.PARAMETERS`."""
    slope = max(steepest_slope(parameters["force_table"]), float(parameters["beyond_slope"]))
    slope *= parameters["inverse_max_deflection"]
    return float(2.0 * slope * parameters["joint_radius"] ** 2)
