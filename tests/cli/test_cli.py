"""The console script: help is quick and complete, wrong words get a suggestion, errors are one line."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module

import pytest

from amulett_gym import ENV_IDS, WORN_ID
from amulett_gym.cli import COMMANDS, main
from amulett_gym.profile import device_names
from amulett_gym.simulation.layout import CONTROLS
from amulett_gym.studies.speed.rates import contestants, race
from amulett_gym.tasks.suites import suite_names
from amulett_gym.tasks.worn_suites import WORN_SUITES


def _module(command):
    return import_module(f"amulett_gym.cli.{command.replace('-', '_')}")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_with_examples_in_80_columns(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as exit:
        main([command, "--help"])
    output = capsys.readouterr().out
    assert exit.value.code == 0
    assert f"examples:\n  amulett {command}" in output
    assert max(map(len, output.splitlines())) <= 80
    examples = output.partition("examples:")[2].replace("\\\n", "")
    assert " ".join(examples.split()) == " ".join(_module(command).EXAMPLES.split())


def test_help_imports_nothing_heavy():
    script = (
        "import sys; from amulett_gym.cli import build_parser; build_parser();"
        "print([m for m in ('numba', 'scipy', 'torch', 'matplotlib', 'pygame', 'pydantic') if m in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "[]"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evalute"], "did you mean 'evaluate'"),
        (["list", "--jsn"], "did you mean '--json'"),
        (["evaluate", "--policies", "eq6", "--episode=3"], "did you mean '--episodes'"),
        (["play"], "required"),
        (["evaluate", "--polices", "eq6"], "unrecognized: --polices; did you mean '--policies'?"),
    ],
)
def test_wrong_words_get_a_suggestion(words, message, capsys):
    with pytest.raises(SystemExit) as exit:
        main(words)
    assert exit.value.code == 2
    assert message in capsys.readouterr().err


def test_another_option_is_no_suggestion(capsys):
    with pytest.raises(SystemExit):
        main(["play", "--law", "eq6"])
    assert capsys.readouterr().err.endswith("unrecognized arguments: --law\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["check", "Amulett/Scalling-v0"], "unknown environment 'Amulett/Scalling-v0'.*'Amulett/Scaling-v0'"),
        (["check", "--suite", "stepz"], "did you mean 'steps'"),
        (["bench", "--devices", "0"], "--devices is 0; it has to be at least 1"),
        (["evaluate", "--policies", "eq66"], "did you mean 'eq6'"),
        (["simulate", "--law", "eq6", "--suite", "paperstep"], "did you mean 'paper-step'"),
        (["train", "--config", "none.yaml", "--out", "x"], "cannot read"),
        (["bench", "--seed", "-1"], "--seed is -1"),
        (["quickstart", "--episodes", "0"], "episodes is 0"),
        (["quickstart", "--seconds", "nan"], "--seconds is nan"),
        (["quickstart", "--seed", "-1"], "--seed is -1"),
        (["train", "--set", "ppo.gama=0.9", "--out", "x"], "did you mean 'gamma'"),
        (["train", "--set", "env.id=Amulett/Worn-v0", "env.suite=steps", "--out", "x"], "unknown suite 'steps'"),
        (["evaluate", "--policies", "eq6", "--env-id", "Amulett/Worn-v0"], "cannot be done in Amulett/Worn-v0"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(words, message, capsys, tmp_path, monkeypatch):
    import re

    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("amulett: error: ")
    assert "\n" not in error
    assert re.search(message, error)
    assert list(tmp_path.iterdir()) == []


def test_quickstart_keeps_what_another_command_wrote(tmp_path, capsys):
    for name in ("results.json", "scenarios.csv"):
        (tmp_path / name).write_text("somebody's")
    assert main(["quickstart", "--out", str(tmp_path)]) == 2
    assert "holds no quickstart" in capsys.readouterr().err
    assert (tmp_path / "results.json").read_text() == "somebody's"


@pytest.mark.parametrize("words", ["--help", "list", "evaluate --help"])
def test_a_reader_that_has_seen_enough_gets_no_complaint(words):
    command = subprocess.Popen(
        [sys.executable, "-m", "amulett_gym", *words.split()], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    command.stdout.close()  # before anything is written
    assert command.stderr.read() == ""
    assert command.wait() in (141, 0 if "--help" in words else 141)  # argparse takes no notice of a closed pipe


def test_an_interrupted_command_says_so_in_one_line(monkeypatch, capsys):
    def interrupted(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("amulett_gym.cli.list.run", interrupted)
    assert main(["list"]) == 130
    assert capsys.readouterr().err == "amulett: interrupted\n"


def test_no_command_prints_the_help(capsys):
    assert main([]) == 2
    assert "quickstart" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("amulett-gym 0.")


def test_list_names_everything(capsys):
    assert main(["list", "--json"]) == 0
    names = json.loads(capsys.readouterr().out)
    worn = "suites of Amulett/Worn-v0"
    assert set(names) == {"environments", "control loops", "suites", worn, "splits", "laws", "profiles"}
    assert list(names["environments"]) == list(ENV_IDS)
    assert "assembly" in names[worn] and "assembly" not in names["suites"]
    assert list(names["control loops"]) == list(CONTROLS)
    assert "steps" in names["suites"]
    assert "eq6" in names["laws"]
    assert main(["list"]) == 0


def test_check_passes_and_says_so(capsys):
    assert main(["check", "Amulett/Tension-v0", "--profile", "testbed"]) == 0
    assert "\n  failed" not in capsys.readouterr().out


def test_check_takes_each_environment_with_its_own_suites(capsys, monkeypatch):
    from amulett_gym.evaluation import conformance

    monkeypatch.setattr(conformance, "CHECKS", {"nothing": lambda subject: None})
    assert main(["check", "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["checks"]
    worn = [(check["profile"], check["suite"]) for check in checks if check["env_id"] == WORN_ID]
    assert worn == [("worn", suite) for suite in WORN_SUITES]
    assert len(checks) == len(worn) + 3 * len(device_names()) * len(suite_names())
    assert main(["check", "--suite", "assembly", "--profile", "testbed", "--json"]) == 0
    [only] = json.loads(capsys.readouterr().out)["checks"]
    assert (only["env_id"], only["profile"]) == (WORN_ID, "testbed")
    assert main(["check", WORN_ID, "--suite", "steps"]) == 2
    assert "unknown suite 'steps'" in capsys.readouterr().err


def test_check_fails_with_exit_code_1(capsys, monkeypatch):
    from amulett_gym.evaluation import conformance

    def broken(subject: conformance.Subject) -> None:
        raise AssertionError("on purpose")

    monkeypatch.setattr(conformance, "CHECKS", {"a requirement": broken})
    assert main(["check", "Amulett/Tension-v0", "--profile", "testbed", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["checks"][0]["remark"] == "AssertionError: on purpose"


def test_race_counts_agent_steps_and_ticks():
    entrants = contestants(devices=4)
    speeds = race(entrants, turns=1, seconds=0.01)
    assert [speed.name for speed in speeds] == [entrant.name for entrant in entrants]
    for entrant, speed in zip(entrants, speeds, strict=True):
        numbers = speed.numbers()
        assert 0 < numbers["slowest"] <= numbers["steps_per_s"] <= numbers["fastest"]
        assert speed.ticks_per_second == pytest.approx(speed.steps_per_second * entrant.ticks)
