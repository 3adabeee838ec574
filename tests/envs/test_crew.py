"""A crew's threads do work together, hand errors on, and end with the crew or the process."""

import gc
import subprocess
import sys
import threading
import time
import weakref

import pytest

from amulett_gym.envs.crew import Crew

DEADLINE = 30.0
"""What is given to what takes a millisecond on a free machine [s]."""


def waited_for(condition):
    end = time.monotonic() + DEADLINE
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_all_threads_work_at_the_same_time():
    crew = Crew(2)
    meeting = threading.Barrier(3, timeout=DEADLINE)
    for _ in range(3):
        crew.share(meeting.wait)
    crew.dismiss()


@pytest.mark.parametrize("fails", ["here", "elsewhere"])
def test_an_error_is_raised_once_no_thread_works_any_more(fails):
    here, done = threading.current_thread(), []
    both = threading.Barrier(2, timeout=DEADLINE)

    def work():
        both.wait()
        if (threading.current_thread() is here) == (fails == "here"):
            raise ValueError("no")
        time.sleep(0.05)
        done.append(True)

    with pytest.raises(ValueError, match="no"):
        Crew(1).share(work)
    assert done == [True]


def test_a_thread_that_has_not_begun_is_not_waited_for():
    crew, busy, calls = Crew(1), threading.Event(), []
    crew._calls.put(busy.wait)
    assert waited_for(crew._calls.empty)
    crew.share(lambda: calls.append(threading.current_thread()))
    assert calls == [threading.current_thread()]
    busy.set()


def test_threads_end_with_their_crew():
    crew = Crew(2)
    crew.share(int)
    threads = crew._threads
    del crew
    gc.collect()
    assert waited_for(lambda: not any(thread.is_alive() for thread in threads))


def test_threads_keep_nothing_of_finished_work():
    class Big:
        pass

    crew, big = Crew(1), Big()
    kept = weakref.ref(big)
    crew.share(lambda big=big: big)
    del big
    assert waited_for(lambda: kept() is None)
    crew.dismiss()


def test_waiting_threads_do_not_hold_up_the_end_of_the_process():
    script = "from amulett_gym.envs.crew import Crew; crew = Crew(3); crew.share(int)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=10 * DEADLINE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
