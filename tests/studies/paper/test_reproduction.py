"""The reproduction follows the paper's protocol, reports every number, and says which ones it does not explain."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.identification.parameters import PARAMETERS
from amulett_gym.profile import load_profile
from amulett_gym.settings import merge
from amulett_gym.studies.paper import report, results
from amulett_gym.studies.paper.figures import CAPTIONS, undamped_below
from amulett_gym.studies.paper.objective import WEIGHTS, cost, residual
from amulett_gym.studies.paper.report import MARKS, block, in_words
from amulett_gym.studies.paper.reproduction import (
    ALTERNATIVES,
    BOUNDS,
    MEASUREMENT_TIME,
    Readings,
    Reproduction,
    Row,
    apply_readings,
    best_reading,
    compare,
    explained,
    measure,
    paper_step,
    reproduce,
    step_response,
)
from amulett_gym.studies.paper.results import Evidence, content, gather
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, TABLES_2_TO_5, published
from amulett_gym.tasks.suites import START

PINNED = Path(__file__).parent / "reproduced.json"
BEGIN, END = MARKS
DOCUMENT = Path(__file__).parents[3] / "docs" / "reproduction.md"
LAWS = {"position-only": "position-only", "tension-5": "constant:5", "tension-10": "constant:10", "variable": "eq6"}


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return gather()


@pytest.fixture(scope="module")
def reproduction(evidence) -> Reproduction:
    return evidence.reproduction


def test_json_has_every_number_of_tables_2_to_5_in_the_agreed_form(evidence):
    result = json.loads(json.dumps(content(evidence), allow_nan=False))
    assert list(result) == [
        "parameters",
        "rows",
        "cross_check",
        "claims",
        "hypotheses",
        "sensitivity",
        "force_rise_time",
    ]
    assert len(result["rows"]) == 8 + 8 + 8 + 16
    for row, cell in zip(result["rows"], TABLES_2_TO_5, strict=True):
        keys = "table profile configuration metric drive paper ours ratio unit explained note"
        assert list(row) == keys.split()
        assert (row["table"], row["profile"], row["configuration"]) == (cell.table, cell.profile, cell.configuration)
        assert (row["metric"], row["drive"], row["paper"]) == (cell.metric, cell.drive, cell.value)
        assert row["unit"]
        low, high = BOUNDS[cell.metric, cell.profile]
        assert row["ratio"] == pytest.approx(row["ours"] / row["paper"], rel=1e-12)
        assert row["explained"] is (low <= row["ratio"] <= high)
        assert row["explained"] != ("not explained" in row["note"])
        assert ("mean of 10 repetitions" in row["note"]) == (row["profile"] == "testbed")


def test_json_names_the_parameters(evidence):
    parameters = content(evidence)["parameters"]
    assert set(parameters["identified"]) == {free.name for free in PARAMETERS}
    assert parameters["readings"] == vars(Readings())
    for device in DEVICES:
        assert load_profile(parameters["profiles"][device]) == load_profile(device)


def test_twice_is_the_same(reproduction):
    assert reproduce() == reproduction


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("device", DEVICES)
def test_one_repetition_is_what_the_environment_records(device, configuration):
    """The same step by another way: environment, law and contender, and sums over the recorded ticks."""
    profile = load_profile(device)
    ours = step_response(profile, configuration)
    protocol = Protocol(profile, "paper-step", episodes=1, duration=START + MEASUREMENT_TIME)
    episode = record_episode(LAWS[configuration], protocol, paper_step(profile, configuration))
    path, dt = episode.trajectory, episode.trajectory.control_period
    first = round(START / dt)
    error = np.degrees(path["setpoint"] - path["angle"])
    assert ours.position_ise[0] == pytest.approx(np.trapezoid(error[first:] ** 2, dx=dt), rel=1e-6)
    antagonist = np.where(path["agonist"] > 0, path["force_triceps"], path["force_biceps"])
    tension_ise = np.sum((path["tension_setpoint"] - antagonist)[first + 1 :] ** 2) * dt
    # The environment's action is a float32: 10 N become 10.0000004 N, and a quantised reading may fall otherwise.
    close = 1e-5 if device == "simulation" else 5e-3
    assert ours.tension_ise["true"][0] == pytest.approx(tension_ise, rel=close)
    assert ours.tension_ise["estimated"][0] == pytest.approx(episode.metrics["tension_ise_estimated"], rel=close)
    for drive in ("biceps", "triceps"):
        speed = np.diff(np.degrees(path[f"command_{drive}"])[first:]) / dt
        assert ours.isav[drive, "with"][0] == pytest.approx(np.sum(speed**2) * dt, rel=close)
        assert ours.isav[drive, "without"][0] == pytest.approx(episode.metrics[f"effort_{drive}"], rel=close)
    inside = np.abs(path["angle"] - np.radians(45.0)) <= np.radians(2.0)
    assert ours.rise_time["first-entry"][0] == pytest.approx((np.argmax(inside) - first) * dt)
    last_outside = np.flatnonzero(~inside)[-1]
    assert ours.rise_time["settling"][0] == pytest.approx((last_outside + 1 - first) * dt)


@pytest.mark.parametrize("eq6", ["text", "printed"])
@pytest.mark.parametrize("configuration", CONFIGURATIONS)
@pytest.mark.parametrize("device", DEVICES)
def test_every_configuration_is_at_rest_before_the_step(device, configuration, eq6):
    """Without a step nothing is to be counted: a start beside the law's own setpoint would move the arm."""
    profile = load_profile(device)
    exact = {"encoder_noise_deg": 0.0, "potentiometer_noise": 0.0, "encoder_bits": 0, "potentiometer_bits": 0}
    exact_sensors = profile.sensors.model_copy(update={**exact, "force_floor": 0.0})
    profile = profile.model_copy(update={"sensors": exact_sensors})
    law = ("eq6" if eq6 == "text" else "eq6-printed") if configuration == "variable" else LAWS[configuration]
    still = paper_step(profile, configuration, eq6).model_copy(update={"moves": [], "measure_from": 0.0})
    episode = record_episode(law, Protocol(profile, "paper-step", episodes=1, duration=START), still)
    assert episode.metrics["isav_biceps"] < 1e-6
    assert episode.metrics["tension_ise"] < 1e-9


