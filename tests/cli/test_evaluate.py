"""`amulett evaluate` in a process of its own: nothing of the environment keeps it from writing its report."""

import json
import os
import subprocess
import sys

from helpers import blank_figures

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
    blank_figures(monkeypatch)
    assert main(["rerun", "own", "--out", "again"]) == 0
    assert "numbers are the same" in capsys.readouterr().out


FLEET = """- testbed
- {name: heavy, base: testbed, plant: {masses: [{mass: 0.4, arm: 0.13}]}}
"""


def test_a_fleet_is_compared_kept_by_content_and_run_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet.yaml").write_text(FLEET)
    words = ["evaluate", "--policies", "constant:8", "--fleet", "fleet.yaml", "--episodes", "3", "--duration", "1"]
    assert main([*words, "--out", "compared"]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "on 2 devices, in 3 held-out scenarios of steps on each" in output
    results = json.loads((tmp_path / "compared" / "results.json").read_text())
    assert results["fleet"] == ["testbed", "heavy"]
    assert "--fleet fleet.yaml" in results["command"] and "--profile" not in results["command"]
    (tmp_path / "fleet.yaml").unlink()
    assert main(["rerun", "compared", "--out", "again"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    changed = (
        (tmp_path / "compared" / "scenarios.csv").read_text().replace("constant:8,heavy,2,2,", "constant:8,heavy,2,3,")
    )
    (tmp_path / "compared" / "scenarios.csv").write_text(changed)
    assert main(["rerun", "compared", "--out", "third"]) == 1
    assert "constant:8 heavy 2" in capsys.readouterr().out


def test_a_device_of_a_fleet_is_simulated_and_validated(tmp_path, capsys):
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(FLEET)
    assert main(["simulate", "--fleet", str(fleet), "--device", "heavy", "--duration", "0.2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"] == "heavy"
    for words, message in (
        (["--fleet", str(fleet), "--device", "heavi"], "unknown device 'heavi'; did you mean 'heavy'"),
        (["--fleet", str(fleet)], "choose one of the fleet's 2 devices, for example --device testbed"),
        (["--device", "heavy"], "--device 'heavy' is one of a fleet; give the fleet with --fleet"),
    ):
        for command in (["simulate"], ["play", "eq6", "--video", str(tmp_path / "x.gif")]):
            assert main([*command, *words]) == 2
            assert message.split(";")[0] in capsys.readouterr().err
    assert main(["config", "validate", str(fleet)]) == 0
    assert f"{fleet}: valid, a fleet of 2 devices (fleet)" in capsys.readouterr().out
    fleet.write_text(FLEET.replace("0.4", "4.0"))
    assert main(["config", "validate", str(fleet), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any("heavy" in remark for remark in found["remarks"]) and list(found["content"]) == ["testbed", "heavy"]
    fleet.write_text(FLEET.replace("masses", "masss"))
    assert main(["config", "validate", str(fleet)]) == 2
    assert "profile 1" in capsys.readouterr().err
