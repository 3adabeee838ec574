"""The board's program on a simulated ATmega2560, with a stub for the controller."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from firmware.boards import BEGIN, hex_or_skip

from amulett_gym.errors import AmulettError
from amulett_gym.firmware.board import Board
from amulett_gym.firmware.chip import Chip
from amulett_gym.firmware.protocol import ERROR, HELLO, SAMPLE, BoardError, Decoder, code

LETTING_GO, SLACK, BAD_SENSOR = 8, 16, 2
RATE, PERIOD = 2.0, 0.0025
SILENCE, SENSOR, WATCHDOG = 3, 2, 4
HANG, NO_NUMBER = 77.0, 78.0
"""Setpoints with which the stub fails."""


@pytest.fixture(scope="module")
def hex_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hex_or_skip(tmp_path_factory.mktemp("stub"))


@pytest.fixture
def chip(hex_file: Path) -> Iterator[Chip]:
    chip = Chip(hex_file)
    yield chip
    chip.close()


@pytest.fixture
def board(chip: Chip) -> Board:
    board = Board(chip)
    board.start(BEGIN, 1)
    return board


def sample(board: Board, encoder: int = 100, setpoint: float = 0.5, flags: int = 0):
    return board.tick(encoder, 10, 20, setpoint, 0.0, flags)


def test_the_chip_says_what_it_is(board: Board):
    hello = board.hello
    assert (hello.real_size, hello.exact_encoder, hello.firmware_id) == (4, False, 0x12345678)
    assert (hello.period_us, hello.law_ticks) == (2500, 8)


def test_a_sample_is_one_tick_of_the_controller(board: Board, chip: Chip):
    report = sample(board)
    error = 0.5 - 100 * 2.0 * math.pi / 2**14
    assert report.commands == pytest.approx((1.0 + 2.0 * error, -1.0 + 2.0 * error), abs=1e-6)
    assert (report.status, report.mode, report.agonist, report.tension_setpoint) == (0, 1, 1, 0.5)
    assert board.read() == report
    assert chip.measure().ticks == 1


def test_cycles_are_measured_inside_and_outside(board: Board, chip: Chip):
    inside = [sample(board).cycles for _ in range(5)]
    found = chip.measure()
    assert found.ticks == 5
    assert min(inside) <= found.mean <= found.most
    assert 500 < found.most < 2000
    assert abs(found.last - inside[-1]) < 100  # reading the clock, setting the pin, perhaps an interrupt


def test_memory_is_measured(board: Board, chip: Chip):
    sample(board)
    found = chip.measure()
    assert 3000 < found.flash < 20_000
    assert 400 < found.static < 2000
    assert 50 < found.stack < 1000
    assert found.memory == found.static + found.stack


def test_a_request_that_comes_again_ticks_once(board: Board, chip: Chip):
    first = sample(board)
    content = board._wire.sample.pack(3000, 10, 20, 0.5, 0.0, 0)
    chip.send(code(SAMPLE, board._sequence, content))  # the same number
    [again] = Decoder().feed(chip.receive())
    assert board._wire.read_report(again.content) == first
    assert chip.measure().ticks == 1


def test_a_skipped_number_is_refused(board: Board):
    board._sequence += 1
    with pytest.raises(BoardError, match="no request may be skipped"):
        sample(board)


def test_a_sample_before_the_start_is_refused(chip: Chip):
    with pytest.raises(BoardError, match="ATmega2560 refuses: .* an episode has to be started first"):
        sample(Board(chip))


def test_a_begin_that_is_not_finite_is_refused(chip: Chip):
    for wrong in (math.nan, math.inf):
        with pytest.raises(BoardError, match="a number is not finite"):
            Board(chip).start([*BEGIN[:-1], wrong], 1)
    with pytest.raises(BoardError, match="the agonist is none"):
        Board(chip).start(BEGIN, 0)


def test_another_version_is_refused(chip: Chip):
    chip.send(code(HELLO, 9, bytes([77])))
    [answer] = Decoder().feed(chip.receive())
    assert (answer.kind, answer.sequence, answer.content) == (ERROR, 9, bytes([2]))


class Noisy:
    """A line that changes a byte of some messages."""

    label, hello_tries = "a bad line", 3

    def __init__(self, chip: Chip, sent: int, received: int) -> None:
        self.chip, self.every, self.count = chip, {"sent": sent, "received": received}, {"sent": 0, "received": 0}

    def spoil(self, way: str, data: bytes) -> bytes:
        self.count[way] += 1
        if self.count[way] % self.every[way] or len(data) < 5:
            return data
        return data[:3] + bytes([data[3] ^ 0x10 or 1]) + data[4:]

    def send(self, data: bytes) -> None:
        self.chip.send(self.spoil("sent", data))

    def receive(self) -> bytes:
        return self.spoil("received", self.chip.receive())

    def close(self) -> None:
        self.chip.close()


def test_broken_frames_both_ways_change_nothing(hex_file: Path):
    def play(every: tuple[int, int]) -> tuple[list[object], Board, int]:
        chip = Chip(hex_file)
        board = Board(Noisy(chip, *every))
        board.start(BEGIN, 1)
        reports = [sample(board, encoder=k).commands for k in range(60)]
        ticks = chip.measure().ticks
        chip.close()
        return reports, board, ticks

    clean, _, _ = play((10**9, 10**9))
    noisy, board, ticks = play((7, 5))
    assert noisy == clean
    assert ticks == 60
    assert board.retries > 10


def test_a_line_that_breaks_all_frames_is_reported(hex_file: Path):
    chip = Chip(hex_file)
    board = Board(Noisy(chip, 10**9, 10**9))
    board.port.every["sent"] = 1
    with pytest.raises(BoardError, match="on a bad line failed 3 times in turn: it received a broken frame"):
        board.read()
    board.port.every = {"sent": 10**9, "received": 1}
    with pytest.raises(BoardError, match="on a bad line failed 3 times in turn: its answer was broken"):
        board.read()
    chip.close()


def test_a_full_buffer_is_reported_and_the_board_goes_on(board: Board, chip: Chip):
    sample(board)
    chip.send(b"\x01\0" * 500)  # each is answered by more bytes than it has: the answers fill up first
    answers = Decoder().feed(chip.wait(0.1))
    assert {answer.content[0] for answer in answers if answer.kind == ERROR} == {1, 3}
    assert sample(board).status == 0


def test_an_unread_flood_for_the_line_is_refused(chip: Chip):
    with pytest.raises(OSError, match="4096 bytes wait"):
        chip.send(bytes(5000))


def test_a_silent_host_lets_the_strings_go_at_a_bounded_rate(board: Board, chip: Chip):
    apart = [2.0]
    sample(board, encoder=0, setpoint=0.0)
    chip.wait(0.9)
    assert board.read().mode == 1
    chip.wait(1.01)
    for _ in range(60):
        report = board.read()
        apart.append(report.commands[0] - report.commands[1])
        chip.wait(0.01)
    steps = [before - after for before, after in pairwise(apart[1:])]
    assert (report.mode, report.reason) == (3, SILENCE)
    assert report.status & (LETTING_GO | SLACK) == LETTING_GO | SLACK
    assert apart[-1] == pytest.approx(0.0, abs=1e-6)
    # Both strings, over the 4 to 5 periods from one reading to the next.
    assert max(steps) <= 2.0 * RATE * PERIOD * 5 + 1e-6
    assert min(steps) >= 0.0
    assert sample(board).mode == 3  # a sample does not wind them again
    board.start(BEGIN, 1)
    assert sample(board).mode == 1


def test_a_bad_reading_lets_the_strings_go_sample_by_sample(board: Board, chip: Chip):
    sample(board)
    report = sample(board, encoder=9000)
    assert (report.mode, report.reason) == (3, SENSOR)
    assert report.status & BAD_SENSOR
    apart = report.commands[0] - report.commands[1]
    for _ in range(10):
        report = sample(board)  # good again; it stays with letting go
        now = report.commands[0] - report.commands[1]
        assert apart - now == pytest.approx(2.0 * RATE * PERIOD, rel=1e-4)
        apart = now
    chip.wait(0.1)  # periods pass, but the simulation's time does not
    assert board.read().commands == report.commands


def test_stop_lets_the_strings_go(board: Board):
    sample(board)
    report = board.stop()
    assert (report.mode, report.reason) == (3, 1)
    assert sample(board).commands < report.commands


def test_a_chip_without_sensors_does_not_run_alone(chip: Chip):
    board = Board(chip)
    with pytest.raises(BoardError, match="its own sensors do not answer"):
        board.run()


@pytest.fixture
def running(chip: Chip) -> Board:
    """Start a board that runs by its own sensors, at the joint angle of 100 counts."""
    chip.set_sensors(100, 200, 300)
    board = Board(chip)
    board.run()
    return board


def angle(pulse: float) -> float:
    """Return the command [rad] of a servo pulse [microseconds]."""
    return (pulse - 1500.0) / 600.0 * 4.0 * math.pi


def test_the_board_runs_by_its_own_timer_and_sensors(running: Board, chip: Chip):
    chip.restart_measuring()
    chip.wait(0.1)
    report, readings = running.follow(0.2)
    assert readings == (100, 200, 300)
    assert (report.mode, report.reason, report.status) == (2, 0, 0)
    assert 39 <= chip.measure().ticks <= 41  # one in each control period
    chip.set_sensors(-50, 200, 300)  # the encoder counts on beyond 0
    chip.wait(0.01)
    report, readings = running.follow(0.2)
    assert readings == (-50, 200, 300)
    change = 2.0 * (0.2 + 50 * 2.0 * math.pi / 2**14)
    assert report.commands == pytest.approx((1.0 + change, -1.0 + change), abs=1e-5)
    pulses = chip.pulses()
    assert pulses is not None
    assert [angle(pulse) for pulse in pulses] == pytest.approx(report.commands, abs=0.011)  # half a microsecond


def test_in_lock_step_the_drives_get_no_pulses(board: Board, chip: Chip):
    sample(board)
    chip.wait(0.05)
    assert chip.pulses() is None


@pytest.mark.parametrize("setpoint", [math.nan, math.inf, 100.5, -100.5])
def test_a_setpoint_that_cannot_be_followed_is_refused(running: Board, chip: Chip, setpoint: float):
    chip.wait(0.01)
    before = running.read().commands
    with pytest.raises(BoardError, match="a number is not finite, a goal is beyond the joint's limits"):
        running.follow(setpoint)
    chip.wait(0.01)
    assert running.read().commands == before


def slack_in(board: Board, chip: Chip) -> None:
    """Wait until the strings are slack; the pulses have met at the bounded rate."""
    apart = []
    while not apart or not board.read().status & SLACK:
        pulses = chip.pulses()
        assert pulses is not None
        apart.append(angle(pulses[0]) - angle(pulses[1]))
        assert len(apart) < 200
        chip.wait(0.01)
    steps = [before - after for before, after in pairwise(apart)]
    assert apart[0] > 1.0
    assert apart[-1] == pytest.approx(0.0, abs=0.06)
    assert max(steps) <= 2.0 * RATE * PERIOD * 5 + 0.022
    assert min(steps) >= -0.022


@pytest.mark.parametrize("cause", ["encoder", "silence", "stop", "reset"])
def test_a_running_board_lets_the_strings_go(hex_file: Path, cause: str):
    chip = Chip(hex_file)
    chip.set_sensors(0, 200, 300)
    board = Board(chip)
    board.run()
    chip.wait(0.02)
    if cause == "encoder":
        chip.set_sensors(None, 200, 300)
        chip.wait(0.03)
        assert board.read().reason == SENSOR
    elif cause == "silence":
        chip.wait(1.1)
        assert board.read().reason == SILENCE
    elif cause == "stop":
        board.stop()
    else:
        chip.reset()
        board = Board(chip)
        assert board.read().reason == 4
    assert board.read().mode == 3
    slack_in(board, chip)
    chip.set_sensors(0, 200, 300)
    assert board.run().mode == 2  # it can begin anew
    chip.close()


def test_a_program_that_hangs_is_reset_and_lets_the_strings_go(running: Board, chip: Chip):
    chip.wait(0.02)
    running.follow(HANG)
    before = chip.pulses()
    chip.wait(0.01)
    with pytest.raises(BoardError, match="on the simulated ATmega2560 (refuses|failed 3 times in turn)") as caught:
        running.read()
    assert "\n" not in str(caught.value)
    board = Board(chip)
    report = board.read()
    assert (report.mode, report.reason) == (3, WATCHDOG)
    assert report.commands[0] - report.commands[1] <= angle(before[0]) - angle(before[1]) + 0.022
    slack_in(board, chip)
    assert board.run().mode == 2


def test_a_program_that_hangs_in_lock_step_begins_anew(board: Board, chip: Chip):
    sample(board)
    with pytest.raises(BoardError, match="an episode has to be started first"):
        sample(board, setpoint=HANG)
    board.start(BEGIN, 1)
    assert (sample(board).mode, sample(board).status) == (1, 0)
    assert chip.pulses() is None


def test_numbers_that_are_not_finite_any_more_let_the_strings_go(board: Board, chip: Chip):
    last = sample(board).commands
    report = sample(board, setpoint=NO_NUMBER)
    assert (report.mode, report.reason, report.commands) == (3, 5, last)
    after = sample(board).commands
    apart = [commands[0] - commands[1] for commands in (last, after)]
    assert apart[0] - apart[1] == pytest.approx(2.0 * RATE * PERIOD, rel=1e-4)


def test_running_numbers_that_are_not_finite_any_more_let_the_strings_go(running: Board, chip: Chip):
    running.follow(NO_NUMBER)
    chip.wait(0.01)
    assert (running.read().mode, running.read().reason) == (3, 5)
    slack_in(running, chip)


def test_a_closed_chip_is_gone(board: Board, chip: Chip):
    chip.close()
    with pytest.raises(BoardError, match="the board on the simulated ATmega2560 is gone: it is closed"):
        board.read()


def test_a_file_that_is_no_program_is_refused(hex_file: Path, tmp_path: Path):
    (tmp_path / "x.hex").write_text("not a hex file\n")
    for name in ("x.hex", "none.hex"):
        with pytest.raises(AmulettError, match=f"{name}' is no program for the ATmega2560"):
            Chip(tmp_path / name)
