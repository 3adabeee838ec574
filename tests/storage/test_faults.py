"""Full disks, read-only folders, folders that vanish, two commands in one folder: an error, and no loss."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import blank_figures, make_bundle

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation import page as report
from amulett_gym.evaluation.comparison import summarise
from amulett_gym.evaluation.page import write_report
from amulett_gym.evaluation.runner import Results, evaluate
from amulett_gym.jit import notice
from amulett_gym.reporting.style import Figure
from amulett_gym.storage.lock import LOCK
from amulett_gym.storage.writing import check_writable, files_together, output_folder, write_json, write_text

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

needs_limits = pytest.mark.skipif(resource is None, reason="limits the size of files as Unix does")


@contextmanager
def no_file_longer_than(size: int) -> Iterator[None]:
    """Let the system refuse to make any file longer, as a full disk would: some bytes are written, and then no more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def digests(folder: Path) -> dict[str, str]:
    """Return what a folder holds, hidden files too."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def results() -> Results:
    return evaluate(["eq6"], episodes=2, duration=1.0)


@pytest.fixture(scope="module")
def figures(results) -> dict[str, Figure]:
    return report.draw(results, summarise(results))


@needs_limits
@pytest.mark.parametrize("size", [0, 1, 1000, 99_999])
def test_a_text_that_does_not_fit_leaves_the_old_one(tmp_path, size, faults):
    write_text(tmp_path / "file.txt", "old")
    with pytest.raises(AmulettError, match=r"cannot write '.*file\.txt'"), no_file_longer_than(size):
        write_text(tmp_path / "file.txt", "x" * 100_000)
    assert digests(tmp_path) == {"file.txt": hashlib.sha256(b"old").hexdigest()}
    faults("survived", 1)


@pytest.mark.parametrize(
    ("owner", "name"),
    [(tempfile, "mkstemp"), (Path, "write_text"), (Path, "chmod"), (Path, "replace")],
    ids=["mkstemp", "write", "chmod", "rename"],
)
def test_a_disk_that_is_full_at_any_step_of_a_write_leaves_the_old_file(tmp_path, monkeypatch, owner, name, faults):
    write_json(tmp_path / "file.json", {"old": True})
    before = digests(tmp_path)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, full)
        with pytest.raises(AmulettError, match=r"cannot write '.*file\.json': No space left on device"):
            write_json(tmp_path / "file.json", {"new": True})
    assert digests(tmp_path) == before
    faults("survived", 1)


@needs_limits
@pytest.mark.parametrize("size", [0, 1000])
def test_a_comparison_that_does_not_fit_leaves_the_earlier_one(tmp_path, results, size, monkeypatch, faults):
    blank_figures(monkeypatch)
    write_report(results, tmp_path)
    before = digests(tmp_path)
    assert (tmp_path / "results.json").stat().st_size > size, "it would have fitted"
    with pytest.raises(AmulettError, match="cannot write"), no_file_longer_than(size):
        write_report(results, tmp_path)
    assert digests(tmp_path) == before
    faults("survived", 1)


@needs_limits
@pytest.mark.parametrize("size", [30_000, 60_000])
def test_figures_that_do_not_fit_lose_no_number(tmp_path, results, figures, size, monkeypatch, faults):
    monkeypatch.setattr(report, "draw", lambda *_: figures)
    write_report(replace(results, command="earlier"), tmp_path)
    assert (tmp_path / "report.html").stat().st_size > size, "it would have fitted"
    with pytest.raises(AmulettError, match="the results are in results.json"), no_file_longer_than(size):
        write_report(results, tmp_path)
    assert set(digests(tmp_path)) == {"results.json", "scenarios.csv"}, "no figure of the earlier comparison stays"
    assert json.loads((tmp_path / "results.json").read_text()) == summarise(results)
    faults("survived", 1)


@needs_limits
@pytest.mark.parametrize("size", [0, 100, 400])
def test_a_bundle_that_does_not_fit_leaves_the_earlier_one(tmp_path, size, faults):
    make_bundle(tmp_path / "bundle")
    before = digests(tmp_path)
    with pytest.raises(AmulettError, match="cannot write"), no_file_longer_than(size):
        make_bundle(tmp_path / "bundle")
    assert digests(tmp_path) == before
    faults("survived", 1)


def test_files_come_together_or_not_at_all(tmp_path):
    write_text(tmp_path / "a", "old")
    write_text(tmp_path / "b", "old")
    write_text(tmp_path / "mine", "mine")
    with pytest.raises(ZeroDivisionError), files_together(tmp_path, ["a", "b"]) as new:
        write_text(new / "a", "new")
        raise ZeroDivisionError
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "old"
    with files_together(tmp_path, ["a", "b"]) as new:
        write_text(new / "a", "new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "mine": "mine"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
@pytest.mark.parametrize("words", [["list"], ["simulate", "--duration", "1", "--json"]])
def test_an_output_that_is_full_is_reported_in_one_line(words, faults):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "amulett_gym", *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    printed = done.stderr.removeprefix(f"{notice.COMPILING}\n")  # where the code is not compiled yet
    assert printed == "amulett: error: the system refuses: No space left on device\n"
    faults("survived", 1)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="has no folder that even root cannot write")
@pytest.mark.parametrize("place", ["/proc/self/task", "/proc/self/task/new"])
def test_a_folder_that_cannot_be_written_is_refused_before_any_work(place, capsys, faults):
    with pytest.raises(AmulettError, match="cannot write|is not empty"), output_folder(place, "comparison", []):
        pytest.fail("there would have been work")
    with pytest.raises(AmulettError, match="cannot write"):
        check_writable(f"{place}/file")
    with pytest.raises(AmulettError, match="cannot write"):
        write_text(f"{place}/file", "text")
    assert main(["evaluate", "--policies", "eq6", "--out", place]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    faults("survived", 1)


def test_a_folder_that_vanished_is_made_again(tmp_path, results, monkeypatch, faults):
    blank_figures(monkeypatch)
    out = tmp_path / "out"

    def vanish(results):
        shutil.rmtree(out)
        return summarise(results)

    monkeypatch.setattr(report, "summarise", vanish)
    monkeypatch.setattr("amulett_gym.evaluation.runner.evaluate", lambda *_, **__: results)
    assert main(["evaluate", "--policies", "eq6", "--episodes", "2", "--out", str(out)]) == 0
    assert {"results.json", "report.html"} <= set(digests(out))
    faults("survived", 1)


HOLD = """
import sys
from amulett_gym.storage.lock import locked_folder
with locked_folder(sys.argv[1]):
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def busy(tmp_path) -> Iterator[tuple[Path, int]]:
    """Yield a folder that another process works in, and the id of that process."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    yield tmp_path, process.pid
    process.communicate()


@pytest.mark.parametrize(
    "words", [["evaluate", "--policies", "eq6", "--episodes", "1"], ["identify", "--seeds", "1", "--population", "5"]]
)
def test_two_commands_in_one_folder_are_kept_apart(busy, words, capsys, faults):
    folder, pid = busy
    before = digests(folder)
    assert main([*words, "--out", str(folder)]) == 2
    assert f"is in use by process {pid} on {socket.gethostname()}, since" in capsys.readouterr().err
    assert digests(folder) == before
    assert set(before) == {LOCK}
    faults("survived", 1)
