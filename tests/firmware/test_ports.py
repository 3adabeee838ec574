"""The board's program on this computer, over pipes and over a pseudo-terminal that plays a real board's serial port."""

from __future__ import annotations

import json
import math
import os
import pty
import subprocess
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from firmware.boards import BEGIN, stub_folder

from amulett_gym.c.build import find_compiler
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import HardwareEnv
from amulett_gym.firmware.board import Board
from amulett_gym.firmware.ports import ProcessPort, SerialPort
from amulett_gym.firmware.protocol import ERROR, HELLO, REPLY, SAMPLE, VERSION, BoardError, Decoder, code
from amulett_gym.firmware.toolchain import build_board

pytest.importorskip("serial", reason="pyserial is missing (the extra 'board')")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if find_compiler() is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("stub")
    return build_board(stub_folder(folder), folder / "build")


@pytest.fixture
def real_board(program: Path) -> Iterator[tuple[SerialPort, subprocess.Popen[bytes]]]:
    """Start a board behind a pseudo-terminal: its port, and its process."""
    near, far = pty.openpty()
    tty.setraw(far)
    process = subprocess.Popen([program], stdin=near, stdout=near)
    os.close(near)
    port = SerialPort(os.ttyname(far), timeout=0.2)
    os.close(far)
    yield port, process
    port.close()
    process.kill()
    process.wait()


Answer = Callable[[int, int, bytes], bytes]


@pytest.fixture
def scripted() -> Iterator[Callable[[Answer], SerialPort]]:
    """Open a pseudo-terminal behind which a function answers: kind, sequence number, content -> bytes."""
    opened: list[tuple[int, SerialPort, threading.Thread]] = []

    def open_port(answer: Answer) -> SerialPort:
        near, far = pty.openpty()
        tty.setraw(far)

        def serve() -> None:
            decoder = Decoder()
            while True:
                try:
                    data = os.read(near, 4096)
                    for frame in decoder.feed(data):
                        os.write(near, answer(frame.kind, frame.sequence, frame.content))
                except OSError:
                    return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        port = SerialPort(os.ttyname(far), timeout=0.02)
        port.hello_tries = 3
        os.close(far)
        opened.append((near, port, thread))
        return port

    yield open_port
    for near, port, thread in opened:
        port.close()
        thread.join(1.0)
        os.close(near)


def hello(sequence: int) -> bytes:
    content = bytes([VERSION, 4, 0, 0]) + (7).to_bytes(4, "little") + (2500).to_bytes(4, "little") + b"\x08\0"
    return code(REPLY | HELLO, sequence, content)


def test_pipe_and_terminal_give_the_same(program: Path, real_board):
    def play(board: Board) -> list[object]:
        board.start(BEGIN, 1)
        return [board.tick(k, 10, 20, 0.5, 0.0, 0) for k in range(30)]

    pipe = Board(ProcessPort(program))
    expected = play(pipe)
    pipe.close()
    assert play(Board(real_board[0])) == expected


def test_a_killed_board_is_gone(real_board):
    port, process = real_board
    board = Board(port)
    board.start(BEGIN, 1)
    process.kill()
    process.wait()
    with pytest.raises(BoardError, match=r"^the board on /dev/\S+ is gone: .+$") as caught:
        board.tick(0, 0, 0, 0.0, 0.0, 0)
    assert "\n" not in str(caught.value)


def test_a_killed_program_is_gone(program: Path):
    port = ProcessPort(program)
    board = Board(port)
    port._process.kill()
    port._process.wait()
    with pytest.raises(BoardError, match="the board on the host is gone: "):
        board.read()
    port.close()


def test_a_stopped_board_is_silent(real_board):
    port, process = real_board
    board = Board(port)
    process.send_signal(19)  # SIGSTOP
    with pytest.raises(BoardError, match="failed 3 times in turn: it was silent"):
        board.read()
    process.send_signal(18)  # SIGCONT
    assert board.read().mode == 0  # late answers to the earlier requests are not taken for this one's


def test_an_empty_line_is_silent(scripted):
    with pytest.raises(BoardError, match="failed 3 times in turn: it was silent"):
        Board(scripted(lambda kind, sequence, content: b""))


def test_another_version_is_named(scripted):
    def newer(kind: int, sequence: int, content: bytes) -> bytes:
        return code(REPLY | HELLO, sequence, bytes([VERSION + 1]) + bytes(13))

    with pytest.raises(BoardError, match=f"version {VERSION + 1} of the protocol; this amulett-gym speaks {VERSION}"):
        Board(scripted(newer))

    def refusing(kind: int, sequence: int, content: bytes) -> bytes:
        return code(ERROR, sequence, bytes([2]))

    with pytest.raises(BoardError, match="refuses: it speaks another version of the protocol"):
        Board(scripted(refusing))


def test_noise_instead_of_answers_is_reported(scripted):
    with pytest.raises(BoardError, match="failed 3 times in turn: its answer was broken"):
        Board(scripted(lambda kind, sequence, content: b"garbage\0"))


