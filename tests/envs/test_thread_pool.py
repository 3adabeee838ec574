"""A pool's threads work together, pass errors on, and end with the pool or the process."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref

import pytest

from amulett_gym.envs import thread_pool
from amulett_gym.envs.thread_pool import ThreadPool

DEADLINE = 30.0
"""What is given to what takes a millisecond on a free machine [s]."""


def waited_for(condition):
    end = time.monotonic() + DEADLINE
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def test_all_threads_work_at_the_same_time():
    pool, here = ThreadPool(2), threading.current_thread()
    meeting = threading.Barrier(3, timeout=DEADLINE)

    def meet():
        meeting.wait()
        return threading.current_thread()

    assert [pool.run(meet) for _ in range(3)] == [here] * 3
    pool.close()


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

    pool = ThreadPool(1)
    with pytest.raises(ValueError, match="no"):
        pool.run(work)
    assert done == [True]
    (thread,), kept = pool._threads, weakref.ref(pool)
    del pool, work
    gc.collect()
    assert waited_for(lambda: kept() is None and not thread.is_alive())


@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
def test_an_interruption_is_raised_once_no_thread_works_any_more():
    here, done = threading.current_thread(), []
    both = threading.Barrier(2, timeout=DEADLINE)

    def work():
        both.wait()
        if threading.current_thread() is not here:
            time.sleep(0.05)
            os.kill(os.getpid(), signal.SIGALRM)
            time.sleep(0.5)
            done.append(True)

    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            ThreadPool(1).run(work)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert done == [True]


def test_an_interruption_anywhere_leaves_no_thread_at_work():
    here, pool, working = threading.current_thread(), ThreadPool(1), []

    def work():
        if threading.current_thread() is here:
            time.sleep(0.002)
        else:
            working.append(True)
            time.sleep(0.004)
            working.pop()

    def interrupted_at(step):
        """Return whether there is such a step of the interpreter, before which a signal's handler then raises."""
        left = iter(range(step))

        def trace(frame, event, _):
            if frame.f_code.co_filename != thread_pool.__file__:
                return None
            frame.f_trace_opcodes = True
            if event == "opcode" and next(left, None) is None:
                sys.settrace(None)
                raise KeyboardInterrupt
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            pool.run(work)
        except KeyboardInterrupt:
            return True
        finally:
            sys.settrace(before)
        return False

    step = 0
    while interrupted_at(step):
        time.sleep(0.002)  # for a thread to begin
        assert not working and pool._calls.empty(), step
        step += 1
    assert step > 50
    pool.close()


@pytest.mark.parametrize("looks", [0, 1, 10**9])
def test_others_are_waited_for_awake_or_asleep(looks, monkeypatch):
    monkeypatch.setattr(thread_pool, "LOOKS", looks)
    here, done = threading.current_thread(), []
    both = threading.Barrier(3, timeout=DEADLINE)

    def work():
        both.wait()
        if threading.current_thread() is not here:
            time.sleep(0.02)
            done.append(True)

    pool = ThreadPool(2)
    for turn in range(1, 4):
        pool.run(work)
        assert len(done) == 2 * turn
    pool.close()


def test_a_thread_that_has_not_begun_is_not_waited_for():
    pool, busy, calls = ThreadPool(1), threading.Event(), []
    thread_pool._Run(busy.wait).call(pool._calls, 1)
    assert waited_for(pool._calls.empty)
    caller = threading.Thread(target=pool.run, args=(lambda: calls.append(threading.current_thread()),), daemon=True)
    caller.start()
    caller.join(DEADLINE)
    busy.set()
    assert calls == [caller] and not caller.is_alive()


def test_threads_end_with_their_pool():
    pool = ThreadPool(2)
    pool.run(int)
    threads = pool._threads
    del pool
    gc.collect()
    assert waited_for(lambda: not any(thread.is_alive() for thread in threads))


def test_threads_keep_nothing_of_finished_work():
    class Big:
        pass

    pool, big, both = ThreadPool(1), Big(), threading.Barrier(2, timeout=DEADLINE)
    kept = weakref.ref(big)
    pool.run(lambda big=big: both.wait())
    del big
    assert waited_for(lambda: kept() is None)
    pool.close()


def test_waiting_threads_do_not_hold_up_the_end_of_the_process():
    script = "from amulett_gym.envs.thread_pool import ThreadPool; pool = ThreadPool(3); pool.run(int)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=10 * DEADLINE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
