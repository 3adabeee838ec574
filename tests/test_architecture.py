"""Imports go one way: no module imports from a layer above its own, there is no circle, and studies are leaves."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"amulett_gym": ROOT / "amulett_gym", "amulett_agents": ROOT / "agents" / "amulett_agents"}

LAYERS = (
    ("errors", "settings", "jit", "storage", "workers"),
    ("fitting", "fleet", "gains", "profile"),
    ("model",),
    ("control",),
    ("simulation",),
    ("logs",),
    ("tasks",),
    ("envs",),
    ("laws",),
    ("identification",),
    ("learning", "reporting"),
    ("evaluation",),
    ("datasets",),
    ("c",),
    ("firmware", "live"),
    ("studies",),
    ("cli", "__main__"),
)
"""Rooms of `amulett_gym` from the bottom to the top; a room imports from its own layer and those below."""


def modules() -> dict[str, Path]:
    return {
        ".".join((name, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__"): path
        for name, root in PACKAGES.items()
        for path in root.rglob("*.py")
    }


@cache  # for the tests: whoever only collects them parses nothing
def imports() -> dict[str, set[str]]:
    """Return what each module imports of ours, within functions too, but not for type checking alone."""
    known = modules()
    found = {}
    for name, path in known.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        hidden = {
            id(node)
            for block in ast.walk(tree)
            if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
            for node in ast.walk(block)
        }
        found[name] = set()
        for node in ast.walk(tree):
            if id(node) in hidden:
                continue
            if isinstance(node, ast.Import):
                found[name] |= {alias.name for alias in node.names} & set(known)
            elif isinstance(node, ast.ImportFrom) and node.module in known:
                parts = {f"{node.module}.{alias.name}" for alias in node.names}
                found[name] |= (parts & set(known)) | ({node.module} if parts - set(known) else set())
        found[name].discard(name)
    return found


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def layer(module: str) -> int:
    return next(index for index, rooms in enumerate(LAYERS) if room(module) in rooms)


OURS = sorted(name for name in modules() if name.startswith("amulett_gym."))


@pytest.mark.parametrize("module", OURS)
def test_imports_go_downwards(module: str):
    targets = {target for target in imports()[module] if target != "amulett_gym"}
    assert {target for target in targets if not target.startswith("amulett_gym")} == set(), "use amulett_gym.learning"
    assert {target for target in targets if layer(target) > layer(module)} == set()


def test_there_is_no_circle():
    # The package's own module imports `load_policy` when it is asked for; what it imports then must not need it.
    graph = {name: targets - {"amulett_gym"} for name, targets in imports().items()}
    assert list(TopologicalSorter(graph).static_order())


def test_only_commands_import_studies():
    for module, targets in imports().items():
        if room(module) != "cli":
            own = module.split(".")[:3] if room(module) == "studies" else None
            studies = {target for target in targets if room(target) == "studies"}
            assert {target for target in studies if target.split(".")[:3] != own} == set(), module


def test_what_learns_does_not_import_studies_or_commands():
    for module, targets in imports().items():
        if module.startswith("amulett_agents"):
            assert {target for target in targets if room(target) in ("studies", "cli")} == set(), module
