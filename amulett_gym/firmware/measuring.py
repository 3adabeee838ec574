"""What a firmware needs on the ATmega2560: memory and cycles, by a simulated chip that gets a recording's readings."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.chip import Measurement
from amulett_gym.firmware.host import Controller
from amulett_gym.firmware.loops import FirmwareLoop, Sample, open_loop
from amulett_gym.firmware.readme import compare
from amulett_gym.firmware.recording import Recording
from amulett_gym.firmware.toolchain import FLASH, FREQUENCY, RAM


@dataclass(frozen=True)
class OnChip:
    """A firmware on the simulated chip.

    Attributes
    ----------
    measurement : Measurement
    apart : dict
        The largest differences from the recording, as `readme.compare` returns them.
    """

    measurement: Measurement
    apart: dict[str, float]


class Remote:
    """A running firmware with the methods of a `Controller`; `layout` has the records of the same folder.

    Only the calls are a controller's: its numbers are those of where the firmware runs.
    """

    def __init__(self, loop: FirmwareLoop, layout: Controller) -> None:
        self._loop, self._layout, self.begin_type = loop, layout, layout.begin_type

    def inputs(self, readings: dict[str, NDArray[Any]]) -> NDArray[np.void]:
        """Return records of `controller_input`."""
        return self._layout.inputs(readings)

    def start(self, begin: NDArray[np.void]) -> None:
        """Begin an episode."""
        self._loop.start({name: begin[name] for name in begin.dtype.names or ()})

    def run(self, inputs: NDArray[np.void]) -> NDArray[np.void]:
        """Do a control tick for each input; return records of `controller_output`."""
        rows = []
        for encoder, (biceps, triceps), setpoint, jump, flags in inputs.tolist():
            report = self._loop.tick(Sample(encoder, biceps, triceps, setpoint, jump, flags))
            rows.append((report.commands, report.tension_setpoint, report.agonist, report.status))
        return np.array(rows, dtype=self._layout.output_type)


def measure(folder: Path, recording: Recording) -> OnChip:
    """Play a recording's readings to a firmware on the simulated chip.

    Raises
    ------
    AmulettError
        If a tool is missing (`errors.ToolMissing`), a compiler refuses, or it does not fit the ATmega2560.
    """
    with closing(Controller(folder, "float")) as layout, closing(open_loop(folder, "chip")) as loop:
        apart = compare(Remote(loop, layout), recording)
        found = loop.measure()
    assert found is not None
    return OnChip(found, apart)


def check_fits(found: Measurement, period: float) -> None:
    """Refuse what does not fit an ATmega2560; `period` is the control period [s]."""
    for what, value, most in (
        ("its longest control tick takes {} cycles; the control period has {}", found.most, FREQUENCY * period),
        ("it needs {} bytes of flash; there are {}", found.flash, FLASH),
        ("it needs {} bytes of memory with the stack; there are {}", found.memory, RAM),
    ):
        if value > most:
            raise AmulettError(f"the firmware does not fit the ATmega2560: {what.format(value, round(most))}")
