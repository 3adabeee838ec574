"""Finished work: read back while its inputs are the same, done again if they changed or the file is damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.storage.kept import digest, kept, read_kept, write_kept

INPUTS = {"seed": np.int64(3), "sizes": (1, 2), "gain": 0.1, "sha256": digest(np.arange(3))}
RESULTS: dict[str, Any] = {"plain.json": {"cost": 0.1, "parameters": [1.0, 2.0]}, "arrays.npz": {"cost": np.ones(3)}}


class Work:
    """Counts how often it is done."""

    def __init__(self, result: Any) -> None:
        self.done, self.result = 0, result

    def __call__(self) -> Any:
        self.done += 1
        return self.result


each_format = pytest.mark.parametrize("name", RESULTS)


@each_format
def test_work_is_done_once_for_the_same_inputs(name, tmp_path):
    path, work = tmp_path / "new" / name, Work(RESULTS[name])
    for _ in range(2):
        found = kept(path, INPUTS, work)
        assert found.keys() == RESULTS[name].keys()
        np.testing.assert_equal(found, RESULTS[name])
    assert work.done == 1
    kept(path, {**INPUTS, "seed": 4}, work)
    kept(path, INPUTS, work)
    assert work.done == 3
    assert [file.name for file in path.parent.iterdir()] == [name]


@each_format
@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-20]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"[1]"),
        lambda path: path.write_bytes(b'{"inputs": null}'),
        Path.unlink,
    ],
    ids=["cut", "empty", "list", "no inputs", "gone"],
)
def test_damaged_work_is_done_again(name, damage, tmp_path):
    path, work = tmp_path / name, Work(RESULTS[name])
    kept(path, INPUTS, work)
    damage(path)
    assert read_kept(path, INPUTS) is None
    np.testing.assert_equal(kept(path, INPUTS, work), RESULTS[name])
    assert work.done == 2
    np.testing.assert_equal(read_kept(path, INPUTS), RESULTS[name])


def test_content_that_cannot_be_unpacked_is_made_again(tmp_path):
    path, work = tmp_path / "a.json", Work(7)

    def unpack(content: Any) -> int:
        return int(content["value"])

    write_kept(path, "key", {"other": 1})
    for _ in range(2):
        assert kept(path, "key", work, lambda value: {"value": value}, unpack) == 7
    assert work.done == 1


def test_work_that_fails_keeps_what_is_there(tmp_path):
    path = tmp_path / "a.json"
    kept(path, 1, lambda: "old")
    with pytest.raises(ZeroDivisionError):
        kept(path, 2, lambda: 1 / 0)
    assert read_kept(path, 1) == "old"


def test_what_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "a.json").mkdir()
    with pytest.raises(AmulettError, match=r"cannot write '.*a\.json'"):
        kept(tmp_path / "a.json", 1, lambda: 1)


def test_a_digest_depends_on_the_content_alone():
    assert digest({"a": 1, "b": [2.0]}) == digest({"b": (np.float64(2.0),), "a": np.int32(1)})
    assert digest(np.arange(6).reshape(2, 3).T) == digest(np.arange(6).reshape(2, 3).T.copy())
    assert digest([np.arange(5000)]) != digest([np.arange(5000)[::-1]])  # `str` would show neither whole
    assert digest(Path("a")) == digest(Path("a")) != digest(Path("b"))
    assert len({digest(part) for part in (0, 1, 0.5, "", None, False, [0], np.zeros(2), b"x")}) == 9
    with pytest.raises(TypeError, match="type object is not JSON serializable"):
        digest([object()])
