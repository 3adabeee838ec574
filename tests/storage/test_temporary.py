"""Temporary folders of calls are removed, also those of calls that were killed, but none that is in use."""

import os
import subprocess
import sys

import pytest

from amulett_gym.storage import temporary
from amulett_gym.storage.temporary import call_folder


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """Use a folder of temporary folders that only this test has."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    return tmp_path


def test_a_folder_is_empty_and_removed_at_the_end(place):
    with call_folder() as folder:
        assert list(folder.iterdir()) == []
        (folder / "file").touch()
    assert list(place.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_what_killed_calls_left_is_removed_and_what_is_in_use_stays(place, monkeypatch):
    script = (
        "import os, signal\n"
        "from amulett_gym.storage.temporary import call_folder\n"
        "with call_folder() as folder:\n"
        "    (folder / 'file').touch()\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=False)
    [left] = place.iterdir()
    with call_folder():
        assert left.exists()  # so new that its owner may not have locked it yet
    monkeypatch.setattr(temporary, "_NEW", -1.0)
    with call_folder() as used:
        assert not left.exists()
        with call_folder() as other:
            assert used.exists() and other.exists()
