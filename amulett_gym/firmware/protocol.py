"""Frames between host and board; `c/protocol.h` has the same names and numbers.

A frame is kind, sequence number, content, and the CRC-16/IBM-3740 of these three, low byte first; coded by COBS, so
that it has no zero, and ended by a zero. After a broken frame, both ends find the begin of the next one at the next
zero; zeros between frames are allowed. Numbers are little endian.

Only the host asks. It numbers its requests from 0 to 255 and again; the board repeats the number in its answer. An
answer that is broken or does not come in time is asked for again with the same number: the board then repeats its last
answer, so that a control tick is never done twice. A number that is skipped is refused. The board answers what it
cannot use by a frame ERROR with a `FAULTS` code. HELLO alone is valid with any number, and names the version.

====== ============================================== =========================================================
Kind   Request                                        Answer (kind + 128)
====== ============================================== =========================================================
HELLO  version                                        :class:`Hello`
START  begin of an episode: reals, then the agonist   empty; lock step begins
SAMPLE encoder, sliders, setpoint, jump, flags        :class:`Report`, after one control tick
STOP   empty                                          :class:`Report`; the board lets the strings go
READ   empty                                          :class:`Report`, without a tick
RUN    empty                                          :class:`Report`; the board runs by its own timer and sensors
GOAL   setpoint [rad] for that                        :class:`Report` and the board's readings
====== ============================================== =========================================================
"""

from __future__ import annotations

import binascii
import math
import struct
from dataclasses import dataclass, field

from amulett_gym.errors import AmulettError

VERSION = 1
MOST = 128
"""Bytes of a frame before coding."""

HELLO, START, SAMPLE, STOP, READ, RUN, GOAL = range(1, 8)
REPLY, ERROR = 0x80, 0xFF

FAULTS = {
    1: "it received a broken frame",
    2: "it speaks another version of the protocol",
    3: "its receive buffer was full, so bytes are lost",
    4: "the request does not fit what it is doing: an episode has to be started first, and no request may be skipped",
    5: "it does not know this kind of request",
    6: "a number is not finite, a goal is beyond the joint's limits, or the agonist is none",
    7: "its own sensors do not answer, or its drives have no limit",
}
"""Codes of an ERROR, and what they mean."""

MODES = ("idle", "lock step", "runs by its own sensors", "lets the strings go")
REASONS = (
    "",
    "the host asked for it",
    "a sensor's reading was out of its range or missing",
    "the host was silent",
    "the board was reset while its drives were on",
    "the controller's numbers were not finite",
)
"""Why the strings are let go."""


class BoardError(AmulettError):
    """The board does not do what it should: it is gone, silent, of another version, or refuses."""


@dataclass(frozen=True)
class Frame:
    """A sound frame."""

    kind: int
    sequence: int
    content: bytes