def test_repetitions_differ_by_noise_only(reproduction):
    spreads = {row.cell.profile: set() for row in reproduction.rows}
    for row in reproduction.rows:
        spreads[row.cell.profile].add(row.spread)
    assert spreads["simulation"] == {None}
    assert all(spread >= 0 for spread in spreads["testbed"])
    assert len([spread for spread in spreads["testbed"] if spread > 0]) > 15  # rise times are whole control periods


def test_a_reading_of_the_loop_reaches_the_device():
    readings = Readings(damping="printed", preload="smaller", wiring="tension_only", agonist="biceps", floor="hold")
    profile = apply_readings(load_profile("testbed"), replace(readings, derivative_on="measurement"))
    assert (profile.damping.fit, profile.damping.preload) == ("printed", "smaller")
    assert profile.sensors.below_floor == "hold"
    assert (profile.loop.wiring, profile.loop.agonist) == ("tension_only", "biceps")
    for pid in (profile.loop.position, profile.loop.tension, profile.loop.position_only):
        assert pid.derivative_on == "measurement"
    assert profile.loop.position.kp == load_profile("testbed").loop.position.kp


@pytest.mark.parametrize(
    ("end", "beyond", "stop", "stall"),
    [
        ("held", None, None, None),
        ("continued", "continued", None, None),
        ("hard-stop", "hard-stop", 4e4, None),
        ("stall", "continued", None, 0.3),
    ],
)
def test_what_ends_the_springs_curve_is_a_reading(end, beyond, stop, stall):
    for device in DEVICES:
        profile = apply_readings(load_profile(device), Readings(spring_end=end))
        found = profile.spring.beyond, profile.spring.stop_stiffness, profile.drives.stall_torque
        assert found == (beyond, stop, stall)
    own = load_profile({"name": "mine", "base": "testbed", "drives": {"stall_torque": 0.5}})
    assert apply_readings(own, Readings(spring_end="stall")).drives.stall_torque == 0.5
    assert apply_readings(own, Readings()).drives.stall_torque is None


def test_default_readings_are_the_shipped_profiles():
    for device in DEVICES:
        assert apply_readings(load_profile(device), Readings(agonist="switching")) == load_profile(device)


