"""An exported firmware on the simulated chip: its commands stay numbers, and the strings are let go."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from firmware.boards import chip_or_skip

from amulett_gym.firmware.board import Board
from amulett_gym.firmware.device import LET_GO_RATE
from amulett_gym.firmware.host import BAD_SENSOR, BAD_SETPOINT, LETTING_GO, SLACK
from amulett_gym.firmware.loops import BEGIN_FIELDS
from amulett_gym.firmware.protocol import SAMPLE, Report

PERIOD = 0.0025
LETS_GO, SENSOR = 3, 2
STEP = LET_GO_RATE * PERIOD * 1.001
"""By which a command may change in a control period in which the strings are let go [rad]."""


@pytest.fixture(scope="module")
def place(firmware) -> Iterator[tuple[Board, tuple[list[float], int], tuple[float, ...]]]:
    """Open a chip: its board, where an episode begins, and a first reading."""
    made = firmware("eq6")
    recording = made.record(steps=5, num_devices=1)
    with closing(chip_or_skip(made.folder)) as loop, closing(made.controller("float")) as host:
        begin = {name: values[0] for name, values in recording.begin.items()}
        numbers = [float(number) for name in BEGIN_FIELDS[:-1] for number in np.ravel(begin[name])]
        readings = {name: values[:, 0] for name, values in recording.readings.items()}
        encoder, sliders, *_ = host.inputs(readings)[0].tolist()
        yield loop._board, (numbers, int(begin["agonist"])), (encoder, *sliders)


@pytest.fixture
def board(place) -> Board:
    board, begin, _ = place
    board.start(*begin)
    return board


def tick(board: Board, reading: tuple[float, ...], setpoint: float | None = None, jump: float = 0.0) -> Report:
    """Do a tick, by default with the setpoint at the measured angle."""
    if setpoint is None:
        setpoint = reading[0] * 2.0 * math.pi / 2**14
    return board.tick(*reading, setpoint, jump, 0)


def assert_lets_go(board: Board, reading: tuple[float, ...], report: Report) -> None:
    """Both commands go to their mean at the bounded rate, though the readings are good again."""
    mean, last = sum(report.commands) / 2.0, report.commands
    assert report.mode == LETS_GO
    for _ in range(math.ceil(abs(last[0] - mean) / (LET_GO_RATE * PERIOD)) + 1):
        report = tick(board, reading)
        assert report.status & LETTING_GO
        assert max(abs(now - before) for now, before in zip(report.commands, last, strict=True)) <= STEP
        last = report.commands
    assert report.status & SLACK
    assert report.commands == pytest.approx((mean, mean), abs=1e-5)


@pytest.mark.parametrize("field", ["setpoint", "jump"])
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e30])
def test_a_setpoint_that_is_no_angle_is_not_taken(place, board: Board, field: str, wrong: float):
    before = tick(board, place[2])
    report = tick(board, place[2], **{field: wrong})
    assert report.status & BAD_SETPOINT
    assert report.mode == 1
    assert max(abs(now - last) for now, last in zip(report.commands, before.commands, strict=True)) < 0.1
    after = tick(board, place[2])
    assert (after.status, after.mode) == (0, 1)


@pytest.mark.parametrize(
    ("sensor", "wrong"), [(0, 9000), (0, -(2**31)), (1, -1), (1, 1025), (2, 2**31 - 1)], ids=lambda value: str(value)
)
def test_a_reading_out_of_its_range_lets_the_strings_go(place, board: Board, sensor: int, wrong: int):
    before = tick(board, place[2])
    reading = list(place[2])
    reading[sensor] = wrong
    report = tick(board, tuple(reading))
    assert (report.reason, report.commands) == (SENSOR, before.commands)
    assert report.status & BAD_SENSOR
    assert_lets_go(board, place[2], report)


def test_a_silent_host_finds_slack_strings(place, board: Board):
    tick(board, place[2])
    chip = board.port
    chip.wait(1.1)
    report, last = board.read(), None
    while not report.status & SLACK:
        last, periods = report.commands, 7  # at most, from one reading to the next
        chip.wait(5 * PERIOD)
        report = board.read()
        assert max(abs(now - before) for now, before in zip(report.commands, last, strict=True)) <= periods * STEP
    assert last is not None
    assert report.commands[0] == pytest.approx(report.commands[1], abs=1e-5)


def test_whatever_a_sample_holds_the_commands_are_numbers(place):
    """Random bits instead of readings, setpoint, jump and flags, within their frames."""
    board, begin, reading = place
    random, moved = np.random.default_rng(3), 0
    for k in range(150):
        if k % 2:
            board.start(*begin)
        content = bytearray(random.bytes(board._wire.sample.size))
        if k % 2:  # a sound reading, so that the rest is computed with
            content[:12] = board._wire.sample.pack(*reading, 0.0, 0.0, 0)[:12]
        report = board._wire.read_report(board._ask(SAMPLE, bytes(content)))  # refuses numbers that are none
        moved += report.mode == 1
        assert all(abs(command) < 100.0 for command in report.commands)
        assert 0.0 <= report.tension_setpoint <= 20.0
    assert moved > 10
    board.start(*begin)
    assert tick(board, reading).status == 0
