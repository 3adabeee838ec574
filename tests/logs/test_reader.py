"""Logs as loggers write them: the same numbers whatever the notation, and a row and column where they are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulett_gym.errors import AmulettError
from amulett_gym.logs import COLUMNS, read_log, write_log

HEADER = "time [s],setpoint [deg],angle [deg]"
ROWS = "0,10,1\n0.01,10,2\n0.02,10,3.5\n"


def read(tmp_path, text, mapping=None, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_log(path, mapping)


def noted(log, text):
    return [note for note in log.notes if text in note]


NUMBERS = st.floats(-1e4, 1e4, allow_nan=False).map(lambda value: round(value, 6))
TABLES = st.lists(st.tuples(NUMBERS, NUMBERS, st.none() | NUMBERS), min_size=1, max_size=6)


@settings(max_examples=60)
@given(
    rows=TABLES,
    notation=st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    units=st.sampled_from(["[deg]", "(°)", "/deg", "_deg", "below"]),
    before=st.lists(st.sampled_from(["Logger 2.1", "# a comment", "Datum;12.05.", "", "x,y,z,u"]), max_size=3),
    gaps=st.sets(st.integers(0, 6)),
)
def test_the_notation_changes_no_number(tmp_path_factory, rows, notation, end, encoding, units, before, gaps):
    separator, mark = notation
    head = [f"time{'' if units == 'below' else ' [ms]'}", "Setpoint", "angle", "remark", "slider-biceps"]
    unit = "" if units == "below" else units if units[0] in "/_" else f" {units}"
    head[1:3] = [f"{name}{unit}" for name in head[1:3]]
    head[4] += "" if units == "below" else " [mm]"
    lines = [*before, separator.join(head)]
    if units == "below":
        lines.append(separator.join(["ms", "deg", "[deg]", "", "mm"]))
    for k, row in enumerate(rows):
        cells = ["" if value is None else repr(value).replace(".", mark) for value in row]
        lines += [separator * 4] * (k in gaps) + [separator.join([str(5 * k), *cells[:2], "text", cells[2]])]
    path = tmp_path_factory.getbasetemp() / "notation.csv"
    path.write_bytes(end.join([*lines, ""]).encode(encoding))
    log = read_log(path)
    assert log["time"].tolist() == [5 * k / 1000 for k in range(len(rows))]
    written = np.array(rows, dtype=float)
    for name, values in zip(("setpoint", "angle"), written.T, strict=False):
        np.testing.assert_allclose(log[name], np.radians(values), rtol=1e-15)
    if not np.isnan(written[:, 2]).all():
        np.testing.assert_array_equal(log["slider_biceps"], written[:, 2] / 1000)


LOGS = st.integers(1, 8).flatmap(
    lambda size: st.fixed_dictionaries(
        dict.fromkeys(("setpoint", "angle"), st.lists(NUMBERS, min_size=size, max_size=size)),
        optional=dict.fromkeys(
            ("slider_triceps", "force_biceps", "command_triceps", "tension_setpoint"),
            st.lists(NUMBERS | st.just(np.nan), min_size=size, max_size=size),
        ),
    )
)


@settings(max_examples=40)
@given(columns=LOGS, suffix=st.sampled_from([".csv", ".npz"]))
def test_what_is_written_is_read_back(tmp_path_factory, columns, suffix):
    path = tmp_path_factory.getbasetemp() / f"written{suffix}"
    columns = {"time": np.arange(len(columns["angle"])) * 0.0025, **columns}
    write_log(path, columns)
    log = read_log(path)
    columns = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    assert list(log.columns) == [name for name in COLUMNS if name in columns]
    for name, values in columns.items():
        np.testing.assert_allclose(log[name], values, rtol=0.0 if suffix == ".npz" else 1e-11)


BAD = {
    "nothing": ("", "log .*: it is empty"),
    "empty rows": ("\n \n", "it is empty"),
    "a terminal's commands": ("\x1b[2J,a\0\n0,1\n", r"row 1 has no column 'time' \(there are: \\x1b\[2J, a\\x00\)"),
    "a terminal's commands in a unit": ("time [s],setpoint [deg],angle [\x1b[2J]\n0,1,2\n", r"'angle \[\\x1b\[2J\]'"),
    "an unknown unit below": ("time,setpoint,angle\ns,Grad,counts\n0,1,2\n", "column 'setpoint' has the unit 'Grad'"),
    "a header only": (HEADER + "\n", "it has no rows of numbers"),
    "no angle": ("time [s],setpoint [deg],angel [deg]\n0,1,2\n", r"row 1 has no column 'angle'; did you mean 'angel "),
    "no unit": ("time [s],setpoint [deg],angle\n" + ROWS, "row 1: the column 'angle' has no unit; .* as in 'angle "),
    "another unit": (
        HEADER.replace("[s]", "[h]") + "\n" + ROWS,
        r"column 'time \[h\]' has the unit 'h'; units of time are s, ms",
    ),
    "two angles": (HEADER + ",angle_rad\n", r"row 1 names the column 'angle' 2 times: 'angle \[deg\]', 'angle_rad'"),
    "a long row": (HEADER + "\n0,1,2\n0,01,1,2\n", "row 3 has 4 cells, the header has 3"),
    "a short row": (HEADER + "\n0,1,2\n1,2", "row 3 has 2 cells, the header has 3"),
    "text": (HEADER + "\n0,1,2\n1,2,far\n", r"row 3, column 'angle \[deg\]': 'far' is no finite number"),
    "an infinity": (HEADER + "\n0,1,inf\n", r"row 2, column 'angle \[deg\]': 'inf' is no finite number"),
    "an overflow": (HEADER + "\n0,1,1e999\n", r"row 2, column 'angle \[deg\]': '1e999' is no finite number"),
    "digits apart": (HEADER + "\n0,1,1_000\n", r"row 2, column 'angle \[deg\]': '1_000' is no finite number"),
    "thousands": (
        HEADER.replace(",", ";") + "\n0.5;1;2\n1;1,234;3\n",
        r"row 3, column 'setpoint \[deg\]': '1,234' has a decimal comma, but row 2, column 'time \[s\]' has the other",
    ),
    "both marks in one": (HEADER.replace(",", ";") + "\n0;1.234,5;2\n", "'1.234,5' is no finite number"),
    "no time": (HEADER + "\n0,1,2\n,1,2\n", r"row 3, column 'time \[s\]': '' is no finite number"),
    "a time that falls": (
        HEADER + "\n0,1,2\n2,1,2\n\n1,1,2\n",
        r"row 5, column 'time \[s\]': the time falls, 1.0 s fol",
    ),
    "no value": (HEADER + "\n0,1,\n1,1,nan\n", r"column 'angle \[deg\]' has no value in any row"),
    "an open quote": (HEADER + '\n0,1,"2\n', "is not valid CSV: row 2"),
    "a zero byte": (HEADER + "\n0,1,\0\n", r"row 2, column 'angle \[deg\]': '\\x00' is no finite number"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused_is_named_by_row_and_column(name, tmp_path):
    with pytest.raises(AmulettError, match=BAD[name][1]) as error:
        read(tmp_path, BAD[name][0])
    assert str(tmp_path / "log.csv") in str(error.value)


def test_a_text_in_no_encoding_is_refused(tmp_path):
    with pytest.raises(AmulettError, match="not UTF-8 text"):
        read(tmp_path, HEADER.encode() + b"\n0,1,\x81\n")


def test_what_was_taken_for_what_is_noted(tmp_path):
    text = "Logger v2;;\n\n# Time (ms);Setpoint_deg;angle [°];x\n0;1,5;;a\n# reset\n5;2;3;b\n"
    notes = read(tmp_path, text.encode("cp1252")).notes
    assert notes[:10] == (
        "encoding: Windows-1252, since it is no UTF-8",
        "separator: semicolon",
        "left out: row 1 before the header",
        "header: the comment in row 3",
        "decimal comma: first in row 4, column 'Setpoint_deg'",
        "left out: row 5, comments",
        "no value in column 'angle [°]': row 4",
        "left out: the column 'x'",
        "time: column 'Time (ms)' in ms",
        "setpoint: column 'Setpoint_deg' in deg",
    )


def test_an_optional_column_with_a_wrong_name_is_left_out_with_the_right_one(tmp_path):
    log = read(tmp_path, HEADER + ",comand_biceps [deg]\n0,1,2,3\n")
    assert "left out: the column 'comand_biceps [deg]'; did you mean 'command_biceps'?" in log.notes


def test_a_last_separator_in_each_row_is_no_column(tmp_path):
    log = read(tmp_path, HEADER + "\n0,1,2,\n1,1,2,\n")
    assert len(log) == 2 and noted(log, "an empty cell behind the last column in 2 rows")


def test_a_mapping_gives_names_units_signs_and_offsets(tmp_path):
    mapping = {
        "time": {"name": "t", "unit": "ms"},
        "setpoint": "Soll",
        "angle": {"name": "counts", "unit": "rev", "scale": 1 / 16384, "offset": 100, "sign": -1},
        "force_biceps": 5,
    }
    log = read(tmp_path, "t,Soll [deg],counts,angle [deg],F [N]\n0,90,4196,7,3\n10,90,100,7,4\n", mapping)
    np.testing.assert_allclose(log["time"], [0.0, 0.01])
    np.testing.assert_allclose(log["setpoint"], np.pi / 2)
    np.testing.assert_allclose(log["angle"], [-np.pi / 2, 0.0])
    assert log["force_biceps"].tolist() == [3.0, 4.0]
    assert noted(log, "angle: column 'counts' in rev, minus 100, times 6.103515625e-05, sign changed")
    assert noted(log, "left out: the column 'angle [deg]'")


def test_a_row_of_units_may_have_others_where_the_mapping_names_them(tmp_path):
    mapping = {"angle": {"unit": "rev", "scale": 1 / 16384}}
    log = read(tmp_path, "time,setpoint,angle,state\ns,deg,counts,-\n0,1,8192,idle\n", mapping)
    np.testing.assert_allclose(log["angle"], np.pi)
    assert noted(log, "units: row 2")


def test_columns_without_a_header_are_known_by_their_numbers(tmp_path):
    columns = {"time": (1, "ms"), "setpoint": (3, "deg"), "angle": (2, "deg")}
    mapping = {name: {"name": number, "unit": unit} for name, (number, unit) in columns.items()}
    mapping["file"] = {"header": False}
    log = read(tmp_path, "\n# boot\n0;1,5;10\n5;2;10\n", mapping)
    np.testing.assert_allclose(np.degrees(log["angle"]), [1.5, 2.0])
    np.testing.assert_allclose(log["time"], [0.0, 0.005])


@pytest.mark.parametrize(("keep", "angles"), [("first", [1, 2, 4]), ("last", [1, 3, 4]), ("mean", [1, 2.5, 4])])
def test_one_of_several_rows_with_the_same_stamp_remains(keep, angles, tmp_path):
    log = read(tmp_path, HEADER + "\n0,0,1\n1,0,2\n1,,3\n2,0,4\n", {"file": {"repeated_stamps": keep}})
    np.testing.assert_allclose(np.degrees(log["angle"]), angles)
    assert log["time"].tolist() == [0.0, 1.0, 2.0]
    assert noted(log, "repeated stamps: 1 row, the first is 4; ")


def test_a_sensor_without_values_is_left_out(tmp_path):
    log = read(tmp_path, HEADER + ",force_biceps [N]\n0,1,2,\n1,2,3,nan\n")
    assert "force_biceps" not in log and noted(log, "left out: column 'force_biceps [N]' has no value in any row")


def test_equal_rows_with_the_same_stamp_are_noted_as_such(tmp_path):
    log = read(tmp_path, HEADER + "\n0,0,1\n0,0,1\n1,0,4\n")
    assert noted(log, "repeated stamps: 1 row, the first is 3; equal to the row before and left out")


def test_repeated_stamps_can_be_refused(tmp_path):
    with pytest.raises(AmulettError, match=r"row 3, column 'time \[s\]': the time repeats"):
        read(tmp_path, HEADER + "\n0,0,1\n0,0,2\n", {"file": {"repeated_stamps": "refuse"}})


def test_jitter_and_gaps_are_noted(tmp_path):
    random = np.random.default_rng(0)
    time = 0.01 * np.arange(200) + random.uniform(0.0, 0.002, 200)
    rows = [f"{stamp:.6f},0,{k}" for k, stamp in enumerate(time) if k not in (50, 120, 121)]
    log = read(tmp_path, "\n".join([HEADER, *rows]))
    assert log.gaps.tolist() == [50, 119]
    assert log.period == pytest.approx(0.01, rel=0.01)
    assert noted(log, "gaps: 2 gaps, the longest of 0.03") and noted(log, "before row 121")
    assert noted(log, "jitter: steps of ")


def test_stamps_in_whole_milliseconds_are_no_gaps(tmp_path):
    rows = [f"{int(1.5 * k)},0,0" for k in range(100)]
    log = read(tmp_path, "\n".join([HEADER.replace("[s]", "[ms]"), *rows]))
    assert log.gaps.size == 0 and log.period == pytest.approx(0.0015, rel=0.01)


@pytest.mark.parametrize(
    ("text", "note"),
    [
        ("time [s],setpoint [deg],angle [rad]\n0,0,0\n0.01,0,45\n", "angle: reaches 45 rad, more than 6.28: check its"),
        (HEADER + "\n0,0,0\n5,9,9\n", "time: 5 s between two rows: check its unit"),
        (HEADER + "\n0,0,0\n0.1,9,-8\n0.2,0,1\n", "angle: falls where the setpoint rises"),
        (HEADER + "\n0,0,5\n0.1,9,5\n", "angle: never changes"),
        (HEADER + ",slider_biceps [mm]\n0,0,5,-9\n0.1,9,6,-8\n", "slider_biceps: falls to -9 mm"),
    ],
)
def test_values_that_look_like_another_unit_or_sign_are_noted(text, note, tmp_path):
    assert noted(read(tmp_path, text), note)


def test_arrays_have_names_and_units_too(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time_ms=[0, 10], setpoint_deg=[0.0, 90.0], q=np.array([0.0, np.nan], dtype=np.float32))
    log = read_log(path, {"angle": {"name": "q", "unit": "rad"}})
    assert log["time"].tolist() == [0.0, 0.01]
    np.testing.assert_allclose(log["setpoint"], [0.0, np.pi / 2])
    assert np.isnan(log["angle"][1])


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"time_s": [0, 1], "setpoint_deg": [0, 1]}, "it has no column 'angle'"),
        ({"time_s": [0, 1], "setpoint_deg": [0, 1], "angle": [0, 1]}, "the column 'angle' has no unit"),
        ({"time_s": [0, 1], "setpoint_deg": [0, 1], "angle_deg": [0]}, "'angle_deg' has 1 values, 'time_s' 2"),
        ({"time_s": [[0, 1]], "setpoint_deg": [0, 1], "angle_deg": [0, 1]}, r"'time_s' is int64 of shape \(1, 2\)"),
        ({"time_s": [0, 1], "setpoint_deg": [0, 1], "angle_deg": [0, np.inf]}, "row 1, column 'angle_deg': inf"),
        ({"time_s": [0, np.nan], "setpoint_deg": [0, 1], "angle_deg": [0, 1]}, "row 1, column 'time_s': it has no"),
    ],
)
def test_arrays_that_are_no_log_are_refused(arrays, message, tmp_path):
    np.savez(tmp_path / "log.npz", **arrays)
    with pytest.raises(AmulettError, match=message):
        read_log(tmp_path / "log.npz")
