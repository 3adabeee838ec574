"""The README's snippets run, its commands exist, and CI runs the test command that it prints."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from amulett_gym.cli import build_parser, main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands() -> list[str]:
    """Every `amulett ...` command: lines of bash blocks, and inline code without a placeholder."""
    lines = [line for block in blocks("bash") for line in block.splitlines()]
    found = [line for line in lines if line.startswith("amulett ")]
    found += [code for code in re.findall(r"`(amulett [^`]+)`", README) if "FILE" not in code]
    return found


@pytest.mark.parametrize("snippet", blocks("python"))
def test_python_snippets_run(snippet: str, tmp_path: Path):
    subprocess.run([sys.executable, "-c", snippet], cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("command", commands())
def test_commands_parse(command: str):
    arguments = build_parser().parse_args(shlex.split(command)[1:])
    assert arguments.command == shlex.split(command)[1]


def test_simulate_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (command,) = [line for line in commands() if "configs/my_device.yaml" in line]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    assert main(shlex.split(command)[1:]) == 0
    assert (tmp_path / "runs" / "mine.csv").stat().st_size > 0
    assert (tmp_path / "runs" / "mine.png").read_bytes().startswith(b"\x89PNG")


def test_ci_runs_the_readmes_test_command():
    (command,) = [block.strip() for block in blocks("bash") if "pytest" in block]
    assert command in (ROOT / ".ci" / "run").read_text().splitlines()


def test_nothing_is_left_to_fill_in():
    assert not re.search(r"^(BENCH|TODO|TBD)", README, flags=re.MULTILINE)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if not target.startswith("https://"):
            assert (ROOT / target).exists(), target


def test_named_functions_exist():
    for line in README.splitlines():
        if not line.startswith("|") or ".py" not in line:
            continue
        file = None
        for token in re.findall(r"`([^`]+)`", line):
            if token.endswith(".py"):
                file = ROOT / "amulett_gym" / token
            elif file is not None and token.isidentifier():
                assert re.search(rf"def {token}\(", file.read_text()), f"{token} in {file}"
