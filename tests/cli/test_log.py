"""`amulett log check`: what a file was taken for, in words, as JSON, and as a log in the units of the format."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from amulett_gym.cli import main
from amulett_gym.logs import read_log

PAGE = (Path(__file__).parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Write the page's log of another logger, and its mapping, to the present folder."""
    (log,) = re.findall(r"```text\n(Logger.*?)```", PAGE, flags=re.DOTALL)
    (mapping,) = re.findall(r"```yaml\n(# mine.yaml.*?)```", PAGE, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_bytes(log.replace("\n", "\r\n").encode("cp1252"))
    Path("mine.yaml").write_text(mapping, encoding="utf-8")


def test_the_pages_example_is_read_as_the_page_says(example, capsys):
    assert main(["log", "check", "mine.csv", "--mapping", "mine.yaml"]) == 0
    (printed,) = re.findall(r"```text\n(mine.csv: .*?)```", PAGE, flags=re.DOTALL)
    assert capsys.readouterr().out == printed


def test_what_was_read_can_be_written(example, capsys):
    assert main(["log", "check", "mine.csv", "--mapping", "mine.yaml", "--out", "out.csv", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["columns"]["angle"]["unit"] == "deg" and found["notes"]
    log, again = read_log("mine.csv", "mine.yaml"), read_log("out.csv")
    assert list(again.columns) == list(log.columns) == list(found["columns"])
    for name in log.columns:
        np.testing.assert_allclose(again[name], log[name], rtol=1e-11)


def test_the_shipped_log_is_found_by_its_name(capsys):
    assert main(["log", "check", "configs/logs/steps.csv"]) == 0
    output = capsys.readouterr().out
    assert "a log of 2000 rows" in output and "time: 2000 rows in 4.9975 s, 400 per second" in output


def test_a_curve_is_checked_too(tmp_path, capsys):
    (tmp_path / "curve.csv").write_text("deflection [mm],force [N]\n0,0\n1,1\n2,4\n1,0.5\n0,0\n")
    assert main(["log", "check", str(tmp_path / "curve.csv"), "--curve"]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "a curve of 3 points" in output and "hysteresis takes 0.0005 J of 0.003 J" in output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["step.csv"], "cannot read log 'step.csv': No such file.*; packaged are logs/steps.csv; did you mean"),
        (["steps", "--mapping", "none.yaml"], "cannot read mapping 'none.yaml'"),
        (["steps", "--out", "log.txt"], r"--out 'log.txt' has to end in .csv or .npz"),
        (["curve.csv", "--curve", "--out", "log.csv"], "--out is for logs; leave it out with --curve"),
        (["curve.csv", "--curve"], "cannot read measured spring curve 'curve.csv'"),
    ],
)
def test_wrong_input_is_one_line(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["log", "check", *words]) == 2
    assert re.fullmatch(f"amulett: error: .*{message}.*\n", capsys.readouterr().err)


def test_the_action_is_required(capsys):
    with pytest.raises(SystemExit):
        main(["log", "steps.csv"])
    assert "invalid choice: 'steps.csv'" in capsys.readouterr().err
