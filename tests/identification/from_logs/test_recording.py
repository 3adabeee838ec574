from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.identification.from_logs.recording import WARM_UP, Recording, at_rows, blocks_of, cut, inputs_of
from amulett_gym.simulation.layout import LANES

PERIOD = 0.01


def recording(time, **changes):
    columns = {"time": time, "angle": np.sin(time), "command_biceps": time.copy(), "command_triceps": -time}
    return Recording("log.csv", columns, **changes)


def rows_of(pieces):
    return np.sort(np.concatenate([piece.rows for piece in pieces]))


def test_pieces_share_the_rows_after_the_warm_up():
    time = np.arange(3000) * PERIOD
    pieces = cut([recording(time)], PERIOD)
    assert len(pieces) == LANES
    assert np.array_equal(rows_of(pieces), np.flatnonzero(time >= WARM_UP - 1e-9))
    assert all(piece.begin - piece.start == pytest.approx(WARM_UP) for piece in pieces)


def test_a_short_log_has_fewer_pieces_and_a_prediction_one():
    time = np.arange(700) * PERIOD
    assert len(cut([recording(time)], PERIOD)) == 2
    assert len(cut([recording(time)], PERIOD, whole=True)) == 1


def test_a_gap_begins_a_new_piece():
    time = np.concatenate([np.arange(300), np.arange(400, 700)]) * PERIOD
    pieces = cut([recording(time)], PERIOD, whole=True)
    assert [(piece.begin, piece.end) for piece in pieces] == [
        pytest.approx((WARM_UP, 3.0), abs=1.5 * PERIOD),
        pytest.approx((4.0 + WARM_UP, 7.0), abs=1.5 * PERIOD),
    ]


def test_missing_commands_are_a_gap_and_missing_angles_are_not():
    time = np.arange(600) * PERIOD
    log = recording(time)
    log.columns["angle"][300] = np.nan
    assert len(cut([log], PERIOD, whole=True)) == 1
    log.columns["command_biceps"][290:310] = np.nan
    assert len(cut([log], PERIOD, whole=True)) == 2


def test_the_comparison_can_be_limited():
    time = np.arange(1000) * PERIOD
    pieces = cut([recording(time, begin=4.0, end=6.0)], PERIOD, whole=True)
    assert time[rows_of(pieces)][[0, -1]] == pytest.approx([4.0, 6.0], abs=PERIOD)


def test_the_state_at_the_begin_is_that_of_the_rows_about_it():
    pieces = cut([recording(np.arange(3000) * PERIOD)], PERIOD)
    for piece in pieces:
        assert piece.angle == pytest.approx(np.sin(piece.begin), abs=1e-6)
        assert piece.velocity == pytest.approx(np.cos(piece.begin), abs=1e-3)


def test_an_arm_that_is_let_go_is_compared_from_its_first_row():
    (piece,) = cut([recording(np.arange(200) * PERIOD, released=True)], PERIOD)
    assert (piece.begin, piece.angle, piece.velocity) == (0.0, 0.0, 0.0)
    assert piece.rows[0] == 0


def test_commands_are_delayed(base):
    (piece,) = cut([recording(np.arange(250) * PERIOD)], PERIOD)
    plain, late = (inputs_of((piece,), base, delay) for delay in (0.0, 0.004))
    assert plain.first.shape[1] == LANES
    settled = slice(150, 200)
    assert late.first[settled, 0] == pytest.approx(plain.first[settled, 0] - 0.004)
    assert late.second[settled, 0] == pytest.approx(plain.second[settled, 0] + 0.004)
    assert len(plain.angle) == round(WARM_UP / PERIOD) + 1
    assert plain.angle[:, 0] == pytest.approx(np.sin(piece.start + PERIOD * np.arange(len(plain.angle))), abs=1e-4)


def test_readings_between_ticks_are_interpolated():
    time = 0.5 + np.arange(200) * 0.0133
    (piece,) = cut([recording(time)], PERIOD)
    ticks = piece.start + PERIOD * np.arange(400)
    assert at_rows(piece, np.sin(ticks), PERIOD) == pytest.approx(np.sin(time[piece.rows]), abs=2e-5)


def test_open_and_closed_loops_have_blocks_of_their_own():
    time = np.arange(500) * PERIOD
    closed = Recording("closed", {"time": time, "angle": time, "setpoint": time, "tension_setpoint": time})
    blocks = blocks_of(cut([recording(time), closed], PERIOD))
    assert [{piece.recording.open_loop for piece in block} for block in blocks] == [{True}, {False}]


def test_a_log_without_inputs_is_refused():
    time = np.arange(500) * PERIOD
    with pytest.raises(AmulettError, match="x.csv has no column tension_setpoint; a fit needs time, angle, and both"):
        cut([Recording("x.csv", {"time": time, "angle": time, "setpoint": time})], PERIOD)


def test_a_log_shorter_than_its_warm_up_is_refused():
    with pytest.raises(AmulettError, match="log.csv has no rows to compare .* the first 1.5 s"):
        cut([recording(np.arange(50) * PERIOD)], PERIOD)
