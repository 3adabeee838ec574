"""Threads take the shares of a step together, and end with the step or the process."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from functools import partial

import numba
import numpy as np
import pytest
from helpers import wait_until

from amulett_gym.envs import shared_step
from amulett_gym.envs.action import ALL_NUMBERS
from amulett_gym.envs.shared_step import SharedStep
from amulett_gym.envs.shares import (
    AWAKE,
    DONE,
    GIVEN,
    NEXT,
    SHARES,
    first_share,
    given_to,
    next_share,
    turns_of,
    withdraw,
)
from amulett_gym.jit.atomic import add, read, write
from amulett_gym.jit.compiled import compiled

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs the compiler")

DEADLINE = 30.0
"""What is given to what takes a millisecond on a free machine [s]."""

BLOCKS = 64


@compiled
def entry_of(others, device):
    return 0.0 if others is None else others[device]


@compiled
def take(gate, taken, means, turns, looks):
    """Write the sum of a device's actions into its row of the tables; count in `taken`, and wait at the gate.

    The gate is closed if it is 1, for all but the caller if it is 2. Device and block are the same here.
    """
    blocks = first_share(turns, looks)
    while blocks[0] < blocks[1]:
        add(taken, 1)
        while read(gate) > 0 and (looks > 1 or read(gate) == 1):
            pass
        others, actions, observations, report = given_to(turns, means)
        for device in range(blocks[0], blocks[1]):
            total = actions[device] + entry_of(others, device)
            observations[device] = total
            report[device] = total
        blocks = next_share(turns, looks)


@compiled
def set_to(number, value):
    write(number, value)


def number(value=0):
    return np.full(1, value)


def arrays(blocks=BLOCKS, entries=3, reported=5):
    tables = np.full((blocks, entries), np.nan, dtype=np.float32), np.full((blocks, reported), np.nan)
    return np.arange(blocks, dtype=np.float64), *tables


def shared(threads=2, means=None, gate=None, taken=None):
    gate, taken = number() if gate is None else gate, number() if taken is None else taken
    given = means, *arrays()
    take(gate, taken, means, turns_of(1, 1), 0)  # compiled, so that all begin at once
    return SharedStep(partial(take, gate, taken, means), BLOCKS, threads, given)


def is_done(actions, observations, report):
    return all((table == actions[:, None]).all() for table in (observations, report))


@pytest.mark.parametrize("threads", [2, 3, 8])
@pytest.mark.parametrize("pause", [0.0, 0.01])
def test_each_step_is_done_when_it_returns(threads, pause):
    step = shared(threads)
    for size in range(1, 40):  # other arrays each time
        actions, observations, report = arrays(entries=size, reported=1 + size % 7)
        assert step(None, actions, observations, report) == ALL_NUMBERS
        assert is_done(actions, observations, report)
        time.sleep(pause)
    step.close()


def test_other_actions_are_given_too():
    step = shared(means=np.zeros(1))
    actions, observations, report = arrays()
    assert step(np.ones(BLOCKS), actions, observations, report) == ALL_NUMBERS
    assert is_done(actions + 1, observations, report)
    actions[5] = np.nan
    assert step(np.ones(BLOCKS), actions, observations, report) == 5
    assert step(actions, np.ones(BLOCKS), observations, report) == 5
    actions[5] = 5.0
    assert is_done(actions + 1, observations, report)
    step.close()


def test_all_threads_work_at_the_same_time():
    gate, taken = number(1), number()
    step, given = shared(3, gate=gate, taken=taken), arrays()
    caller = threading.Thread(target=step, args=(None, *given), daemon=True)
    caller.start()
    wait_until(lambda: taken[0] == 3)
    assert caller.is_alive() and np.isnan(given[1]).all()
    set_to(gate, 0)
    caller.join(DEADLINE)
    assert not caller.is_alive() and is_done(*given)
    step.close()


def test_a_thread_that_has_not_begun_is_not_waited_for():
    step, given = shared(), arrays()
    step.close()  # the only other thread has gone, and never begins
    assert step(None, *given) == ALL_NUMBERS and is_done(*given)


def test_awake_threads_need_no_call(monkeypatch):
    monkeypatch.setattr(shared_step, "LOOKS", 10**9)
    taken = number()
    step = shared(taken=taken)
    step(None, *arrays())
    wait_until(lambda: step._turns[AWAKE, 0] == 1)
    for _ in range(3):
        step(None, *arrays())
        assert step._calls.qsize() == 0 and step._turns[AWAKE, 0] == 1
    step.close()


def test_sleeping_threads_are_called_once(monkeypatch):
    monkeypatch.setattr(shared_step, "LOOKS", 1)
    step = shared(4)
    step.close()
    for _ in range(3):
        step(None, *arrays())
        assert step._calls.qsize() == 3  # more would keep them awake for no step


@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
def test_interruptions_are_raised_once_no_thread_works_any_more():
    gate, taken = number(1), number()
    step, given = shared(gate=gate, taken=taken), arrays()
    signals = signal.SIGALRM, signal.SIGVTALRM

    def interrupt():
        wait_until(lambda: taken[0] == 2)
        for one in signals:  # their handlers wait until the caller is back in Python
            os.kill(os.getpid(), one)
        set_to(gate, 2)
        time.sleep(0.2)
        set_to(gate, 0)

    before = [signal.signal(one, signal.default_int_handler) for one in signals]
    other = threading.Thread(target=interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            other.start()
            step(None, *given)
            pytest.fail("nothing was raised")
    finally:
        for one, handler in zip(signals, before, strict=True):
            signal.signal(one, handler)
    assert gate[0] == 0
    other.join()
    step.close()


@pytest.mark.parametrize("looks", [1, 10**6], ids=["asleep", "awake"])
def test_an_interruption_anywhere_leaves_no_thread_at_work(looks, monkeypatch):
    monkeypatch.setattr(shared_step, "LOOKS", looks)
    step = shared()

    def interrupted_at(place):
        """Return whether there is such a step of the interpreter, before which a signal's handler then raises."""
        left = iter(range(place))

        def trace(frame, event, _):
            if frame.f_code.co_filename != shared_step.__file__:
                return None
            frame.f_trace_opcodes = True
            if event == "opcode" and next(left, None) is None:
                sys.settrace(None)
                raise KeyboardInterrupt
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            step(None, *arrays())
        except KeyboardInterrupt:
            return True
        finally:
            sys.settrace(before)
        return False

    place = 0
    while interrupted_at(place):
        turns = step._turns
        assert turns[NEXT, 0] >= turns[DONE, 0] == turns[GIVEN, SHARES], place
        place += 1
    assert place > 50
    given = arrays()
    step(None, *given)
    assert is_done(*given)
    step.close()


