"""Calls in processes give their results, their progress and their errors."""

import os
import signal
import subprocess
import sys
import time
from multiprocessing import get_context
from threading import Thread

import pytest
from helpers import wait_until

from amulett_gym.errors import AmulettError
from amulett_gym.workers.call import MOST_LOST, Call, Workers
from amulett_gym.workers.processes import in_processes
from amulett_gym.workers.report import advance, keep
from amulett_gym.workers.run import results


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
    found = dict(in_processes({f"of {number}": Call(_square, (number,)) for number in range(4)}, 2, units.append))
    assert {name: result for name, (result, _) in found.items()} == {"of 0": 0, "of 1": 1, "of 2": 4, "of 3": 9}
    assert sum(units) == 6
    processes = {process for _, process in found.values()}
    assert os.getpid() not in processes and len(processes) <= 2
    assert dict(in_processes({}, 2)) == {}


def test_an_error_ends_the_other_calls(tmp_path):
    with pytest.raises(ValueError, match="negative") as caught:
        dict(in_processes({"wrong": Call(_square, (-1,))}, 1))
    assert caught.value.__notes__[-1] == "amulett: in wrong"
    calls = {name: Call(_mark, (tmp_path / name, seconds)) for name, seconds in (("short", 0.0), ("long", 20.0))}
    with pytest.raises(ZeroDivisionError):
        for _ in in_processes(calls, 2):
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["short"]


def test_an_error_leaves_processes_of_others_running():
    other = get_context("spawn").Process(target=time.sleep, args=(600.0,))
    other.start()
    try:
        with pytest.raises(ValueError, match="negative"):
            dict(in_processes({"wrong": Call(_square, (-1,))}, 1))
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
        "from amulett_gym.workers.call import Call\n"
        "from amulett_gym.workers.processes import in_processes\n"
        "def work(path):\n"
        "    open(path + str(os.getpid()), 'w').close()\n"
        "    open(f'{path}{os.getpid()}-{time.monotonic_ns()}', 'w').close()\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    dict(in_processes({str(k): Call(work, (sys.argv[1],)) for k in range(6)}, 2))\n"
    )
    command = [sys.executable, str(tmp_path / "calls.py"), str(tmp_path / "begun-")]
    parent = subprocess.Popen(
        command,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    wait_until(lambda: len(list(tmp_path.glob("begun-*-*"))) == 2)
    if ended_by == signal.SIGINT:
        os.killpg(parent.pid, ended_by)  # as a terminal does: to the workers, too
    else:
        parent.send_signal(ended_by)
    _, said = parent.communicate(timeout=120)
    assert parent.returncode == -ended_by
    begun = [path.name.removeprefix("begun-") for path in tmp_path.glob("begun-*")]
    workers = [int(name) for name in begun if "-" not in name]
    wait_until(lambda: not any(map(_is_running, workers)))
    assert len(workers) == 2 and len(begun) == 4  # one call each
    assert said.count("Traceback") == (ended_by == signal.SIGINT)  # the parent's


def _count_on(folder, end, killed_at):
    """Count on from the number in the folder; this process is killed once at each of some numbers."""
    path = folder / "number"
    for number in range(int(path.read_text()) if path.exists() else 0, end):
        advance(1)
        path.write_text(str(number + 1))
        keep()
        mark = folder / f"killed-at-{number + 1}"
        if number + 1 in killed_at and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return end


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_call_whose_process_is_killed_continues_and_others_go_on(tmp_path):
    units = []
    (tmp_path / "killed").mkdir(), (tmp_path / "other").mkdir()
    calls = {name: Call(_count_on, (20, at), tmp_path / name) for name, at in (("killed", (5, 12)), ("other", ()))}
    assert dict(results(calls, Workers(2), units.append)) == {"killed": 20, "other": 20}
    assert sum(units) == 40  # nothing was done twice


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_progress_takes_back_what_a_killed_process_did_not_keep(tmp_path):
    units = []
    calls = {"kept": Call(_end_once, (tmp_path / "kept", True)), "lost": Call(_end_once, (tmp_path / "lost", False))}
    assert dict(results(calls, Workers(2), units.append)) == {"kept": None, "lost": None}
    assert sum(units) == 10 + 5  # of "kept" those before and after its end, of "lost" those after


def _end_once(mark, keeps):
    advance(5)
    if keeps:
        keep()
    if not mark.exists():
        mark.touch()
        time.sleep(2.0)  # the parent reads the units
        os.kill(os.getpid(), signal.SIGKILL)
    if not keeps:
        keep()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_process_that_is_killed_between_two_calls_is_replaced():
    calls = {"first": Call(_square, (1,)), "second": Call(_end_soon)}
    calls |= {f"of {number}": Call(_square, (number,)) for number in range(2, 5)}
    found, finished = {}, results(calls, Workers(2))
    for name, result in finished:
        found[name] = result
        time.sleep(3.0)  # "second" is finished meanwhile, and its process is killed
    assert set(found) == set(calls)


def _end_soon():
    Thread(target=lambda: (time.sleep(0.5), os.kill(os.getpid(), signal.SIGKILL)), daemon=True).start()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_call_that_kills_its_process_again_and_again_is_named(tmp_path):
    calls = {"good": Call(_mark, (tmp_path / "good", 0.0)), "bad": Call(_end, (signal.SIGKILL,))}
    with pytest.raises(AmulettError, match=rf"^bad: its worker was killed {MOST_LOST + 1} times"):
        dict(results(calls, Workers(2)))


def _end(number):
    os.kill(os.getpid(), number)
    time.sleep(60)


def test_one_call_at_a_time_is_made_in_this_process(tmp_path):
    units = []
    calls = {f"of {number}": Call(_square, (number,)) for number in range(3)}
    assert dict(results(calls, watch=units.append)) == {f"of {k}": (k * k, os.getpid()) for k in range(3)}
    assert units == [0, 1, 2]
    with pytest.raises(AmulettError, match="^number 1: it is odd"):
        dict(results({"number 1": Call(_refuse)}))


def _refuse():
    raise AmulettError("it is odd")


def _is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
