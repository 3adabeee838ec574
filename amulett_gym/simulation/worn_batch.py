"""A batch of devices with a wearer in each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.model.wearer import ACTIVE_SHARE, DAMPING, PASSIVE_DAMPING, STIFFNESS
from amulett_gym.profile import STABLE_STEP, Profile
from amulett_gym.simulation import worn
from amulett_gym.simulation.batch import Simulation, max_stiffness
from amulett_gym.simulation.layout import LANES, Control, joined, words, zeros
from amulett_gym.simulation.worn_layout import FITTING, PERSON, PERSON_BLOCK, WORN_BLOCK, WORN_NAMES, Worn, pack_fitting

CABLE_STEP = 1.5
"""As `profile.STABLE_STEP` [rad]; less, since the loss of a cable is updated once in an integration step."""


class WornSimulation(Simulation):
    """Devices, each on a wearer's arm; parameters as of `Simulation`.

    Attributes
    ----------
    worn : worn_layout.Worn
        How each profile is worn, blocks of wearers, blocks of their state.
    """

    def __init__(
        self,
        profile: Profile | Sequence[Profile],
        num_devices: int = 1,
        control: Control = "decentralized",
        tension_law: str = "agent",
    ) -> None:
        super().__init__(profile, num_devices, control, tension_law)
        fittings = joined((pack_fitting(each) for each in self.profiles), FITTING)
        blocks = self.states.size
        self._stiffness = np.array([max_stiffness(each) for each in self.parameters])
        self.worn: Worn = fittings, zeros(blocks, PERSON_BLOCK), zeros(blocks, WORN_BLOCK)

    def reset(
        self,
        scenarios: NDArray[np.void],
        devices: NDArray[np.int64] | None = None,
        paths: Sequence[NDArray[np.void]] | None = None,
        wearers: NDArray[np.void] | None = None,
    ) -> None:
        """Reset devices and wearers to rest in their initial posture; see `Simulation.reset`.

        Parameters
        ----------
        scenarios, devices, paths
            As of `Simulation.reset`.
        wearers : ndarray of `worn_layout.PERSON`, optional
            One for each of the devices; None: those of the last reset.

        Raises
        ------
        AmulettError
            As `Simulation.reset`, or if cuff and arm are too fast for the integration step; nothing changes then.
        """
        devices = np.arange(self.num_devices) if devices is None else devices
        before = self.read_wearers(devices)
        wearers = before if wearers is None else wearers
        if not (wearers["inertia"] > 0.0).all():
            raise AmulettError("a device has no wearer yet: its first reset needs wearers=")
        self._check_step(scenarios, wearers, devices)
        self._put_wearers(devices, wearers)
        try:
            super().reset(scenarios, devices, paths)
        except AmulettError:
            self._put_wearers(devices, before)
            raise

    def _check_step(self, scenarios: NDArray[np.void], wearers: NDArray[np.void], devices: NDArray[np.int64]) -> None:
        """Refuse arms and cuffs that oscillate too fast for the integration step, or are damped too much."""
        which = self.which[devices // LANES]
        fitting, strings = self.worn[0][which], self._stiffness[which]
        step = self.parameters["control_period"][which] / self.parameters["substeps"][which]
        inertias = scenarios["inertia"], wearers["inertia"]
        active = 2.0 * (wearers["tone"] + ACTIVE_SHARE * wearers["strength"])  # both muscles, fully
        cuff = wearers["worn"] * fitting["stiffness"], wearers["worn"] * fitting["damping"]
        swing = step * np.sqrt(_fastest(inertias, strings, cuff[0], STIFFNESS * active))
        slowing = step * _fastest(inertias, 0.0, cuff[1], PASSIVE_DAMPING + DAMPING * active)
        most = np.maximum(swing, slowing)
        worst = int(np.argmax(most))
        if most[worst] > STABLE_STEP:
            how = f"oscillates by {swing[worst]:.3g} rad" if swing[worst] == most[worst] else "is damped by "
            how += "" if swing[worst] == most[worst] else f"{slowing[worst]:.3g} time constants"
            least = int(np.ceil(self.parameters["substeps"][which[worst]] * most[worst] / STABLE_STEP))
            raise AmulettError(
                f"{self._who(devices[worst])}: with 'wearer.cuff.stiffness' {cuff[0][worst]:g} N m/rad, "
                f"'wearer.cuff.damping' {cuff[1][worst]:g} N m s/rad, and up to "
                f"{STIFFNESS * active[worst]:.3g} N m/rad of the muscles (tone and strength) on "
                f"{wearers['inertia'][worst]:.3g} kg m2, the worn arm {how} in an integration step of "
                f"{step[worst]:g} s; at most {STABLE_STEP} can be computed: loop.substeps has to be at least {least}"
            )
        self._check_cables(scenarios, fitting, strings, devices)

    def _check_cables(
        self, scenarios: NDArray[np.void], fitting: Any, strings: NDArray[np.float64], devices: NDArray[np.int64]
    ) -> None:
        """Refuse cables whose friction changes too fast for the integration step.

        What a cable leaves of a tension T is up to T exp(mu theta), and it changes by 2 T sinh(mu theta) where the
        motion turns. At the drive's side, this does not act on the joint.
        """
        which = self.which[devices // LANES]
        bends = np.stack([fitting["bend_biceps"], fitting["bend_triceps"]])
        tension, radius = self.parameters["max_force"][which], self.parameters["joint_radius"][which]
        turning = tension * np.square(radius) / fitting["presliding"] * 2.0 * np.sinh(bends)
        stiffness = (0.5 * strings * np.exp(bends) + turning).sum(axis=0)
        step = self.parameters["control_period"][which] / self.parameters["substeps"][which]
        friction = bends.any(axis=0) & (fitting["at_drive"] == 0)
        swing = np.where(friction, step * np.sqrt(stiffness / scenarios["inertia"]), 0.0)
        worst = int(np.argmax(swing))
        if swing[worst] > CABLE_STEP:
            least = int(np.ceil(self.parameters["substeps"][which[worst]] * swing[worst] / CABLE_STEP))
            raise AmulettError(
                f"{self._who(devices[worst])}: with the friction of 'wearer.cable' (mu theta "
                f"{bends[:, worst].max():.3g}) within a 'presliding' of "
                f"{fitting['presliding'][worst]:g} m the joint oscillates by {swing[worst]:.3g} rad in an "
                f"integration step of {step[worst]:g} s; at most {CABLE_STEP} can be computed: loop.substeps has to be "
                f"at least {least}"
            )

    def _who(self, device: int) -> str:
        return f"the device '{self.profile_of(device).name}', wearer {device}"

    def _settle(self, devices: NDArray[np.int64]) -> None:
        block, lane = np.divmod(devices, LANES)
        for words_of in words(self.worn[2], LANES):
            words_of[block, :, lane] = 0
        blocks = self.which, self.scenarios, self.states
        worn.settle_worn(self.parameters, *blocks, self.paths, self.loop, self.extended, self.worn, devices)

    def assist(self, assistance: ArrayLike) -> None:
        """Set each device's assistance in [0, 1], scalar or shape (num_devices,), until the next call.

        Raises
        ------
        AmulettError
            If it is out of its range.
        """
        if not ((np.asarray(assistance) >= 0.0) & (np.asarray(assistance) <= 1.0)).all():
            raise AmulettError(f"the assistance is {assistance!r}; allowed is [0, 1]")
        block, lane = np.divmod(np.arange(self.num_devices), LANES)
        self.worn[2]["assistance"][block, lane] = assistance
        self.worn[2]["assistance_step"][block, lane] = 0.0

    def advance(self, ticks: int) -> None:
        """Simulate a number of control ticks, of each device's own control period."""
        blocks = self.which, self.scenarios, self.states
        worn.advance(self.parameters, *blocks, self.paths, self.loop, self.extended, self.worn, self.num_devices, ticks)

    def live(self, device: int) -> dict[str, NDArray[Any]]:
        """Return views of the whole state of one device and its wearer; see `Simulation.live`."""
        block, lane = divmod(device, LANES)
        return super().live(device) | {name: self.worn[2][name][block, lane, ...] for name in WORN_NAMES}

    def read_worn(self, name: str) -> NDArray[Any]:
        """Return a copy of one quantity of the wearers (see `worn_layout.WORN_NAMES`), shape (num_devices,)."""
        return self.worn[2][name].flatten()[: self.num_devices]

    def read_wearers(self, devices: NDArray[np.int64]) -> NDArray[np.void]:
        """Return a copy of the given devices' wearers, `PERSON` records of shape (len(devices),)."""
        block, lane = np.divmod(devices, LANES)
        copies = np.zeros(block.size, dtype=PERSON)
        for copy, own in zip(words(copies, 1), words(self.worn[1], LANES), strict=True):
            copy[..., 0] = own[block, :, lane]
        return copies

    def _put_wearers(self, devices: NDArray[np.int64], wearers: NDArray[np.void]) -> None:
        block, lane = np.divmod(devices, LANES)
        for own, new in zip(words(self.worn[1], LANES), words(wearers, 1), strict=True):
            own[block, :, lane] = new[..., 0]

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of all data that an episode changes."""
        fittings, wearers, worn = (array.copy() for array in self.worn)
        return super().get_state() | {"fittings": fittings, "wearers": wearers, "worn": worn}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot of `get_state`; AmulettError if it is of another simulation or another fitting."""
        if "worn" not in state:
            raise AmulettError("the snapshot has no wearers; it is of a device that is not worn")
        own, others = self.worn[0], state["fittings"]
        if own.shape == others.shape and (own != others).any():
            differing = [name for name in FITTING.names or () if (own[name] != others[name]).any()]
            raise AmulettError(
                f"the snapshot's devices are worn otherwise: their group 'wearer' differs in {', '.join(differing)}"
            )
        super().set_state(state)
        self.worn[1][...] = state["wearers"]
        self.worn[2][...] = state["worn"]


def _fastest(inertias: tuple[Any, Any], device: Any, cuff: Any, arm: Any) -> NDArray[np.float64]:
    """Return the largest eigenvalue of two inertias [kg m2] with springs to the ground and one between them [N m/rad].

    That is the square of the fastest angular frequency; with dampers instead of springs, the fastest decay rate.
    """
    first, second = (device + cuff) / inertias[0], (cuff + arm) / inertias[1]
    product = (device * cuff + device * arm + cuff * arm) / (inertias[0] * inertias[1])
    half = 0.5 * (first + second)
    return np.asarray(half + np.sqrt(np.maximum(half * half - product, 0.0)))
