"""The frames, in Python and in C."""

from __future__ import annotations

import ctypes
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import amulett_gym
from amulett_gym.c.build import find_compiler
from amulett_gym.errors import AmulettError
from amulett_gym.firmware.protocol import (
    MOST,
    VERSION,
    BoardError,
    Decoder,
    Frame,
    Hello,
    Wire,
    code,
    crc,
    read_hello,
    stuff,
    unstuff,
)

C = Path(amulett_gym.__file__).parent / "c"
CONTENT = st.binary(max_size=MOST - 4)
few = settings(max_examples=40, deadline=None)


def test_crc_has_the_catalogues_check_value():
    assert crc(b"123456789") == 0x29B1


@few
@given(st.binary(max_size=253))
def test_stuffing_leaves_no_zero_and_is_undone(data: bytes):
    coded = stuff(data)
    assert b"\0" not in coded
    assert unstuff(coded) == data


@pytest.mark.parametrize("coded", [b"\0", b"\x05ab", b"\x02"])
def test_what_is_no_code_is_none(coded: bytes):
    assert unstuff(coded) is None


@few
@given(CONTENT, st.integers(0, 255), st.lists(st.integers(1, 200), max_size=3))
def test_a_frame_survives_any_cut(content: bytes, sequence: int, cuts: list[int]):
    decoder, coded = Decoder(), code(3, sequence, content)
    found, begin = [], 0
    for end in [*sorted(cuts), len(coded)]:
        found += decoder.feed(coded[begin:end])
        begin = max(begin, end)
    assert found == [Frame(3, sequence, content)]


@few
@given(CONTENT, st.data())
def test_a_changed_byte_is_noticed_and_the_next_frame_found(content: bytes, data: st.DataObject):
    coded = bytearray(code(3, 7, content))
    place = data.draw(st.integers(0, len(coded) - 2))
    coded[place] ^= data.draw(st.integers(1, 255))
    decoder = Decoder()
    found = decoder.feed(bytes(coded) + b"\0" + code(4, 8, b"next"))
    assert found == [Frame(4, 8, b"next")]
    assert decoder.garbled >= 1


def test_a_frame_that_is_too_long_is_refused():
    with pytest.raises(AmulettError, match="124 bytes of content; this has 125"):
        code(1, 0, bytes(125))


def test_endless_noise_fills_no_memory():
    decoder = Decoder()
    for _ in range(100):
        decoder.feed(b"\x01" * 1000)
    assert len(decoder._rest) <= MOST + 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (bytes([VERSION + 1]) + bytes(13), f"version {VERSION + 1} of the protocol; this amulett-gym speaks {VERSION}"),
        (b"", "HELLO has 0 bytes; 14 are needed"),
        (bytes([VERSION, 5]) + bytes(12), "numbers have 5 bytes"),
    ],
)
def test_a_wrong_hello_is_refused(content: bytes, message: str):
    with pytest.raises(BoardError, match=message):
        read_hello(content)


def test_a_report_that_is_too_short_is_refused():
    with pytest.raises(BoardError, match="report has 3 bytes; 18 are needed"):
        Wire(Hello(1, 4, False, False, 0, 2500, 8)).read_report(b"abc")


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler")
    library = tmp_path_factory.mktemp("protocol") / "protocol.so"
    subprocess.run(
        [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", C / "protocol.c", "-o", library],
        check=True,
    )
    return ctypes.CDLL(str(library))


def receive_in_c(in_c: ctypes.CDLL, data: bytes) -> list[bytes | None]:
    """Return the frames without CRC that C finds in `data`, None for each broken one."""
    reader, found = ctypes.create_string_buffer(MOST + 3), []
    in_c.protocol_receive.restype = ctypes.c_int16
    for byte in data:
        length = in_c.protocol_receive(reader, ctypes.c_uint8(byte))
        if length:
            found.append(reader.raw[:length] if length > 0 else None)
    return found


def test_c_and_python_code_alike(in_c: ctypes.CDLL):
    draw = np.random.default_rng(1)
    for size in range(MOST - 3):
        content = draw.choice([0, 1, 255, 17], size).astype(np.uint8).tobytes()
        coded = ctypes.create_string_buffer(MOST + 2)
        count = in_c.protocol_code(3, size, content, size, coded)
        assert coded.raw[:count] == code(3, size, content)
        assert receive_in_c(in_c, coded.raw[:count]) == [bytes([3, size]) + content]


def test_c_and_python_find_the_same_frames_in_noise(in_c: ctypes.CDLL):
    draw = np.random.default_rng(2)
    data = b""
    for k in range(200):
        data += draw.choice(256, draw.integers(0, 300)).astype(np.uint8).tobytes() * (k % 3 == 0)
        data += code(3, k, draw.choice(256, draw.integers(0, 60)).astype(np.uint8).tobytes())
    decoder = Decoder()
    expected = [bytes([frame.kind, frame.sequence]) + frame.content for frame in decoder.feed(data)]
    found = receive_in_c(in_c, data)
    assert [frame for frame in found if frame is not None] == expected
    assert len(expected) > 100
    assert found.count(None) == decoder.garbled


@pytest.mark.parametrize(
    "changes",
    [{"biceps": math.nan}, {"triceps": math.inf}, {"tension": math.nan}, {"mode": 9}, {"reason": 200}, {"agonist": 3}],
)
def test_a_report_of_what_cannot_be_is_refused(changes: dict[str, float]):
    wire = Wire(Hello(VERSION, 4, False, False, 1, 2500, 8))
    good = {
        "biceps": 1.0,
        "triceps": -1.0,
        "tension": 5.0,
        "agonist": 1,
        "status": 0,
        "mode": 1,
        "reason": 0,
        "cycles": 9,
    }
    assert wire.read_report(wire.report.pack(*good.values())).cycles == 9
    with pytest.raises(BoardError, match="the board's report holds"):
        wire.read_report(wire.report.pack(*{**good, **changes}.values()))
