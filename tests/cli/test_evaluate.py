"""`amulett evaluate` in a process of its own: nothing of the environment keeps it from writing its report."""

import json
import os
import subprocess
import sys

from amulett_gym.cli import main

INLINE = "module://matplotlib_inline.backend_inline"  # what a notebook leaves in the environment of its shells


def test_a_backend_that_is_not_installed_loses_nothing(tmp_path):
    words = [*("evaluate", "--policies", "eq6", "--episodes", "1"), "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "amulett_gym", *words],
        env=os.environ | {"MPLBACKEND": INLINE},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert not {"Traceback", "matplotlib", "backend"} & set(done.stderr.replace(".", " ").split())  # progress at most
    assert "eq6" in json.loads((tmp_path / "results.json").read_text())["policies"]
    assert {"report.html", "cost.png", "responses.png"} <= {path.name for path in tmp_path.iterdir()}


def test_own_scenarios_are_compared_kept_by_content_and_run_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lift.yaml").write_text("initial_angle_deg: 20\nmoves: [{time: 0.1, angle_deg: 50}]\n")
    (tmp_path / "push.json").write_text('{"pushes": [{"time": 0.2, "duration": 0.2, "torque": 0.1}]}')
    words = ["evaluate", "--policies", "constant:8", "--scenario", "lift.yaml", "push.json", "--duration", "1"]
    assert main([*words, "--out", "own"]) == 0
    output = capsys.readouterr().out
    assert "in 2 own scenarios on the testbed" in " ".join(output.split())
    results = json.loads((tmp_path / "own" / "results.json").read_text())
    assert (results["episodes"], results["task"], results["duration"]) == (2, "own scenarios", 1.0)
    assert "own, 2 in turn, seeds 0 to 1, 1.0 s each" in (tmp_path / "own" / "report.html").read_text()
    for file in ("lift.yaml", "push.json"):
        (tmp_path / file).unlink()
    assert main(["rerun", "own", "--out", "again"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
