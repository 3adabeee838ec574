"""The training code is loaded through its entry points alone; the advice about a missing module can be followed."""

from __future__ import annotations

import ast
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from amulett_gym import learning
from amulett_gym.errors import AmulettError, install_extra

ROOT = Path(__file__).parents[1]
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][learning.GROUP]


def imported_by(folder):
    """Yield each file of a folder with the modules that it imports."""
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from ((path, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield path, node.module or ""


def test_the_environment_imports_the_training_code_by_its_entry_points_alone():
    assert [found for found in imported_by(ROOT / "amulett_gym") if found[1].startswith("amulett_agents")] == []


def test_the_training_code_imports_no_study():
    above = ("amulett_gym.studies", "amulett_gym.cli", "amulett_gym.evaluation")
    assert [found for found in imported_by(ROOT / "agents") if found[1].startswith(above)] == []


@pytest.mark.parametrize("part", DECLARED)
def test_every_entry_point_is_a_module_that_can_be_loaded(part):
    if learning.not_installed(learning._NEEDS[part]):
        pytest.skip("torch is not installed")
    assert learning.load_learning(part).__name__ == DECLARED[part]


def test_an_installation_without_the_entry_points_is_to_be_renewed(monkeypatch):
    monkeypatch.setattr(learning, "entry_points", lambda group: ())
    message = "no 'recipes' in the entry points amulett_gym.learning: install amulett-gym again"
    with pytest.raises(AmulettError, match=message):
        learning.load_learning("recipes")


def test_installed_entry_points_count(monkeypatch):
    monkeypatch.setattr(learning, "entry_points", lambda group: (EntryPoint("recipes", "json", group),))
    assert learning.load_learning("recipes").__name__ == "json"


def test_the_advice_names_the_cpu_build_and_no_index_that_does_not_have_us(monkeypatch):
    monkeypatch.setattr(learning, "find_spec", lambda name: None if name == "torch" else object())
    with pytest.raises(AmulettError) as error:
        learning.load_learning("training")
    text = str(error.value)
    assert text.startswith("training code needs torch, not installed here")
    assert text.count("https://download.pytorch.org/whl/cpu") == 1
    assert text.index("download.pytorch.org") < text.index("[agents]")
    for place in (ROOT / "amulett_gym", ROOT / "agents"):
        wrong = [path for path in place.rglob("*.py") if "amulett-gym[" in path.read_text()]
        assert wrong == []


def test_an_extra_is_installed_from_a_checkout_or_a_wheel_file():
    assert "pip install -e '.[peers]'" in install_extra("peers")
    assert "-py3-none-any.whl[peers]'" in install_extra("peers")
