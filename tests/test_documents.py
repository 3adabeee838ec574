"""Figures in the documentation are what the commands next to them give."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from helpers import blank_figures

from amulett_gym.cli import main

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
def test_the_costs_in_learning_are_those_of_the_command_below_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    blank_figures(monkeypatch)
    page = (DOCS / "learning.md").read_text()
    (command,) = [line for line in page.splitlines() if line.startswith("amulett evaluate ")]
    assert main([*shlex.split(command)[1:-1], str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out" / "results.json").read_text())["policies"]
    table = dict(re.findall(r"^\| `([^`]+)`.*\| ([\d.]+) \|$", page, flags=re.MULTILINE))
    assert {name: f"{entry['cost']['mean']:.3f}" for name, entry in found.items()} == table
