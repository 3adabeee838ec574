"""The host's end of the line: requests to a board, their answers, and what went wrong in one line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from amulett_gym.firmware import protocol
from amulett_gym.firmware.protocol import BoardError, Decoder, Hello, Report, Wire, code, read_hello

TRIES = 3
"""How often a request is sent before the board counts as silent."""

_MOST_MESSAGES = 64  # without an answer among them, after a request


class Port(Protocol):
    """A line to a board.

    Attributes
    ----------
    label : str
        For messages.
    hello_tries : int
        How often a board is greeted before it counts as silent: more if it starts when the line is opened.
    """

    label: str
    hello_tries: int

    def send(self, data: bytes) -> None:
        """Send bytes; OSError if the line is gone."""

    def receive(self) -> bytes:
        """Return received bytes, none after the port's timeout; OSError if the line is gone."""

    def close(self) -> None:
        """Close the line."""


class Board:
    """A board on a line.

    Parameters
    ----------
    port : Port

    Attributes
    ----------
    hello : Hello
    retries : int
        Requests that had to be sent again.

    Raises
    ------
    BoardError
        If no board of this protocol's version answers.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.retries = 0
        self._sequence = 0
        self._decoder = Decoder()
        try:
            self.port_send(b"\0")  # ends what an earlier host may have left
            self.hello = self._greet(port.hello_tries)
        except BaseException:
            port.close()
            raise
        self._wire = Wire(self.hello)

    def start(self, numbers: Sequence[float], agonist: int) -> None:
        """Begin an episode in lock step with the numbers of `controller_begin`, in its order."""
        self._greet(TRIES)  # both count from here, whatever has failed before
        self._ask(protocol.START, self._wire.write_begin(list(numbers), agonist))

    def tick(self, encoder: float, biceps: float, triceps: float, setpoint: float, jump: float, flags: int) -> Report:
        """Do one control tick with readings: counts, or [rad] and [m] of exact sensors.

        Raises
        ------
        BoardError
            If the board does not answer, or refuses.
        """
        content = self._wire.sample.pack(encoder, biceps, triceps, setpoint, jump, flags)
        return self._wire.read_report(self._ask(protocol.SAMPLE, content))

    def read(self) -> Report:
        """Return the board's state."""
        return self._wire.read_report(self._ask(protocol.READ))

    def stop(self) -> Report:
        """Let the board let the strings go."""
        return self._wire.read_report(self._ask(protocol.STOP))

    def run(self) -> Report:
        """Let the board run by its own timer and sensors, with its drives."""
        return self._wire.read_report(self._ask(protocol.RUN))

    def follow(self, setpoint: float) -> tuple[Report, tuple[float, float, float]]:
        """Set the joint angle that a running board follows [rad]; return its state and last readings.

        The readings are those of encoder and sliders, biceps first: counts, or [rad] and [m] of exact sensors.
        """
        answer = self._ask(protocol.GOAL, self._wire.goal.pack(setpoint))
        return self._wire.read_report(answer), self._wire.read_readings(answer)

    def close(self) -> None:
        """Close the line."""
        self.port.close()

    def port_send(self, data: bytes) -> None:
        """Send bytes; BoardError if the board is gone."""
        try:
            self.port.send(data)
        except OSError as error:
            raise BoardError(f"the board on {self.port.label} is gone: {_first_line(error)}") from None

    def _greet(self, tries: int) -> Hello:
        return read_hello(self._ask(protocol.HELLO, bytes([protocol.VERSION]), tries))

    def _ask(self, kind: int, content: bytes = b"", tries: int = TRIES) -> bytes:
        """Send a request until it is answered, at most `tries` times; return the answer's content."""
        self._sequence = (self._sequence + 1) % 256
        request, problem = code(kind, self._sequence, content), ""
        for attempt in range(tries):
            self.retries += attempt > 0
            self.port_send(request if attempt == 0 else b"\0" + request)
            answer, problem = self._await(kind)
            if answer is not None:
                return answer
        raise BoardError(f"the board on {self.port.label} failed {tries} times in turn: {problem}")

    def _await(self, kind: int) -> tuple[bytes | None, str]:
        """Return the answer's content, or None and what went wrong if the request has to be sent again."""
        broken = self._decoder.garbled
        for _ in range(_MOST_MESSAGES):
            try:
                data = self.port.receive()
            except OSError as error:
                raise BoardError(f"the board on {self.port.label} is gone: {_first_line(error)}") from None
            if not data:
                return None, "it was silent"
            for frame in self._decoder.feed(data):
                if frame.kind == protocol.ERROR:
                    fault = frame.content[0] if frame.content else 0
                    means = protocol.FAULTS.get(fault, f"it reports the unknown fault {fault}")
                    if fault in (1, 3):  # lost on the way: to be sent again
                        return None, means
                    if frame.sequence == self._sequence:
                        self._sequence -= 1  # it does not count as answered
                        raise BoardError(f"the board on {self.port.label} refuses: {means}")
                elif frame.sequence == self._sequence and frame.kind == protocol.REPLY | kind:
                    return frame.content, ""
            if self._decoder.garbled > broken:
                return None, "its answer was broken"
        return None, "what it sends is no answer"


def _first_line(error: OSError) -> str:
    return str(error.strerror or error).splitlines()[0]
