"""Measure whether the firmware keeps real time in a browser: ``python tests/live/avr.py [TICKS]``.

The hex file of ``amulett export eq6`` plays the paper's step in simavr, as with ``amulett hil --transport chip``. What
the host has sent then goes to the hex file of `amulett live` on avr8js, which simulates the processor in JavaScript, in
node and in Chromium. Printed are the control ticks whose answers are the same, and how many there are in a second. It
needs what `docs/firmware.md` installs for the simulated chip.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from live.browser import chromium, has_browser

from amulett_gym.cli import main as amulett
from amulett_gym.firmware.chip import Chip
from amulett_gym.firmware.env import HardwareEnv
from amulett_gym.firmware.protocol import Decoder
from amulett_gym.live.core import script
from amulett_gym.live.core.hex import DEVICE, LAW, read_hex

SCRIPT = Path(__file__).with_name("avr.js")
PERIOD, STEP = 0.0025, 8  # of the testbed's control [s], and of an agent [control ticks]
SAMPLE = 0x83  # kind of the answer to a control tick
CYCLES = 2  # bytes at the end of a report: the tick's cycles, by a timer


Exchanges = list[tuple[list[int], list[int]]]
"""Bytes to the chip, and its answers."""


def recorded(firmware: Path, ticks: int) -> Exchanges:
    """Play the paper's step in simavr."""
    exchanges: Exchanges = []
    send, receive = Chip.send, Chip.receive

    def note_sent(chip: Chip, data: bytes) -> None:
        exchanges.append(([*data], []))
        send(chip, data)

    def note_received(chip: Chip) -> bytes:
        data = receive(chip)
        exchanges[-1][1].extend(data)
        return data

    Chip.send, Chip.receive = note_sent, note_received  # type: ignore[method-assign]
    try:
        with contextlib.closing(HardwareEnv(firmware, "chip", suite="paper-step")) as env:
            env.reset(seed=0)
            for _ in range(math.ceil(ticks / STEP)):
                env.step([0.0])
    finally:
        Chip.send, Chip.receive = send, receive  # type: ignore[method-assign]
    return exchanges


def reports(data: list[int]) -> list[tuple[int, bytes]]:
    """Return number and report of each control tick in answered bytes, without the cycles that were counted."""
    found = Decoder().feed(bytes(data))
    return [(frame.sequence, frame.content[:-CYCLES]) for frame in found if frame.kind == SAMPLE]


def same(exchanges: Exchanges, answers: list[list[int]]) -> list[bool]:
    """Return for each control tick whether both chips answered the same."""
    pairs = ((reports(theirs), reports(ours)) for (_, theirs), ours in zip(exchanges, answers, strict=True))
    return [theirs == ours for theirs, ours in pairs if theirs]


def job_of(folder: Path, ticks: int) -> dict[str, Any]:
    """Return what `avr.js` plays: the package's hex file, and what was said in simavr to the one of its sources."""
    firmware = folder / "firmware"
    with contextlib.redirect_stdout(io.StringIO()):
        if amulett(["export", LAW, "--profile", DEVICE, "--out", str(firmware)]) != 0:
            raise SystemExit(2)
    return {"hex": read_hex(), "exchanges": recorded(firmware, ticks)}


def texts() -> str:
    """Return the scripts that play a job."""
    return f"{script()}\n{SCRIPT.read_text(encoding='utf-8')}"


def in_node(job: dict[str, Any]) -> dict[str, Any]:
    """Play a job in node."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "avr.js"
        path.write_text(texts(), encoding="utf-8")
        result = subprocess.run(["node", str(path)], input=json.dumps(job), capture_output=True, text=True, check=True)
    return dict(json.loads(result.stdout))


def in_chromium(job: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Play a job in Chromium."""
    page = folder / "avr.html"
    page.write_text(
        f"<!doctype html><title>avr</title><meta charset=utf-8><script>{texts()}</script>", encoding="utf-8"
    )
    with chromium() as driver:
        driver.get(page.as_uri())
        return dict(driver.execute_script("return play(arguments[0])", job))


def main(ticks: int) -> None:
    """Print what was measured."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = job_of(folder, ticks)
        places = {"node": in_node(job)} | ({"Chromium": in_chromium(job, folder)} if has_browser() else {})
    for place, found in places.items():
        equal = same(job["exchanges"], found["answers"])
        rate = len(equal) / found["seconds"]
        print(
            f"{place}: {sum(equal)} of {len(equal)} control ticks have the answers of simavr; {rate:.0f} ticks/s, "
            f"{rate * PERIOD:.1f} times real time, {found['cycles'] / len(equal):.0f} cycles for a tick"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
