"""Progress is shown on stderr alone: a bar on a terminal, else a plain line now and then."""

from __future__ import annotations

import os
import sys

import pytest

from amulett_gym.reporting import progress
from amulett_gym.reporting.progress import Progress, say


@pytest.fixture
def clock(monkeypatch):
    """Return a list whose only number is the time that `Progress` reads."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_lines_say_what_is_done_and_how_long_the_rest_takes(clock, capsys):
    with Progress(2000, "evaluate", "steps") as shown:
        for _ in range(2000):
            clock[0] += 0.01
            shown.update(note="eq6")
    output, lines = capsys.readouterr()
    assert output == ""
    assert lines.splitlines() == [
        "evaluate: 200 of 2,000 steps (10 %) in 2 s, about 18 s left: eq6",
        "evaluate: 1,200 of 2,000 steps (60 %) in 12 s, about 8 s left: eq6",
    ]


def test_the_estimate_omits_the_time_of_compilation(clock, capsys, monkeypatch):
    compiling = [0.0]
    monkeypatch.setattr(progress, "seconds_compiling", lambda: compiling[0])
    with Progress(100, "evaluate", "steps") as shown:
        clock[0] += 30.5
        compiling[0] += 30.0
        shown.update()
    assert capsys.readouterr().err == "evaluate: 1 of 100 steps (1 %) in 0 s, about 50 s left\n"


def test_work_of_unknown_length_says_what_is_done(clock, capsys):
    with Progress(None, "seed 0") as shown:
        clock[0] += 3
        shown.update()
    assert capsys.readouterr().err == "seed 0: 1, 3 s\n"


@pytest.mark.parametrize(("show", "seconds"), [(True, 1.9), (False, 1000.0)])
def test_short_work_and_quiet_work_show_nothing(show, seconds, clock, capsys):
    with Progress(10, "evaluate", show=show) as shown:
        clock[0] += seconds
        shown.update()
        shown.close()
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "FIRST", 0.0)
    with Progress(10, "evaluate", "steps") as shown:
        shown.update(4, "eq6")
        say("a result")
    output, bar = capsys.readouterr()
    assert output == "a result\n"
    assert "\revaluate" in bar and "4/10" in bar


def test_text_is_wrapped_and_a_command_to_be_copied_is_not(capsys):
    words = "amulett train --resume " + "a/long/folder/" * 4
    say(f"  {words} and more")
    say(words, wrap=False)
    first, second, third = capsys.readouterr().out.splitlines()
    assert (first, second) == ("  amulett train --resume", f"  {words.split()[-1]} and more")
    assert third == words


def test_a_terminal_without_columns_gets_lines(clock, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(sys.stderr, "fileno", lambda: 2, raising=False)
    monkeypatch.setattr(progress.os, "get_terminal_size", lambda file: os.terminal_size((0, 0)))
    with Progress(10, "evaluate", "steps") as shown:
        clock[0] += 3
        shown.update(4)
    assert capsys.readouterr().err == "evaluate: 4 of 10 steps (40 %) in 3 s, about 4 s left\n"


def test_the_estimate_of_resumed_work_is_of_the_rest(clock, capsys):
    with Progress(1000, "training", "steps", done=800) as shown:
        clock[0] += 4
        shown.update(100)
    assert capsys.readouterr().err == "training: 900 of 1,000 steps (90 %) in 4 s, about 4 s left\n"
