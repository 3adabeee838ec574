"""Calls in processes give their results, their progress and their errors."""

import os
import signal
import subprocess
import sys
import time
from multiprocessing import get_context

import pytest

from amulett_gym.evaluation.processes import advance, in_processes


def _square(number):
    advance(number)
    if number < 0:
        raise ValueError("negative")
    return number * number, os.getpid()


def _mark(path, seconds):
    time.sleep(seconds)
    path.touch()


def test_results_have_the_names_of_their_calls_and_progress_is_complete():
    units = []
    found = dict(in_processes(_square, {f"of {number}": (number,) for number in range(4)}, 2, units.append))
    assert {name: result for name, (result, _) in found.items()} == {"of 0": 0, "of 1": 1, "of 2": 4, "of 3": 9}
    assert sum(units) == 6
    processes = {process for _, process in found.values()}
    assert os.getpid() not in processes and len(processes) <= 2
    assert dict(in_processes(_square, {}, 2)) == {}


def test_an_error_ends_the_other_calls(tmp_path):
    with pytest.raises(ValueError, match="negative"):
        dict(in_processes(_square, {"wrong": (-1,)}, 1))
    calls = {"short": (tmp_path / "short", 0.0), "long": (tmp_path / "long", 20.0)}
    with pytest.raises(ZeroDivisionError):
        for _ in in_processes(_mark, calls, 2):
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["short"]


def test_an_error_leaves_processes_of_others_running():
    other = get_context("spawn").Process(target=time.sleep, args=(600.0,))
    other.start()
    try:
        with pytest.raises(ValueError, match="negative"):
            dict(in_processes(_square, {"wrong": (-1,)}, 1))
        other.join(0.5)
        assert other.is_alive()
    finally:
        other.kill()
        other.join()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("ended_by", [signal.SIGINT, signal.SIGKILL])
def test_they_end_with_their_parent_and_begin_no_further_call(tmp_path, ended_by):
    (tmp_path / "calls.py").write_text(
        "import os, sys, time\n"
        "from amulett_gym.evaluation.processes import in_processes\n"
        "def work(path):\n"
        "    open(path + str(os.getpid()), 'w').close()\n"
        "    open(f'{path}{os.getpid()}-{time.monotonic_ns()}', 'w').close()\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    dict(in_processes(work, {k: (sys.argv[1],) for k in range(6)}, 2))\n"
    )
    command = [sys.executable, str(tmp_path / "calls.py"), str(tmp_path / "begun-")]
    parent = subprocess.Popen(
        command,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    _wait_until(lambda: len(list(tmp_path.glob("begun-*-*"))) == 2)
    if ended_by == signal.SIGINT:
        os.killpg(parent.pid, ended_by)  # as a terminal does: to the workers, too
    else:
        parent.send_signal(ended_by)
    _, said = parent.communicate(timeout=120)
    assert parent.returncode == -ended_by
    begun = [path.name.removeprefix("begun-") for path in tmp_path.glob("begun-*")]
    workers = [int(name) for name in begun if "-" not in name]
    _wait_until(lambda: not any(map(_is_running, workers)))
    assert len(workers) == 2 and len(begun) == 4  # one call each
    assert said.count("Traceback") == (ended_by == signal.SIGINT)  # the parent's


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
