"""What commands print: 80 columns for people, one JSON document for programs. ``.ci/wheel`` tries the long ones."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from amulett_gym.cli import COMMANDS, build_parser, main
from amulett_gym.cli.output import print_json
from amulett_gym.evaluation import conformance

WORDS = (
    "list",
    "config validate mine.yaml",
    "check Amulett/Tension-v0 --profile testbed --suite steps",
    "simulate --law eq6 --duration 0.2",
    "simulate --law eq6 constant:5 eq6-held-printed --duration 0.2",
    "play eq6 --steps 2 --video arm.gif",
    "evaluate --policies eq6-held-printed pretrained:tension --episodes 2",
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "mine.yaml").write_text("{name: mine, base: testbed, sensors: {encoder_bits: 12}}")

    def kept(subject: conformance.Subject) -> None:
        pass

    def broken(subject: conformance.Subject) -> None:
        raise AssertionError("a remark that goes on and on, " * 5)

    monkeypatch.setattr(conformance, "CHECKS", {"a requirement that is met": kept, "one that is broken": broken})
    return tmp_path


@pytest.mark.parametrize("words", WORDS)
def test_lines_fit_80_columns(words, folder, capsys):
    main(words.split())
    lines = capsys.readouterr().out.splitlines()
    assert lines and max(map(len, lines)) <= 80


@pytest.mark.parametrize("words", WORDS)
def test_json_prints_one_document_and_nothing_else(words, folder, capsys):
    main([*words.split(), "--json"])
    assert json.loads(capsys.readouterr().out)


def test_every_command_is_tried_from_the_wheel():
    script = (Path(__file__).parents[2] / ".ci" / "wheel").read_text()
    lines = script.split('COMMANDS = """')[1].split('"""')[0].splitlines()
    tried = {line.split()[0] for line in lines if line}
    assert tried == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_json_has_one_meaning_in_every_command(command):
    (choices,) = (action.choices for action in build_parser()._actions if action.dest == "command")
    option = choices[command]._option_string_actions["--json"]
    assert option.const is True and option.default is False
    assert option.nargs == ("?" if command == "bench" else 0)  # bench: a file is deprecated
    assert "and nothing else" in option.help


def test_numbers_that_are_not_finite_are_null(capsys):
    print_json({"a": [1.5, math.nan], "b": {"c": -math.inf}, "d": (2, None)})
    assert json.loads(capsys.readouterr().out) == {"a": [1.5, None], "b": {"c": None}, "d": [2, None]}
