"""The snippets of README and docs run, their commands and links exist, and CI runs the test command that is printed."""

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
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text() for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
}

GUIDES = ("README.md", "docs/commands.md", "docs/devices.md", "docs/logs.md", "docs/training.md")
"""Pages whose inline commands are whole, and whose Python blocks run."""


def blocks(language: str, page: str = "README.md") -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], flags=re.DOTALL)


def commands() -> list[str]:
    """Every `amulett ...` command: of bash blocks in all pages, and inline in the guides, without placeholders."""
    lines = [line for page in PAGES for block in blocks("bash", page) for line in block.splitlines()]
    found = [line.split("  #")[0].strip() for line in lines if line.startswith("amulett ")]
    found += [code for page in GUIDES for code in re.findall(r"`(amulett [^`]+)`", PAGES[page])]
    return sorted({" ".join(code.split()) for code in found if not re.search(r"FILE|DIR|COMMAND|NEW|\.\.\.", code)})


def snippets() -> list[str]:
    return [snippet for page in GUIDES for snippet in blocks("python", page)]


@pytest.mark.parametrize("snippet", snippets())
def test_python_snippets_run(snippet: str, tmp_path: Path):
    subprocess.run([sys.executable, "-c", snippet], cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("command", commands())
def test_commands_parse(command: str):
    arguments = build_parser().parse_args(shlex.split(command)[1:])
    assert arguments.command == shlex.split(command)[1]


def test_simulate_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (command,) = [line for line in commands() if "simulate" in line and "runs/mine.png" in line]
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


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str):
    for target in re.findall(r"\]\(([^)#]+)\)", PAGES[page]):
        if not target.startswith("https://"):
            assert ((ROOT / page).parent / target).exists(), target


def test_the_site_contains_each_page_of_docs():
    contents = PAGES["docs/index.md"].splitlines()
    pages = [page.removeprefix("docs/").removesuffix(".md") for page in PAGES if page.startswith("docs/")]
    assert [page for page in pages if page not in ("index", *contents)] == []


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 120


def test_named_functions_exist():
    rows = [line.split("|")[1:-1] for line in PAGES["docs/paper-to-code.md"].splitlines() if ".py`" in line]
    assert len(rows) > 15
    for _, files, functions in rows:
        texts = [(ROOT / "amulett_gym" / name).read_text() for name in re.findall(r"`([\w/]+\.py)`", files)]
        for name in re.findall(r"`(\w+)`", functions):
            assert any(re.search(rf"def {name}\(", text) for text in texts), f"{name} in {files}"