def crc(data: bytes) -> int:
    """Return the CRC-16/IBM-3740: polynomial 0x1021, begin 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


def stuff(data: bytes) -> bytes:
    """Return `data`, of at most 253 bytes, coded by COBS."""
    return b"".join(bytes([len(part) + 1]) + part for part in data.split(b"\0"))


def unstuff(coded: bytes) -> bytes | None:
    """Return what `stuff` has coded, or None if it is no such code."""
    parts, place = [], 0
    while place < len(coded):
        end = place + coded[place]
        if coded[place] == 0 or end > len(coded):
            return None
        parts.append(coded[place + 1 : end])
        place = end
    return b"\0".join(parts)


def code(kind: int, sequence: int, content: bytes = b"") -> bytes:
    """Return a coded frame with its zero."""
    frame = bytes([kind, sequence]) + content
    if len(frame) + 2 > MOST:
        raise AmulettError(f"a frame may have {MOST - 4} bytes of content; this has {len(content)}")
    return stuff(frame + struct.pack("<H", crc(frame))) + b"\0"


@dataclass
class Decoder:
    """Finds the frames in received bytes.

    Attributes
    ----------
    garbled : int
        Number of broken frames so far.
    """

    garbled: int = 0
    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[Frame]:
        """Take received bytes; return the sound frames that they end."""
        *ended, rest = (self._rest + data).split(b"\0")
        self._rest = bytearray(rest[: MOST + 2])  # no frame is longer: what is cut is broken anyway
        found = []
        for coded in filter(None, ended):
            frame = unstuff(bytes(coded))
            if frame is None or len(frame) < 4 or crc(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
                self.garbled += 1
            else:
                found.append(Frame(frame[0], frame[1], frame[2:-2]))
        return found


@dataclass(frozen=True)
class Hello:
    """What a board says of itself.

    Attributes
    ----------
    version : int
        Of the protocol.
    real_size : int
        Bytes of the controller's numbers: 4 or 8.
    exact_encoder, exact_sliders : bool
        Whether readings are the values themselves, in the profile's exact sensors, instead of counts.
    firmware_id : int
        CRC-32 of the exported files.
    period_us : int
        Control period [microseconds].
    law_ticks : int
        Control ticks of an agent period.
    """

    version: int
    real_size: int
    exact_encoder: bool
    exact_sliders: bool
    firmware_id: int
    period_us: int
    law_ticks: int


@dataclass(frozen=True)
class Report:
    """The board's state after a request.

    Attributes
    ----------
    commands : tuple of float
        Drive angles: biceps, triceps [rad].
    tension_setpoint : float
        [N]
    agonist : int
        +1: biceps, -1: triceps.
    status : int
        Bits of `controller.h`.
    mode, reason : int
        Indices into `MODES` and `REASONS`.
    cycles : int
        CPU cycles of the last control tick, 0 where nothing counts them.
    """

    commands: tuple[float, float]
    tension_setpoint: float
    agonist: int
    status: int
    mode: int = 1
    reason: int = 0
    cycles: int = 0


class Wire:
    """How a board's numbers are written: by its HELLO."""

    def __init__(self, hello: Hello) -> None:
        real = {4: "f", 8: "d"}[hello.real_size]
        encoder, slider = real if hello.exact_encoder else "i", real if hello.exact_sliders else "i"
        self._real = real
        self.sample = struct.Struct(f"<{encoder}2{slider}2{real}B")
        self.report = struct.Struct(f"<3{real}bBBBH")
        self.goal = struct.Struct(f"<{real}")
        self._readings = struct.Struct(f"<{encoder}2{slider}")

    def read_report(self, content: bytes) -> Report:
        """Return the report at the begin of an answer; BoardError if it is too short, or holds what cannot be."""
        if len(content) < self.report.size:
            raise BoardError(f"the board's report has {len(content)} bytes; {self.report.size} are needed")
        biceps, triceps, tension, agonist, status, mode, reason, cycles = self.report.unpack_from(content)
        if not all(map(math.isfinite, (biceps, triceps, tension))):
            raise BoardError("the board's report holds a command or a tension that is not finite")
        if agonist not in (-1, 1, 0) or mode >= len(MODES) or reason >= len(REASONS):
            raise BoardError(
                f"the board's report holds agonist {agonist}, mode {mode}, reason {reason}; one is unknown"
            )
        return Report((biceps, triceps), tension, agonist, status, mode, reason, cycles)

    def read_readings(self, content: bytes) -> tuple[float, float, float]:
        """Return encoder and sliders at the end of an answer to a GOAL; BoardError if it is too short."""
        if len(content) < self.report.size + self._readings.size:
            raise BoardError(f"the board's readings have {len(content) - self.report.size} bytes")
        encoder, biceps, triceps = self._readings.unpack_from(content, self.report.size)
        return encoder, biceps, triceps

    def write_begin(self, numbers: list[float], agonist: int) -> bytes:
        """Return the content of a START."""
        return struct.pack(f"<{len(numbers)}{self._real}b", *numbers, agonist)


_HELLO = struct.Struct("<BB??IIH")


def read_hello(content: bytes) -> Hello:
    """Return a board's HELLO; BoardError if it is none, or of another version."""
    if content[:1] != bytes([VERSION]) and content:
        raise BoardError(f"the board speaks version {content[0]} of the protocol; this amulett-gym speaks {VERSION}")
    if len(content) != _HELLO.size:
        raise BoardError(f"the board's HELLO has {len(content)} bytes; {_HELLO.size} are needed")
    hello = Hello(*_HELLO.unpack(content))
    if hello.real_size not in (4, 8):
        raise BoardError(f"the board's numbers have {hello.real_size} bytes; allowed are 4 and 8")
    return hello
