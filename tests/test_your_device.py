"""The way of docs/your-device.md runs on the shipped log: each command of its first block, with fewer episodes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from amulett_gym.cli import main
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.profile import load_profile

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "your-device.md").read_text(encoding="utf-8")
(WAY, *_) = re.findall(r"```bash\n(.*?)```", PAGE, flags=re.DOTALL)

FEWER = {
    "fit": "--starts 1 --devices 2",
    "tune-law": "--budget 1600 --seeds 1 --validation 2 --workers 1",
    "train": "total_steps=512 num_envs=8 ppo.n_steps=16 ppo.batch_size=64 ppo.n_epochs=1 "
    "validation.every_steps=256 validation.episodes=2 env.suite=steps env.max_episode_steps=50",
    "evaluate": "--episodes 2 --duration 3",
    "hil": "--episodes 1 --duration 0.5",
}
"""Options that make a command short; those of train continue its --set."""

SKIPPED = {"serial:": "there is no board"}
"""A part of a command, and why it is not run."""

NEEDS = {"--transport chip": ("avr-gcc", "simavr"), "make ": ("avr-gcc", "make")}
"""A part of a command, and programs without which it is not run."""


def commands() -> list[str]:
    return [line.split("  #")[0].strip() for line in WAY.splitlines()]


def reason_to_skip(command: str) -> str | None:
    reasons = [why for part, why in SKIPPED.items() if part in command]
    reasons += [
        f"no {name}" for part, names in NEEDS.items() if part in command for name in names if not shutil.which(name)
    ]
    return reasons[0] if reasons else None


def shortened(command: str) -> list[str]:
    """Return the words behind `amulett` of a short run."""
    words = shlex.split(command)[1:]
    fewer = shlex.split(FEWER.get(words[0], ""))
    return [*words[:-2], *fewer, *words[-2:]] if words[0] == "train" else [*words, *fewer]


def test_the_way_from_log_to_firmware(tmp_path, monkeypatch):
    pytest.importorskip("torch", reason="training needs PyTorch")
    monkeypatch.chdir(tmp_path)
    for command in commands():
        if reason_to_skip(command) is None:
            if command.startswith("amulett "):
                assert main(shortened(command)) == 0, command
            else:
                subprocess.run(shlex.split(command), check=True, capture_output=True)
    assert load_profile(Path("runs/mine.yaml")).drives.sources["lag"].startswith("identified")
    assert len(load_fleet(Path("runs/mine_fleet.yaml"))) == 2
    read_bundle("runs/mine_policy/best")
    assert Path("runs/hil_host/index.html").is_file()


def test_every_step_is_on_the_way():
    steps = {" ".join(shlex.split(command)[:2]) for command in commands()}
    wanted = ("log", "fit", "config", "tune-law", "train", "evaluate", "export", "hil")
    assert steps == {f"amulett {name}" for name in wanted} | {"make -C"}
    assert [command for command in commands() if reason_to_skip(command)][-1].endswith(
        "serial:/dev/ttyACM0 --episodes 5"
    )