def test_a_reading_of_the_measurement_changes_its_own_table_only(reproduction):
    tables = {"rise_time": {2}, "tension_error": {4}, "isav_unit": {5}, "isav_kick": {5}, "isav_columns": {5}}
    for (name, _), rows in reproduction.alternatives.items():
        pairs = zip(rows, reproduction.rows, strict=True)
        changed = {row.cell.table for row, default in pairs if row.ours != default.ours}
        assert changed == tables.get(name, {2, 3, 4, 5}), name
    rows = reproduction.alternatives["isav_unit", "deg"]
    for row, default in zip(rows, reproduction.rows, strict=True):
        if row.cell.table == 5:
            assert (row.unit, default.unit) == ("deg^2/s", "rad^2/s")
            assert row.ours == pytest.approx(default.ours * math.degrees(1.0) ** 2)


def test_eq6_matters_for_variable_stiffness_only(reproduction):
    pairs = zip(reproduction.alternatives["eq6", "printed"], reproduction.rows, strict=True)
    assert {row.cell.configuration for row, default in pairs if row != default} == {"variable"}


def test_the_floor_matters_on_the_testbed_only(reproduction):
    for choice in ("hold", "ignore"):
        pairs = zip(reproduction.alternatives["floor", choice], reproduction.rows, strict=True)
        assert {row.cell.profile for row, default in pairs if row != default} == {"testbed"}


def test_the_nearest_reading_is_nearer_than_all_others(reproduction):
    for index, row in enumerate(reproduction.rows):
        key, nearest = best_reading(reproduction, index)
        others = [row.distance, *(rows[index].distance for rows in reproduction.alternatives.values())]
        assert nearest.distance <= min(others) + 0.01
        assert key is None or nearest is reproduction.alternatives[key][index]


def test_a_step_that_never_settles_has_no_number_and_says_why(evidence):
    slow = {"kp": 0.0, "ki": 0.1, "kd": 0.0, "derivative_filter": 0.01}
    loop = {"position": slow, "position_only": slow}
    devices = {name: load_profile({"name": f"slow-{name}", "base": name, "loop": loop}) for name in DEVICES}
    responses = measure(devices, Readings())
    rows = compare(responses, Readings())
    assert all(row.ours is None and not row.explained for row in rows if row.cell.table == 2)
    result = content(replace(evidence, reproduction=Reproduction(devices, Readings(), rows, {})))
    assert result["rows"][0]["ours"] is None
    assert "1 of 1 did not reach the error margin within T" in result["rows"][0]["note"]
    json.dumps(result, allow_nan=False)


def test_a_device_that_fails_has_no_numbers():
    frail = {"name": "frail", "base": "simulation", "plant": {"velocity_limit_deg": 100.0}}
    devices = {"simulation": load_profile(frail), "testbed": load_profile("testbed")}
    rows = compare(measure(devices, Readings()), Readings())
    assert {row.ours for row in rows if row.cell.profile == "simulation"} == {None}
    assert rows[0].trouble == "1 of 1 failed: joint velocity limit"


def test_an_unknown_configuration_gets_a_suggestion():
    with pytest.raises(AmulettError, match="did you mean 'tension-10'"):
        paper_step(load_profile("testbed"), "tension10")


def test_the_reproduced_numbers_stay(reproduction):
    """A change of the physics or of the shipped profiles shows here.

    If it is meant: ``python tests/studies/paper/test_reproduction.py`` writes the numbers anew.
    """
    pinned = json.loads(PINNED.read_text())
    assert len(pinned) == len(reproduction.rows)
    for row in reproduction.rows:
        assert row.ours == pytest.approx(pinned[place(row)], rel=1e-6, nan_ok=True), place(row)


def place(row: Row) -> str:
    cell = row.cell
    return " ".join(filter(None, [cell.metric, cell.profile, cell.configuration, cell.drive]))


def test_the_cross_check_predicts_what_it_has_not_seen(evidence):
    """Ten numbers of each configuration, by parameters that came from the three others."""
    shipped = {row.cell: row.ours for row in evidence.reproduction.rows}
    for left_out, rows in evidence.predicted.items():
        assert [row.cell for row in rows] == [cell for cell in TABLES_2_TO_5 if cell.configuration == left_out]
        assert any(row.ours != shipped[row.cell] for row in rows)
    written = content(evidence)["cross_check"]
    assert [row["left_out"] for row in written] == [name for name in CONFIGURATIONS for _ in range(10)]


