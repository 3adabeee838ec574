"""Compilers of an exported folder: for the host, and for the ATmega2560 and its simulation."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.errors import AmulettError, ToolMissing
from amulett_gym.firmware.host import FLAGS, Real

BOARD_FILES = (
    *("protocol.h", "protocol.c", "board.h", "board.c", "mega.h", "mega.c"),
    *("simulated_board.c", "firmware.ino"),
)
"""Files of `amulett_gym/c` that every exported folder has, unchanged: what the board does besides the control."""

INSTALL = "apt-get install -y gcc-avr avr-libc simavr libsimavr-dev libelf-dev"
"""The command that installs on Debian what the simulated chip needs."""


FREQUENCY = 16_000_000
"""CPU frequency of the Arduino Mega 2560 [Hz]."""

BAUD_RATE = 500_000
FLASH, RAM = 253_952, 8192
"""Memory of the ATmega2560 for a program beside the boot loader [bytes]."""

HOST_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra")
AVR_FLAGS = (  # those of c/firmware.mk
    *("-std=gnu99", "-O2", "-mmcu=atmega2560", f"-DF_CPU={FREQUENCY}UL"),
    *("-ffunction-sections", "-fdata-sections"),
)
_C = Path(__file__).parents[1] / "c"


SOURCES = ("controller.c", "law.c", "protocol.c", "board.c")
"""C files of a folder that run on the chip and on the host; beside these, `mega.c` and `simulated_board.c`."""


def check_avr_compiler() -> None:
    """Raise a ToolMissing if there is no compiler for the ATmega2560."""
    if shutil.which("avr-gcc") is None or shutil.which("avr-objcopy") is None:
        raise ToolMissing(f"there is no avr-gcc, which compiles for the ATmega2560; install it: {INSTALL}")


def build_hex(folder: Path, out: Path) -> Path:
    """Compile an exported folder for the ATmega2560; return the path of ``firmware.hex`` in the folder `out`.

    Raises
    ------
    AmulettError
        If the compiler is missing, or refuses.
    """
    check_avr_compiler()
    out.mkdir(parents=True, exist_ok=True)
    elf, hex_file = out / "firmware.elf", out / "firmware.hex"
    _run(["avr-gcc", *AVR_FLAGS, "-Wl,--gc-sections", *_sources(folder, "mega.c"), "-o", str(elf), "-lm"], folder)
    _run(["avr-objcopy", "-O", "ihex", "-R", ".eeprom", str(elf), str(hex_file)], folder)
    return hex_file


def build_board(folder: Path, out: Path, real: Real = "float") -> Path:
    """Compile an exported folder as a program with the board's protocol on its standard input and output.

    Parameters
    ----------
    folder, out : Path
    real : {"float", "double"}

    Raises
    ------
    AmulettError
        If the compiler is missing, or refuses.
    """
    compiler = find_compiler()
    if compiler is None:
        raise ToolMissing(NO_COMPILER)
    out.mkdir(parents=True, exist_ok=True)
    program = out / "board"
    _run(
        [compiler, *HOST_FLAGS, *FLAGS[real], *_sources(folder, "simulated_board.c"), "-o", str(program), "-lm"], folder
    )
    return program


def build_chip(out: Path) -> Path:
    """Compile the simulated ATmega2560 as a library.

    Raises
    ------
    AmulettError
        If there is no compiler, or simavr is missing.
    """
    compiler = find_compiler()
    if compiler is None:
        raise ToolMissing(NO_COMPILER)
    out.mkdir(parents=True, exist_ok=True)
    library, source = out / "simulated_chip.so", _C / "simulated_chip.c"
    command = [compiler, "-std=gnu11", "-O2", "-fPIC", "-shared", str(source), "-o", str(library)]
    try:
        _run([*command, "-lsimavr", "-lelf"], _C)
    except AmulettError as error:
        missing = f"simavr, which simulates the ATmega2560, is missing; install it: {INSTALL}"
        raise ToolMissing(f"{missing}\n{error}") from None
    return library


def _sources(folder: Path, hardware: str) -> list[str]:
    missing = [name for name in (*SOURCES, hardware) if not (folder / name).is_file()]
    if missing:
        raise AmulettError(
            f"'{folder}' is no exported firmware: it has no {missing[0]}; make one with 'amulett export'"
        )
    return [str(folder / name) for name in (*SOURCES, hardware)]


def _run(command: Sequence[str], folder: Path) -> None:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise AmulettError(f"{command[0]} cannot build '{folder}':\n{result.stderr[-2000:]}")
