"""The compilers' flags and messages."""

from __future__ import annotations

from pathlib import Path

import pytest
from firmware.boards import stub_folder

import amulett_gym
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import toolchain
from amulett_gym.firmware.toolchain import AVR_FLAGS, INSTALL, build_board, build_chip, build_hex


def test_the_makefile_compiles_with_the_same_flags():
    makefile = (Path(amulett_gym.__file__).parent / "c" / "firmware.mk").read_text()
    assert f"AVR_FLAGS = {' '.join(AVR_FLAGS)}\n" in makefile


def test_ci_installs_the_packages_that_the_message_names():
    script = (Path(__file__).parents[2] / ".ci" / "run").read_text()
    assert f'packages="{INSTALL.removeprefix("apt-get install -y ")} ' in script


def test_without_the_compiler_the_message_names_the_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(AmulettError, match="no avr-gcc, .*; install it: apt-get install -y gcc-avr avr-libc simavr"):
        build_hex(stub_folder(tmp_path), tmp_path / "build")
    with pytest.raises(AmulettError, match="no C compiler"):
        build_board(tmp_path, tmp_path / "build")


def test_without_simavr_the_message_names_the_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(toolchain, "_C", tmp_path)
    (tmp_path / "simulated_chip.c").write_text("#include <simavr/there_is_none.h>\n")
    if toolchain.find_compiler() is None:
        pytest.skip("no C compiler")
    with pytest.raises(AmulettError, match="simavr, .*, is missing; install it: apt-get install -y gcc-avr"):
        build_chip(tmp_path)


def test_a_folder_that_is_no_firmware_is_refused(tmp_path: Path):
    with pytest.raises(
        AmulettError, match="is no exported firmware: it has no controller.c; make one with 'amulett export'"
    ):
        build_board(tmp_path, tmp_path / "build")