@pytest.fixture(scope="module")
def drawn(evidence):
    """Draw the figures once; ``tests/cli/test_reproduce.py`` lets the command draw them itself."""
    return report.draw(evidence)


@pytest.fixture
def gathered(monkeypatch, evidence, drawn):
    """Let the command find the evidence of the other tests, and write the same figures."""
    monkeypatch.setattr(results, "gather", lambda *_: evidence)
    monkeypatch.setattr(report, "draw", lambda _: drawn)


def test_the_command_writes_its_files_and_prints_both_tables(tmp_path, capsys, evidence, gathered):
    folder = tmp_path / "reproduction"
    assert main(["reproduce", "--out", str(folder)]) == 0
    output = capsys.readouterr().out
    assert in_words(evidence) in output
    numbers = ["claims.csv", "command.json", "readings.csv", "reproduction.html", "reproduction.json", "rows.csv"]
    assert sorted(path.name for path in folder.iterdir()) == sorted(numbers + [f"{name}.png" for name in CAPTIONS])
    assert json.loads((folder / "reproduction.json").read_text()) == json.loads(json.dumps(content(evidence)))
    with (folder / "rows.csv").open() as file:
        assert [float(row["paper"]) for row in csv.DictReader(file)] == [cell.value for cell in TABLES_2_TO_5]
    with (folder / "readings.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 40 * (1 + len(ALTERNATIVES))
    assert main(["reproduce", "--out", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((folder / "reproduction.json").read_text())


def test_the_command_keeps_off_other_folders(tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    assert main(["reproduce", "--out", str(tmp_path)]) == 2
    assert "is not empty and holds no reproduction" in capsys.readouterr().err


def test_a_document_keeps_what_is_around_the_generated_part(tmp_path, capsys, gathered):
    path = tmp_path / "mine.md"
    path.write_text(f"# Mine\n\n{BEGIN}\nforgotten\n{END}\n\nJudgement.\n")
    assert main(["reproduce", "--doc", str(path)]) == 0
    text = path.read_text()
    assert text.startswith(f"# Mine\n\n{BEGIN}\n\n### Tables 2-5")
    assert text.endswith(f"{END}\n\nJudgement.\n")
    assert "forgotten" not in text
    for name in CAPTIONS:
        assert f"(images/{name}.png)" in text
        assert (tmp_path / "images" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    path.write_text("# Nothing to renew\n")
    capsys.readouterr()
    assert main(["reproduce", "--doc", str(path)]) == 2
    assert "has to hold the line" in capsys.readouterr().err
    assert path.read_text() == "# Nothing to renew\n"


def test_the_documents_numbers_are_those_of_the_command(evidence):
    """``amulett reproduce --doc docs/reproduction.md`` was run since the last change."""
    text = DOCUMENT.read_text()
    assert text.split(BEGIN)[1].split(END)[0].strip() == block(evidence)


if __name__ == "__main__":
    PINNED.write_text(json.dumps({place(row): row.ours for row in reproduce().rows}, indent=1) + "\n")


def test_the_document_says_what_the_end_of_the_springs_curve_decides(evidence):
    text = " ".join(DOCUMENT.read_text().split(BEGIN)[0].split())
    reproduction = evidence.reproduction
    taken, stalled = reproduction.rows, reproduction.alternatives["spring_end", "stall"]
    counts = [sum(row.explained for row in rows) for rows in (stalled, taken)]
    assert "explain {} numbers instead of {}".format(*counts) in text
    costs = [
        cost([residual(row) for row in rows], [WEIGHTS[row.cell.metric] for row in rows]) for rows in (stalled, taken)
    ]
    assert "({:.1f} instead of {:.1f})".format(*costs) in text
    simulation = reproduction.profiles["simulation"]
    for end in ("continued", "hard-stop"):
        rows = reproduction.alternatives["spring_end", end]
        assert all(row.failed == (row.cell.profile == "simulation") for row in rows)
        quick = load_profile(merge(simulation.model_dump(), {"plant": {"velocity_limit_deg": 1e5}}))
        response = step_response(apply_readings(quick, Readings(spring_end=end)), "position-only")
        assert bool(response.failures) == (end == "hard-stop")
        if end == "continued":
            found = response.position_ise[0], response.rise_time["settling"][0]
            assert (
                "falls from 118 to {:.0f} deg² s and the rise time grows from 0.26 to {:.2f} s".format(*found) in text
            )


def test_the_text_of_the_document_agrees_with_its_generated_part(evidence):
    text = " ".join(DOCUMENT.read_text().split(BEGIN)[0].split())
    counts = [sum(found) for found in evidence.sensitivity.by_noise.values()]
    total = sum(row.explained for row in evidence.reproduction.rows)
    assert f"{total} of the 40 numbers are explained ({min(counts)} or {max(counts)} with other sensor noise)" in text
    predicted = sum(row.explained for rows in evidence.predicted.values() for row in rows)
    assert f"predict {predicted} of the 40 numbers that they did not use" in text
    words = {4: "four", 5: "five", 6: "six", 7: "seven", 8: "all eight"}
    tables = explained(evidence.reproduction.rows)
    assert f"within 5 % in all eight rows): reached in {words[tables[3][0]]}." in text
    assert f"within 25 % in at least five of eight): reached in {words[tables[4][0]]}." in text
    assert f"within a factor of 3): reached in {tables[5][0]} of 16" in text
    rise = [row for row in evidence.reproduction.rows if row.cell.metric == "rise_time"]
    simulated, measured = (sum(row.explained for row in rise if row.cell.profile == name) for name in DEVICES)
    assert (simulated, measured) == (4, 3)
    assert "reached in all four rows. Measured (required: within 35 %): reached in three of four." in text
    refitted = {
        (item["reading"], item["choice"]): item["explained"] for item in evidence.identification["readings_refitted"]
    }
    fewer = {key: total - count for key, count in refitted.items()}
    assert f"after a new fit {words[fewer['preload', 'smaller']]} fewer numbers are explained" in text
    assert f"after a new fit it explains {words[fewer['floor', 'ignore']]} fewer numbers" in text
    assert fewer["tension_error", "estimated"] == fewer["tension_error", "true"] == 2
    assert "If both use the same signal, two fewer numbers are explained" in text
    assert fewer["damping", "printed"] == fewer["rise_time", "first-entry"] == 1
    supported = [item.ours.holds for item in evidence.claims if item.paper is not None and not item.contradicted]
    claims = f"Of the {len(supported)} claims about the tables that the paper's own numbers support, "
    assert f"{claims}{supported.count(True)} hold on the simulated devices" in text
    moves = evidence.sensitivity.by_hysteresis[1.0]
    constant = max(moves[name][1] for name in ("tension-5", "tension-10"))
    moved = f"by up to {constant:.1f} deg under a constant tension and by {moves['variable'][1]:.1f} deg under variable"
    assert moved in text
    [peaks] = [item for item in evidence.claims if item.claim.id == "switching-no-peaks"]
    assert peaks.ours.holds is False
    assert f"the drives lag by {evidence.reproduction.profiles['testbed'].drives.lag:.2f} s" in text
    testbed = evidence.reproduction.profiles["testbed"]
    spring = testbed.spring
    assert f"Each spring has {spring.stiffness / 1000:.0f} kN/m." in text
    assert (
        f"Its half-width, the distance of its anchor from the string's axis, is {1000 * spring.half_width:.0f} mm"
        in text
    )
    share = 100 * testbed.sensors.potentiometer_noise / testbed.sensors.potentiometer_travel
    assert f"the fitted value is {share:.1f} of this bound" in text
    assert (
        f"no damping if the mean of both string forces is below {undamped_below(testbed.damping, 'shifted'):.2f} N"
        in text
    )
    columns = [
        max(isav) / min(isav)
        for isav in (
            [published("isav", device, name, drive).value for drive in ("biceps", "triceps")]
            for device in DEVICES
            for name in CONFIGURATIONS
        )
    ]
    assert f"columns is {min(columns):.0f} to {round(max(columns), -3):,.0f} times".replace(",", " ") in text
