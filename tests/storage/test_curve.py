"""Measured curves: what is no curve is refused by file, row and column."""

import json
import re
import tracemalloc

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.storage import curve as curves
from amulett_gym.storage.curve import MOST_BYTES, Curve, read_curve, read_measurement
from amulett_gym.storage.hysteresis import mean_of_branches
from amulett_gym.storage.safe_yaml import read_yaml, to_yaml

BAD_CURVES = {
    "nothing at all": ("", "it is empty"),
    "a header only": ("deflection_m,force_N\n", "'deflection_m'.*at least 3 items"),
    "no force": ("deflection_m,newton\n0,0\n1,1\n2,2\n", "row 1 has no column 'force_N'"),
    "too short": ("deflection_m,force_N\n0,0\n1,1\n", "'deflection_m'.*at least 3 items"),
    "too long": (
        "deflection_m,force_N\n" + "0,0\n" * (MOST_BYTES // 4),
        "has 1000021 bytes; at most 1000000 are allowed",
    ),
    "a force that falls": (
        "deflection_m,force_N\n0,0\n1,5\n2,4\n",
        "row 4, column 'force_N': it has to rise from row to row; 4.0 follows 5.0",
    ),
    "a deflection twice": (
        "deflection_m,force_N\n0,0\n1,5\n1,6\n",
        "row 4, column 'deflection_m': it has to rise from row to row; 1.0 follows 1.0",
    ),
    "a deflection that falls below an empty row": (
        "deflection_m,force_N\n0,0\n,\n2,5\n1,6\n",
        "row 5, column 'deflection_m': it has to rise from row to row; 1.0 follows 2.0",
    ),
    "a preload": ("deflection_m,force_N\n0,1\n1,5\n2,6\n", "starts at .*'force_N': 1.0.*have to be 0, or all above"),
    "no force at all": ("deflection_m,force_N\n0,0\n1,0\n2,0\n", "no force above 0"),
    "below zero": ("deflection_m,force_N\n-1,0\n1,5\n2,6\n", "row 2, column 'deflection_m': it starts at -1.0"),
    "beyond the range": ("deflection_m,force_N\n0,0\n1,1\n2,2e6\n", "row 4, column 'force_N': it reaches 2000000.0"),
    "an endless field": ("deflection_m,force_N\n0," + "1" * 200_000 + "\n", "is not valid CSV: row 2"),
    "an open quote": ('deflection_m,force_N\n0,0\n1,"1\n', "is not valid CSV: row 3"),
    "not a number": ("deflection_m,force_N\n0,0\n1,nan\n2,4\n", "row 3, column 'force_N': 'nan' is no finite number"),
    "infinity": ("deflection_m,force_N\n0,0\n1,1\n2,inf\n", "row 4, column 'force_N': 'inf'"),
    "text": ("deflection_m,force_N\n0,0\n1,much\n2,4\n", "row 3, column 'force_N': 'much' is no finite number"),
    "a decimal comma beside a decimal point": (
        "deflection_m;force_N\n0;0\n0.1;1\n0,2;4\n",
        "row 4, column 'deflection_m': '0,2' has a decimal comma, but row 3, column 'deflection_m' has the other mark",
    ),
    "a short row": ("deflection_m,force_N\n0,0\n1\n2,4\n", "row 3 has 1 cells, the header has 2"),
    "a long row": ("deflection_m,force_N\n0,0\n\n0.002,1,100\n0.004,9\n", "row 4 has 3 cells, the header has 2"),
    "a column twice": (
        "deflection_m,force_N,force_N\n0,0,0\n1,1,2\n2,4,5\n",
        "row 1 names the column 'force_N' 2 times",
    ),
    "a bad third column": (
        "deflection_m,force_N,spring_deflection_m\n0,0,0\n1,1,\n2,4,1\n",
        "row 3, column 'spring_deflection_m': '' is no",
    ),
}


def test_curves_of_spreadsheets_and_with_plateaus_are_read(tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text("\ufeffdeflection_m;force_N\n0.001;1\n0.002;4\n0.003;4\n", encoding="utf-8")
    curve = read_curve(path)
    assert curve == Curve(deflection_m=[0.001, 0.002, 0.003], force_N=[1.0, 4.0, 4.0])


def test_other_columns_and_empty_rows_are_left_out(tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text("remark, force_N ,deflection_m\nrest,0,0\n,,\n,1,0.002\n\nend,4,0.004\n,,\n")
    assert read_curve(path) == Curve(deflection_m=[0.0, 0.002, 0.004], force_N=[0.0, 1.0, 4.0])


def test_columns_of_other_lengths_are_refused():
    with pytest.raises(ValueError, match="'force_N' has 2 values, 'deflection_m' has 3"):
        Curve(deflection_m=[0, 1, 2], force_N=[0, 1])


def test_values_without_rows_are_named_by_their_number():
    with pytest.raises(ValueError, match="value 3 of 'force_N': it has to rise from row to row; 1.0 follows 2.0"):
        Curve(deflection_m=[0, 1, 2], force_N=[0, 2, 1])


@pytest.mark.parametrize("name", BAD_CURVES)
def test_a_profile_with_a_bad_curve_is_refused_when_it_is_loaded(name, tmp_path):
    (tmp_path / "curve.csv").write_text(BAD_CURVES[name][0])
    (tmp_path / "own.yaml").write_text("{name: own, base: testbed, spring: {measured_curve: curve.csv}}")
    with pytest.raises(AmulettError, match=BAD_CURVES[name][1]) as error:
        load_profile(tmp_path / "own.yaml")
    assert "own.yaml" in str(error.value) and "spring.measured_curve" in str(error.value)


def test_a_profile_keeps_its_curve_by_content(tmp_path):
    curve = tmp_path / "curve.csv"
    curve.write_text("deflection_m,force_N\n0.001,2\n0.002,5\n0.004,10\n")
    profile = load_profile({"name": "own", "base": "testbed", "spring": {"measured_curve": curve}})
    curve.unlink()
    content = json.loads(profile.model_dump_json())
    assert content["spring"]["measured_curve"] == "deflection_m,force_N\n0.001,2.0\n0.002,5.0\n0.004,10.0\n"
    assert load_profile(content) == profile
    content["spring"]["measured_curve"] = {"deflection_m": [0.001, 0.002, 0.004], "force_N": [2, 5, 10]}
    assert load_profile(content) == profile
    with pytest.raises(AmulettError, match=r"spring\.measured_curve.*cannot read .*curve\.csv"):
        load_profile({"name": "own", "base": "testbed", "spring": {"measured_curve": str(curve)}})


def test_a_long_curve_is_kept_in_yaml_with_the_same_numbers(tmp_path):
    rows = "\n".join(f"{k}e-7,{k / 3},{k / 7}e-6" for k in range(6000))  # more numbers than a YAML file may have
    (tmp_path / "curve.csv").write_text(f"deflection_m,force_N,spring_deflection_m\n{rows}\n")
    (tmp_path / "own.yaml").write_text("{name: own, base: testbed, spring: {measured_curve: curve.csv}}")
    profile = load_profile(tmp_path / "own.yaml")
    (tmp_path / "kept.yaml").write_text(to_yaml({"env": {"profile": profile.model_dump()}}))
    assert load_profile(read_yaml(tmp_path / "kept.yaml", "recipe")["env"]["profile"]) == profile


def test_a_curve_that_would_not_fit_into_a_kept_file_is_refused(monkeypatch):
    columns = {"deflection_m": [0.0, 0.1, 0.2], "force_N": [0.0, 1.0, 2.0]}
    size = len(Curve(**columns).to_csv())
    monkeypatch.setattr(curves, "MOST_KEPT", size - 1)
    with pytest.raises(ValueError, match=f"it has {size} characters as CSV; at most {size - 1} are allowed"):
        Curve(**columns)


@pytest.mark.parametrize("name", BAD_CURVES)
def test_bad_curve_is_refused_by_file_and_column(name, tmp_path):
    content, message = BAD_CURVES[name]
    path = tmp_path / "curve.csv"
    path.write_text(content)
    with pytest.raises(AmulettError, match=message) as error:
        read_curve(path)
    assert str(path) in str(error.value)


UP = [(k, 0.1 * k * k) for k in range(11)]
DOWN = [(k - 0.5, 0.08 * (k - 0.5) ** 2) for k in range(10, 0, -1)]


def loops(*branches):
    return "\n".join(["deflection [mm];force [N]", *(f"{x:g};{force!r}" for part in branches for x, force in part), ""])


@pytest.mark.parametrize("branches", [(UP, DOWN), (UP, [(10, 8.0), *DOWN]), (UP, DOWN, UP[1:], DOWN)])
def test_of_loops_the_mean_is_taken_and_the_loss_reported(branches):
    curve, notes = read_measurement(loops(*branches).replace(".", ","))
    assert curve.deflection_m == pytest.approx([0.0005, *(0.001 * k for k in range(1, 11))])
    measured = dict(zip(curve.deflection_m, curve.force_N, strict=True))
    for k in range(1, 10):  # chords of both parabolas: a cell's error is at most curvature / 8
        assert measured[k / 1000] == pytest.approx(0.09 * k * k, abs=0.02)
    up, down = len(branches) // 2 + len(branches) % 2, len(branches) // 2
    words = (
        rf"mean of {up} branch(es)? up and {down} down, 0.5 to 10 mm; hysteresis takes 0.00\d+ J of 0.033\d J, 1[6-9]"
    )
    assert re.match(words, notes[-1])


def test_a_curve_without_loops_has_no_loss():
    curve, notes = read_measurement(loops(UP))
    assert notes == ["separator: semicolon"]
    assert curve == read_curve("\n".join(["deflection_m,force_N", *(f"{x / 1000!r},{f!r}" for x, f in UP), ""]))


def test_a_profile_names_the_loss_of_its_curve(tmp_path):
    (tmp_path / "curve.csv").write_text(loops(UP, DOWN))
    (tmp_path / "own.yaml").write_text("{name: own, base: testbed, spring: {measured_curve: curve.csv}}")
    profile = load_profile(tmp_path / "own.yaml")
    assert profile.spring.sources["measured_curve"].startswith("given: mean of 1 branch up and 1 down")
    assert load_profile(json.loads(profile.model_dump_json())) == profile
    content = {"name": "own", "base": "testbed", "spring": {"measured_curve": tmp_path / "curve.csv"}}
    assert load_profile(content).spring.sources == profile.spring.sources
    content["spring"]["sources"] = {"measured_curve": "datasheet: page 3"}
    assert load_profile(content).spring.sources["measured_curve"] == "datasheet: page 3"


@pytest.mark.parametrize(
    ("branches", "message"),
    [
        ((UP, DOWN[:5]), "row 13, column 'deflection_m': it has to rise from row to row; 0.0095.* follows 0.01.* 45 %"),
        (
            (UP[:5], [(3, 1.0)], UP[5:]),
            "row 7, column 'deflection_m': it has to rise from row to row; 0.003 follows 0.004",
        ),
        ((UP[:5], [(4, 1.0)], UP[5:], DOWN), "row 7, column 'deflection_m': it has to rise .* 0.004 follows 0.004"),
        ((UP[::-1],), "row 3, column 'deflection_m': it has to rise from row to row; it only falls"),
        ((UP, [(x, 2 * force) for x, force in DOWN]), "unloading returns .* more than the .* J that loading takes"),
        ((UP[:5], [(5, 9.0)], UP[6:], DOWN), "row 8, column 'force_N': it has to rise from row to row"),
    ],
)
def test_what_is_no_loop_is_refused(branches, message):
    with pytest.raises(AmulettError, match=message):
        read_curve(loops(*branches))


def test_curve_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(AmulettError, match=r"cannot read measured spring curve '.*none\.csv': No such file"):
        read_curve(tmp_path / "none.csv")


def test_a_long_loop_needs_memory_for_its_rows_only():
    rows = 20_000
    up = np.linspace(0.0, 0.01, rows)
    deflection = [*up, *up[::-1][1:]]
    force = [*(2000.0 * up), *(1900.0 * up[::-1][1:])]
    tracemalloc.start()
    mean = mean_of_branches([deflection, force], list(range(1, len(deflection) + 1)), "deflection_m")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert mean.rows == list(range(1, rows + 1))
    assert most < 100 * 8 * rows


def test_unloading_that_returns_all_work_has_no_loss_to_report():
    up = np.linspace(0.0, 0.01, 20)
    deflection = [*up, *up[::-1][1:]]
    force = [*(2000.0 * up), *(2010.0 * up[::-1][1:])]
    mean = mean_of_branches([deflection, force], list(range(1, len(deflection) + 1)), "deflection_m")
    assert mean.in_words().endswith("no hysteresis is measured")


def test_the_row_that_stands_still_is_named():
    deflection = [0.0, 0.005, 0.01, 0.007, 0.007, 0.003, 0.0]
    with pytest.raises(ValueError, match=r"^row 5, column 'deflection_m': .* 0.007 follows 0.007"):
        mean_of_branches([deflection, deflection], list(range(1, 8)), "deflection_m")