def test_an_interrupted_close_can_be_repeated(monkeypatch):
    step, put = shared(3), shared_step._dismiss
    step(None, *arrays())

    def interrupted(calls, size):
        put(calls, 1)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shared_step, "_dismiss", interrupted)
        step.close()
    step.close()
    assert not any(thread.is_alive() for thread in step._threads)


def test_threads_and_what_they_hold_end_with_their_step():
    taken = number()
    step = shared(3, taken=taken)
    step(None, *arrays())
    threads, kept = step._threads, weakref.ref(taken)
    del step, taken
    gc.collect()
    wait_until(lambda: kept() is None and not any(thread.is_alive() for thread in threads))


def test_waiting_threads_do_not_hold_up_the_end_of_the_process():
    script = (
        "import gymnasium as gym, numpy as np, amulett_gym\n"
        "env = gym.make_vec('Amulett/Scaling-v0', num_envs=64, threads=3); env.reset(seed=0)\n"
        "env.step(np.zeros((64, 1)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=10 * DEADLINE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("blocks", [1, 2, 7, 128, 1000])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_shares_are_all_blocks_and_become_smaller(blocks, threads):
    turns = turns_of(blocks, threads)
    count = turns[GIVEN, SHARES]
    begins = turns[-1, : count + 1]
    assert begins[0] == 0 and begins[-1] == blocks
    sizes = np.diff(begins)
    assert (sizes > 0).all() and (np.diff(sizes[:-1]) <= 0).all()
    assert first_share(turns, 3) == (0, 0) and withdraw(turns, 1)


def test_what_is_withdrawn_is_left_to_nobody():
    turns = turns_of(BLOCKS, 2)
    count = turns[GIVEN, SHARES]
    turns[NEXT, 0] = turns[DONE, 0] = 0
    assert first_share(turns, 1) == tuple(turns[-1, :2])
    assert not withdraw(turns, 100)  # that share is not done
    assert first_share(turns, 100) == (0, 0)
    turns[DONE, 0] += 1
    assert withdraw(turns, 1) and turns[DONE, 0] == count
