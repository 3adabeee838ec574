"""Jobs in several processes: all are done, and an error is passed on."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.studies.benchmark.processes import work_ahead


def test_all_jobs_are_done_and_errors_are_passed_on(tmp_path):
    files = [tmp_path / str(k) for k in range(3)]
    work_ahead([partial(Path.mkdir, file) for file in files], 1, "jobs")
    assert not any(file.exists() for file in files)  # one process: the caller does them
    work_ahead([partial(Path.mkdir, file) for file in files], 2, "jobs")
    assert all(file.exists() for file in files)
    with pytest.raises(AmulettError, match="nonesuch"):
        work_ahead([partial(load_profile, "nonesuch")], 2, "jobs")


def test_they_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "jobs.py").write_text(
        "import os, sys, time\n"
        "from functools import partial\n"
        "from amulett_gym.studies.benchmark.processes import work_ahead\n"
        "def wait(path):\n"
        "    open(path + str(os.getpid()), 'w').close()\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    work_ahead([partial(wait, sys.argv[1])] * 2, 2, 'jobs')\n"
    )
    parent = subprocess.Popen([sys.executable, str(tmp_path / "jobs.py"), str(tmp_path / "pid-")])
    _wait_until(lambda: len(list(tmp_path.glob("pid-*"))) == 2)
    parent.send_signal(signal.SIGTERM)
    parent.wait()
    children = [int(path.name.removeprefix("pid-")) for path in tmp_path.glob("pid-*")]
    _wait_until(lambda: not any(map(_is_running, children)))


def _wait_until(condition):
    for _ in range(2400):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it does not happen")


def _is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
