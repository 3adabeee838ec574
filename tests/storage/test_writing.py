"""Outputs: a home folder is expanded in each way of writing."""

from __future__ import annotations

from pathlib import Path

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.storage.kept import kept
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import read_provenance, write_provenance
from amulett_gym.storage.writing import check_writable, files_together, output_folder, write_json, write_text


@pytest.fixture
def home(tmp_path, monkeypatch) -> Path:
    """Return the home folder; the working folder is another one, and has to stay empty."""
    for name in ("home", "here"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    return tmp_path / "home"


def test_a_home_folder_is_expanded_by_all_writers(home):
    write_json("~/a.json", 1)
    write_text(Path("~/b/b.txt"), "text")
    check_writable("~/c/c.txt")
    with files_together("~/d", ["d.txt"]) as new:
        write_text(new / "d.txt", "text")
    with output_folder("~/e", "comparison", []), locked_folder("~/e"):
        write_provenance("~/e", "evaluate", {}, [])
    assert read_provenance("~/e").kind == "evaluate"
    assert kept("~/f.npz", 1, dict) == kept("~/f.npz", 1, dict) == {}
    assert {path.name for path in home.iterdir()} == {"a.json", "b", "c", "d", "e", "f.npz"}
    assert not list(Path().iterdir())


def test_a_home_that_is_none_is_a_name(home):
    write_text("~no-such-user-here/a.txt", "text")
    assert Path("~no-such-user-here/a.txt").read_text() == "text"
    write_text("a~b~", "text")
    assert Path("a~b~").is_file()
    with pytest.raises(AmulettError, match="is a folder"):
        check_writable("~")
