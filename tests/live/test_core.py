"""The simulation in a browser: node runs the very WebAssembly and scripts, and gives the kernel's numbers."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amulett_gym.live.core import script
from amulett_gym.live.core.build import NO_COMPILER, WASM, build, read_wasm, with_section
from amulett_gym.live.core.data import device_data, scenario_data
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.tasks.scenario import Scenario, pack

PROFILES = ("testbed", "simulation")
PLAY = Path(__file__).with_name("play.js")

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node found: apt-get install -y nodejs")

STATE = {
    "angle": "angle",
    "velocity": "velocity",
    "setpoint": "setpoint",
    "tension.0": "force_biceps",
    "tension.1": "force_triceps",
    "commands.0": "command_biceps",
    "commands.1": "command_triceps",
    "driveAngles.0": "drive_biceps",
    "driveAngles.1": "drive_triceps",
    "measured.tension.0": "estimate_biceps",
    "measured.tension.1": "estimate_triceps",
    "agonist": "agonist",
    "contact": "contact_torque",
    "push": "push_torque",
    "positionIse": "position_ise",
    "tensionIse": "tension_ise",
    "isav.0": "isav_biceps",
    "effort.1": "effort_triceps",
    "driveEffort": "drive_effort",
}
"""What an arm reads -> the kernel's name of it."""


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """Return a function that runs a job in node (`play.js`)."""
    folder = tmp_path_factory.mktemp("node")
    (folder / "core.js").write_text(script(), encoding="utf-8")
    (folder / WASM).write_bytes(read_wasm())

    def run(**job: Any) -> dict[str, Any]:
        command = ["node", str(PLAY), str(folder / "core.js"), str(folder / WASM)]
        result = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr[-3000:]
        return json.loads(result.stdout)

    return run


@pytest.fixture(scope="module")
def devices():
    return {name: device_data(load_profile(name)) for name in PROFILES}


def value_of(row: dict[str, Any], path: str) -> float:
    found: Any = row
    for key in path.split("."):
        found = found[int(key)] if key.isdigit() else found[key]
    return float(found)


def kernel_rows(simulation: Simulation, ticks: int, every: int) -> list[dict[str, float]]:
    rows = []
    for tick in range(0, ticks + 1, every):
        live = simulation.live(0)
        rows.append({path: float(live[name]) for path, name in STATE.items()})
        if tick < ticks:
            simulation.advance(every)
    return rows


def apart(rows: list[dict[str, Any]], wanted: list[dict[str, float]]) -> dict[str, float]:
    """Return by how much each quantity differs at most, relative to its largest value or to 1."""
    found = {}
    for path in STATE:
        ours, theirs = (
            np.array([value_of(row, path) if rows is part else row[path] for row in part]) for part in (rows, wanted)
        )
        found[path] = float(np.abs(ours - theirs).max() / max(np.abs(theirs).max(), 1.0))
    return found


@needs_node
@pytest.mark.parametrize("name", PROFILES)
def test_the_papers_step_equals_the_kernels(node, devices, name):
    scenario = Scenario(moves=[{"time": 1.0, "angle_deg": 60.0}], noise_seed=3)
    ticks, period = 2000, devices[name]["parameters"]["control_period"]
    options = {"device": devices[name], "law": {"name": "eq6"}, "scenario": scenario_data(scenario)}
    [rows] = node(arms=[{"options": options, "ticks": ticks, "every": 1}])["arms"]
    simulation = Simulation(load_profile(name), tension_law="eq6")
    simulation.reset(pack(scenario, load_profile(name)))
    assert max(apart(rows, kernel_rows(simulation, ticks, 1)).values()) < 1e-9
    assert rows[-1]["time"] == pytest.approx(ticks * period)
    assert np.degrees(rows[-1]["angle"]) == pytest.approx(60.0, abs=3.0)


@pytest.mark.slow
@pytest.mark.skipif(util.find_spec("ziglang") is None, reason=NO_COMPILER)
def test_the_file_in_the_package_is_that_of_its_texts():
    assert build() == read_wasm(), "the C texts or the layout have changed: python -m amulett_gym.live.core.build"


def test_a_section_follows_the_format_of_webassembly():
    assert with_section(b"\0asm", "ab", b"c" * 200) == b"\0asm" + b"\0" + b"\xcb\x01" + b"\x02ab" + b"c" * 200
