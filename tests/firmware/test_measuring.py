"""What a firmware needs, measured on the simulated chip and written into its README."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from firmware.boards import hex_or_skip

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError, ToolMissing
from amulett_gym.firmware import export as export_module
from amulett_gym.firmware.chip import Measurement
from amulett_gym.firmware.export import export
from amulett_gym.firmware.measuring import check_fits
from amulett_gym.firmware.readme import MEASURED, needs
from amulett_gym.firmware.toolchain import INSTALL

FOUND = Measurement(cycles=1, ticks=50, last=1, most=31_000, mean=9_000.0, flash=20_000, static=800, stack=400)


def measured(readme: Path) -> str:
    """Return the part of a README that was measured."""
    first, last = map(re.escape, MEASURED)
    return re.search(f"{first}(.*){last}", readme.read_text(), re.DOTALL)[1].strip()


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    hex_or_skip(tmp_path)
    export("eq6", "testbed", None, tmp_path / "fw")
    return tmp_path / "fw"


def test_an_export_says_what_it_needs_and_a_run_writes_it_anew(exported: Path, capsys: pytest.CaptureFixture[str]):
    before = (exported / "README.md").read_text()
    text = measured(exported / "README.md")
    cycles = int(re.search(r"longest control tick \| ([\d,]+) cycles", text)[1].replace(",", ""))
    assert 8000 < cycles < 32_000
    for what in ("flash", "memory, static", "most of the stack", "memory in all"):
        assert re.search(rf"{what} \| [\d,]{{3,}}", text)
    assert "8 simulated episodes of `mixed`, 400 control ticks each" in text
    assert "3,200 control ticks were measured" in text
    row = re.search(r"\| float, simulated ATmega2560 \| (\S+) \| (\S+) \|", before)
    assert 0.0 < float(row[1]) < 1e-4
    words = ["hil", str(exported), "--suite", "steps", "--episodes", "1", "--duration", "1", "--readme"]
    assert main([*words, "--transport", "chip"]) == 0
    assert "README.md" in capsys.readouterr().out
    text = measured(exported / "README.md")
    assert "in 1 scenarios of `steps`, held-out, 1 s each" in text
    assert "400 control ticks were measured" in text
    after = (exported / "README.md").read_text()
    assert [part.partition(MEASURED[0])[0] for part in (after, before)] == [before.partition(MEASURED[0])[0]] * 2
    assert after.partition(MEASURED[1])[2] == before.partition(MEASURED[1])[2]
    assert main(words) == 2
    assert "add chip to --transport" in capsys.readouterr().err
    (exported / "README.md").write_text("mine")
    assert main([*words, "--transport", "chip"]) == 2
    assert "README.md' has to hold the line" in capsys.readouterr().err


def test_without_the_tools_the_readme_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if find_compiler() is None:
        pytest.skip(NO_COMPILER)

    def missing(*arguments: object) -> None:
        raise ToolMissing(f"there is no avr-gcc; install it: {INSTALL}\nand more")

    monkeypatch.setattr(export_module, "measure", missing)
    export("eq6", "testbed", None, tmp_path / "fw")
    text = measured(tmp_path / "fw" / "README.md")
    assert text.startswith(f"Not measured: there is no avr-gcc; install it: {INSTALL}. Then `amulett hil FOLDER")
    assert "simulated ATmega2560 |" not in (tmp_path / "fw" / "README.md").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"most": 40_001}, "longest control tick takes 40001 cycles; the control period has 40000"),
        ({"flash": 300_000}, "300000 bytes of flash; there are 253952"),
        ({"stack": 8000}, "8800 bytes of memory with the stack; there are 8192"),
    ],
)
def test_what_does_not_fit_is_refused_with_numbers(change: dict[str, int], message: str):
    check_fits(FOUND, 0.0025)
    with pytest.raises(AmulettError, match=f"does not fit the ATmega2560: .*{message}"):
        check_fits(replace(FOUND, **change), 0.0025)


def test_too_little_to_spare_is_said():
    assert "less than 20 %" not in needs(FOUND, 0.0025, "somehow")
    assert "That leaves less than 20 % to the board." in needs(replace(FOUND, most=33_000), 0.0025, "somehow")
