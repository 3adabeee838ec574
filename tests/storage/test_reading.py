"""Folders: what is hidden is no content."""

from __future__ import annotations

from amulett_gym.storage.reading import visible
from amulett_gym.storage.writing import output_folder


def test_hidden_files_and_what_is_in_hidden_folders_are_no_content(tmp_path):
    for name in (".DS_Store", "._a.json", "b.json", "sub/._c.json", "sub/c.json", ".git/d.json", "a.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    names = [path.relative_to(tmp_path).as_posix() for path in visible(tmp_path)]
    assert names == ["a.txt", "b.json", "sub"]
    names = [path.relative_to(tmp_path).as_posix() for path in visible(tmp_path, "**/*.json")]
    assert names == ["b.json", "sub/c.json"]


def test_a_folder_in_a_hidden_one_is_read(tmp_path):
    (tmp_path / ".runs").mkdir()
    (tmp_path / ".runs" / "a").write_text("")
    assert [path.name for path in visible(tmp_path / ".runs")] == ["a"]


def test_a_folder_with_hidden_files_only_is_an_empty_output_folder(tmp_path):
    (tmp_path / ".DS_Store").write_text("")
    with output_folder(tmp_path, "comparison", [["results.json"]]) as earlier:
        assert not earlier
