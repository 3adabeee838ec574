"""The environment whose control loop is a firmware's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.envs import transition
from amulett_gym.envs.action import ALL_NUMBERS, first_nan
from amulett_gym.envs.episodes import Episodes, Observations
from amulett_gym.envs.settings import Settings
from amulett_gym.envs.single import TensionEnv
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.description import KEYS, read_description
from amulett_gym.firmware.host import LATE, MOVE_BEGINS
from amulett_gym.firmware.lock_step import ALWAYS, close_step, command_device, misses_tick, open_step, set_stiffness
from amulett_gym.firmware.loops import FirmwareLoop, Sample, open_loop
from amulett_gym.firmware.protocol import Report
from amulett_gym.firmware.recording import Reader, begin_of
from amulett_gym.simulation.layout import MOTION_BLOCK, RUNNING

_DEVICE = np.zeros(1, dtype=np.int64)
_TOLD = ("status", "mode", "reason", "cycles")


class FirmwareEpisodes(Episodes):
    """Episodes of one device whose control ticks are a firmware's.

    Parameters
    ----------
    settings : Settings
    folder, transport
        As of `loops.open_loop`, which raises the same errors.

    Attributes
    ----------
    loop : FirmwareLoop
    report_of_board : Report or None
        Of the last control tick.
    """

    def __init__(self, settings: Settings, folder: Path, transport: str) -> None:
        super().__init__(1, settings)
        self.loop: FirmwareLoop = open_loop(folder, transport)
        self.report_of_board: Report | None = None
        parameters = self.simulation.parameters[0]
        # A count's reciprocal is not exact; the reading over the resolution is rounded, as the sensor rounded it.
        self._resolutions = float(parameters["encoder_resolution"]), float(parameters["slider_resolution"])
        self._motion = np.zeros(1, dtype=MOTION_BLOCK)
        self._reader: Reader | None = None

    def start(self, *arguments: Any, **keywords: Any) -> Observations:
        """Start an episode, here and in the firmware."""
        observations = super().start(*arguments, **keywords)
        if self._reader is None:
            self._compile()
        self.loop.start({name: value[0] for name, value in begin_of(self.simulation).items()})
        self._reader, self.report_of_board = Reader(self.simulation), None
        return observations

    def _take(self, *given: Any) -> int:
        """Take one agent step; the firmware chooses the tension, whatever the action."""
        others, actions, observations, report = given
        if (wrong := first_nan(others, actions)) >= 0:
            return int(wrong)
        parameters, constants, _, scenarios, states = self._arrays
        loop = self.simulation.loop
        open_step(constants, states, report)
        for _ in range(int(constants["ticks"][0])):
            if states["failure"][0, 0] != RUNNING:
                break
            self.tick()
        if loop is not None and self.by_stiffness:
            set_stiffness(parameters, loop[0], states)
        transition.observe_devices(*self._arrays, _DEVICE, observations)
        close_step(parameters, constants, scenarios, states, report)
        return ALL_NUMBERS

    def _compile(self) -> None:
        """Take a step without the firmware, so that nothing is compiled in an episode: a real board would time out."""
        state, loop, self.loop = self.get_state(), self.loop, _Resting()
        try:
            misses_tick(self.simulation.scenarios, self.simulation.states, 0)
            self._reader = Reader(self.simulation)
            self.step(np.zeros(1))
        finally:
            self.loop = loop
            self.set_state(state)

    def tick(self) -> Report:
        """Let the firmware do one control tick, then the drives, the arm and the sensors."""
        simulation = self.simulation
        assert self._reader is not None
        read = {name: value[0].item() for name, value in self._reader.read().items()}
        encoder, sliders = self._resolutions
        flags = MOVE_BEGINS * read["begins"] + LATE * read["late"]
        readings = _count(read["angle"], encoder), _count(read["biceps"], sliders), _count(read["triceps"], sliders)
        report = self.report_of_board = self.loop.tick(Sample(*readings, read["setpoint"], read["jump"], flags))
        scenarios, states = simulation.scenarios, simulation.states
        if not read["late"]:
            commands = np.array(report.commands)
            paper, values = simulation.loop is None, (commands, report.tension_setpoint, float(report.agonist))
            command_device(simulation.parameters, scenarios, states, self._motion, paper, *values)
        own = scenarios["late_probability"][0, 0]
        scenarios["late_probability"][0, 0] = ALWAYS
        try:
            simulation.advance(1)
        finally:
            scenarios["late_probability"][0, 0] = own
        return report


class _Resting:
    """A firmware that commands nothing."""

    label, retries = "nowhere", 0

    def start(self, begin: dict[str, Any]) -> None:
        """Do nothing."""

    def tick(self, sample: Sample) -> Report:
        """Return commands of 0."""
        return Report((0.0, 0.0), 0.0, 1, 0)

    def measure(self) -> None:
        """Return None."""

    def close(self) -> None:
        """Do nothing."""


class HardwareEnv(TensionEnv):
    """The environment of `Amulett/Tension-v0` with a firmware's loop and law instead of the simulation's.

    Each control tick, the firmware gets the simulated sensors' readings and answers with the drives' commands, in lock
    step: on this computer, on a simulated ATmega2560, or on a real board. Observations, rewards and ``info`` are those
    of `Amulett/Tension-v0`, and ``info`` also has the firmware's state: ``board_status`` (bits of ``controller.h``),
    ``board_mode`` and ``board_reason`` (indices into `protocol.MODES` and `protocol.REASONS`), and ``board_cycles``.
    The firmware's own law chooses the tension: actions change nothing.

    Parameters
    ----------
    folder : str or Path
        As `firmware.export.export` writes it.
    transport : str
        ``"host"``, ``"host-float"``, ``"chip"`` or ``"serial:PORT"``.
    **keywords
        Those of `Amulett/Tension-v0`, but for the ones that the firmware fixes (`description.KEYS`) and `fleet`.

    Raises
    ------
    AmulettError
        If a keyword is wrong, the folder is no firmware, a compiler is missing, or no board with this firmware answers.
        In an episode: if the board is gone or silent (:class:`protocol.BoardError`).
    """

    __signature__: Any = None  # that of __init__
    episodes: FirmwareEpisodes

    def __init__(self, folder: str | Path, transport: str = "host", **keywords: Any) -> None:
        found = read_description(folder)
        for key in keywords:
            if key in (*KEYS, "fleet"):
                raise AmulettError(
                    f"'{key}' is that of the firmware in '{folder}'; export another firmware to change it"
                )
        if keywords.get("privileged"):
            raise AmulettError("privileged observations hold the loop's integrals, which a firmware does not report")
        self.law, self._place = found.law, (found.folder, transport)
        super().__init__(**found.keywords, **keywords)

    @property
    def loop(self) -> FirmwareLoop:
        """The running firmware."""
        return self.episodes.loop

    def _make_episodes(self, settings: Settings) -> FirmwareEpisodes:
        return FirmwareEpisodes(settings, *self._place)

    def close(self) -> None:
        """End the firmware, and close the window if one is open."""
        self.loop.close()
        super().close()

    def _repr_png_(self) -> bytes | None:
        """Return a picture of the present state, for notebooks; None before the first reset."""
        return super()._repr_png_() if self.episodes.started[0] else None

    def get_state(self) -> dict[str, Any]:
        """Raise an AmulettError: a firmware's memory is not known."""
        raise AmulettError("a firmware's memory is not known, so that an episode cannot be continued from a snapshot")

    def set_state(self, state: dict[str, Any]) -> None:
        """Raise an AmulettError: a firmware's memory is not known."""
        self.get_state()

    def _info(self, values: list[float]) -> dict[str, Any]:
        board = self.episodes.report_of_board or Report((0.0, 0.0), 0.0, 1, 0)  # at a reset there was no tick yet
        return super()._info(values) | {f"board_{name}": getattr(board, name) for name in _TOLD}


def _count(value: float, resolution: float) -> float:
    return round(value / resolution) if resolution > 0.0 else value