def test_a_full_buffer_is_reported(scripted):
    def full(kind: int, sequence: int, content: bytes) -> bytes:
        return hello(sequence) if kind == HELLO else code(ERROR, sequence, bytes([3]))

    board = Board(scripted(full))
    with pytest.raises(BoardError, match="failed 3 times in turn: its receive buffer was full, so bytes are lost"):
        board.read()


def test_zeros_before_an_answer_do_no_harm(scripted):
    board = Board(scripted(lambda kind, sequence, content: b"\0\0" + hello(sequence)))
    assert board.hello.firmware_id == 7
    assert board.retries == 0


def test_a_port_that_cannot_be_opened_is_named(tmp_path: Path):
    with pytest.raises(AmulettError, match="the serial port '.*none' cannot be opened"):
        SerialPort(str(tmp_path / "none"))


def test_answers_to_something_else_do_not_go_on_for_ever(scripted):
    def babbling(kind: int, sequence: int, content: bytes) -> bytes:
        return code(REPLY | kind, sequence + 1) * 100 if kind != HELLO else hello(sequence)

    board = Board(scripted(babbling))
    with pytest.raises(BoardError, match="failed 3 times in turn: what it sends is no answer"):
        board.read()


class Closing:
    """A line on which nothing answers."""

    label, hello_tries, closed = "a line", 2, False

    def send(self, data: bytes) -> None:
        pass

    def receive(self) -> bytes:
        return b""

    def close(self) -> None:
        self.closed = True


def test_a_line_without_a_board_is_closed():
    port = Closing()
    with pytest.raises(BoardError, match="the board on a line failed 2 times in turn: it was silent"):
        Board(port)
    assert port.closed


def test_bytes_of_an_earlier_host_do_no_harm(real_board):
    port, _ = real_board
    board = Board(port)
    board.start(BEGIN, 1)
    expected = board.tick(5, 10, 20, 0.5, 0.0, 0)
    port.send(code(1, 200, bytes([VERSION]))[:-2])  # it was killed in the middle of a frame
    board = Board(port)
    board.start(BEGIN, 1)
    assert board.tick(5, 10, 20, 0.5, 0.0, 0) == expected


def test_noise_on_the_line_stops_nothing(program: Path):
    """Random bytes and changed frames: the board stays, does no tick for them, and its numbers are finite."""
    random = np.random.default_rng(0)
    port = ProcessPort(program)
    board = Board(port)
    board.start(BEGIN, 1)
    content = board._wire.sample.pack(3000, 10, 20, 1.5, 0.0, 0)
    for k in range(200):
        noise = bytearray(random.bytes(int(random.integers(1, 300))).replace(b"\0", b""))  # is refused once
        if k % 2:
            noise = bytearray(code(SAMPLE, (board._sequence + 1) % 256, content))
            noise[int(random.integers(len(noise) - 1))] ^= 1 << int(random.integers(8))
        port.send(bytes(noise))
        report = board.tick(k, 10, 20, 0.5, 0.0, 0)
        change = 2.0 * (0.5 - k * 2.0 * math.pi / 2**14)
        assert report.commands == pytest.approx((1.0 + change, -1.0 + change), abs=1e-5)
        assert (report.mode, report.status) == (1, 0)
    assert board.retries >= 100
    board.close()


def test_without_pyserial_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(AmulettError, match=r"a serial port needs pyserial: pip install .*\[board\]") as caught:
        SerialPort("/dev/ttyACM0")
    assert "\n" not in str(caught.value)


@pytest.fixture
def exported(firmware) -> Iterator[tuple[Path, str, subprocess.Popen[bytes]]]:
    """Start a firmware behind a pseudo-terminal: its folder, the terminal's name, and its process."""
    folder = firmware("eq6").folder
    near, far = pty.openpty()
    tty.setraw(far)
    process = subprocess.Popen([build_board(folder, folder / "build")], stdin=near, stdout=near)
    os.close(near)
    yield folder, os.ttyname(far), process
    os.close(far)
    process.kill()
    process.wait()


HIL = ["--suite", "steps", "--episodes", "1", "--duration", "0.2"]


def test_a_firmware_behind_a_serial_port_does_what_it_does_here(exported, capsys: pytest.CaptureFixture[str]):
    folder, path, process = exported
    words = ["hil", str(folder), *HIL, "--transport", "host-float", f"serial:{path}"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["results"]
    assert found[f"serial:{path}"]["costs"] == found["host-float"]["costs"]
    process.kill()
    process.wait()
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"amulett: error: the serial port '{path}' cannot be opened: ")
    assert error.count("\n") == 1


def test_an_environment_whose_board_is_killed_says_so_and_closes(exported):
    folder, path, process = exported
    with HardwareEnv(folder, f"serial:{path}") as env:
        env.reset(seed=0)
        env.step(np.zeros(1))
        process.kill()
        process.wait()
        for act in (lambda: env.step(np.zeros(1)), lambda: env.reset(seed=1)):
            with pytest.raises(BoardError, match=f"^the board on {path} is gone: "):
                act()
    env.close()
