"""The page has every number, needs nothing else, and escapes what it is given."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from amulett_gym.reporting.words import number, pretty
from amulett_gym.studies.paper import reproduction as definitions
from amulett_gym.studies.paper.claims import CLAIMS, NAMES, answer_hypotheses, check_claims, our_numbers
from amulett_gym.studies.paper.motion import ForceRise, Sensitivity
from amulett_gym.studies.paper.report import render
from amulett_gym.studies.paper.reproduction import ALTERNATIVES, Readings, Row, best_reading, our_drive, reproduce
from amulett_gym.studies.paper.results import (
    Evidence,
    bounds_in_words,
    cross_check_table,
    exchange_in_words,
    overview,
    readings_table,
    within,
)
from amulett_gym.studies.paper.study import shipped
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, TABLES_2_TO_5

VARIED = Sensitivity(
    by_noise={1: (8, 7, 6, 12)},
    by_time={5.0: (8, 7, 6, 13)},
    by_hysteresis={1.0: {"tension-5": (3, 0.25), "tension-10": (4, 0.5), "variable": (5, 1.25)}},
    by_floor={"clamp": (4.5, 2.5)},
    by_setpoint={"mean": 0.95},
)
RISES = (ForceRise("testbed", "tension-5", 0.25, None, 0, 10, 0.5),)


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """Evidence without motions, whose claims and hypotheses are undecided, and with our rows as predictions."""
    reproduction = reproduce()
    predicted = {
        name: tuple(row for row in reproduction.rows if row.cell.configuration == name) for name in CONFIGURATIONS
    }
    answers = answer_hypotheses(our_numbers(reproduction))
    springs = {spring["law"]: reproduction.rows for spring in shipped()["springs"]}
    claims = check_claims(reproduction, {})
    return Evidence(reproduction, shipped(), predicted, springs, claims, answers, {}, VARIED, RISES)


@pytest.fixture(scope="module")
def page(evidence) -> str:
    return render(evidence, {})


def rows_of(page: str, heading: str, table: int = 0) -> list[list[str]]:
    """Return the cells of a table below a heading, as text."""
    section = re.split(rf"<h[23][^>]*>{heading}", page)[1].split("<h2")[0]
    rows = re.findall(r"<tr.*?</tr>", section.split("<tbody>")[1 + table].split("</tbody>")[0], flags=re.DOTALL)
    cells = [re.findall(r"<td.*?</td>", row, flags=re.DOTALL) for row in rows]
    return [[text_of(cell) for cell in row] for row in cells]


def text_of(page: str) -> str:
    words = html.unescape(re.sub(r"<.*?>", " ", page.split("</style>")[-1], flags=re.DOTALL))
    return " ".join(words.split())


def test_every_number_of_the_tables_is_there_beside_ours(page, evidence):
    for table in (2, 3, 4, 5):
        shown = rows_of(page, f"Table {table}")
        rows = [row for row in evidence.reproduction.rows if row.cell.table == table]
        for cells, row in zip(shown, rows, strict=True):
            assert cells[1:3] == [pretty(f"{row.cell.value:g}"), pretty(number(row.ours, 4))]
            assert cells[3] == ("" if row.spread is None else pretty(number(row.spread, 2)))
            assert cells[5] == ("yes" if row.explained else "no")
            assert row.cell.drive is None or row.cell.drive in cells[0]
            key, nearest = best_reading(evidence.reproduction, evidence.reproduction.rows.index(row))
            assert (key is None and nearest.explained) == (cells[-1] == "")
            assert key is None or key[1] in cells[-1]


def test_it_says_how_many_numbers_are_explained_and_what_that_means(page, evidence):
    explained = sum(row.explained for row in evidence.reproduction.rows)
    assert f"{explained} of the {len(TABLES_2_TO_5)} numbers of Tables 2-5 are explained" in page
    assert text_of(page).count(text_of(bounds_in_words())) == 1


def test_bounds_are_said_as_people_say_them(monkeypatch):
    assert within("position_ise", "testbed") == "within 5 %"
    assert within("rise_time", "simulation") == "within 15 %"
    assert within("isav", "simulation") == "within a factor of 3"
    assert "rise time within 15 % (simulation), within 35 % (testbed); position ISE within 5 %;" in bounds_in_words()
    monkeypatch.setitem(definitions.BOUNDS, ("isav", "simulation"), (0.5, 1.2))
    assert within("isav", "simulation") == "from 0.5 to 1.2 times the paper's"


def test_costs_differ_by_what_the_search_itself_varies(evidence):
    def note(*costs):
        found = {"ensemble": {"least_cost": 30.0}, "starts": [{"cost": cost} for cost in costs]}
        return readings_table(replace(evidence, identification={**evidence.identification, **found})).note

    assert "ended 1.0 to 3.5 above" in note(33.5, 31.0, 32.0)
    assert "ended 1.0 above" in note(31.0)


def test_every_reading_is_there(page):
    assert len(rows_of(page, "Interpretations")) == 1 + len(ALTERNATIVES)


def test_the_cross_check_has_a_line_for_each_configuration_and_all_rows_folded_away(page, evidence):
    lines = rows_of(page, "Cross-check")
    assert [line[0] for line in lines] == [NAMES[name] for name in CONFIGURATIONS]
    for line, rows in zip(lines, evidence.predicted.values(), strict=True):
        assert line[1] == f"{sum(row.explained for row in rows)} of 10"
        ratios = [pretty(number(row.ratio)) for device in DEVICES for row in rows if row.cell.profile == device]
        assert ", ".join(line[2:]).split(", ") == ratios
    assert len(rows_of(page, "Cross-check", table=1)) == len(TABLES_2_TO_5)
    assert page.index("<details>") < page.index("Every predicted number") < page.index("</details>")


def test_parameters_and_spring_laws_are_there(page, evidence):
    parameters = rows_of(page, "What the tables determine")
    for cells, item in zip(parameters, evidence.identification["spread"], strict=True):
        assert cells[:2] == [item["name"], pretty(f"{item['value']:.4g}")]
        assert cells[5] == ("yes" if item["determined"] else "no")
    springs = rows_of(page, "Which spring laws the tables allow")
    for cells, item in zip(springs, evidence.identification["springs"], strict=True):
        rows = evidence.springs[item["law"]]
        assert (cells[0], cells[8]) == (item["law"], str(sum(row.explained for row in rows)))


def test_claims_and_hypotheses_are_there(page, evidence):
    shown = rows_of(page, "Claims of the paper")
    for cells, item in zip(shown, evidence.claims, strict=True):
        assert cells[0] == item.claim.section
        assert ("contradict it" in cells[2]) == item.contradicted
        truth = {True: "holds", False: "does not hold", None: "undecided"}[item.ours.holds]
        assert cells[3].startswith(truth)
    assert len(shown) == len(CLAIMS)
    text = text_of(page)
    for answer in evidence.hypotheses:
        assert f"{answer.number}. {answer.verdict.capitalize()}" in text
        assert all(text_of(pretty(f"{item.case}: {item.question}")) in text for item in answer.criteria)
        assert text_of(pretty(answer.paper)) in text


def test_the_figures_come_after_the_tables_with_caption_and_what_these_devices_show(evidence):
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    name = "figure_8_variable_stiffness"
    full = render(replace(evidence, remarks={name: "a < b on `ours`"}), {name: figure})
    assert re.search(r"<strong>Figure 8.</strong> Step response.* a &lt; b on <code>ours</code></figcaption>", full)
    assert full.count("<svg") == 1
    assert full.index('id="table-5"') < full.index('id="figures"') < full.index('id="readings"')
    needs_nothing_else(full)
    assert "<figure" not in render(evidence, {})


def test_it_needs_nothing_else_and_its_contents_lead_somewhere(page):
    needs_nothing_else(page)
    assert len(re.findall('href="#', page)) > 10


def needs_nothing_else(page: str) -> None:
    assert "<script" not in page
    assert "<link" not in page
    assert "@import" not in page
    assert not re.findall(r"\bsrc\s*=", page)
    targets = re.findall(r'href="([^"]*)"', page) + re.findall(r"url\(([^)]*)\)", page)
    for target in targets:
        assert target.startswith("#")
        assert page.count(f'id="{target[1:]}"') == 1, target


def test_what_is_code_looks_like_code(page):
    assert "`" not in page
    assert "<code>amulett identify</code>" in page


def test_text_is_escaped_and_a_missing_number_is_a_dash(evidence):
    row, *others = evidence.reproduction.rows
    lost = Row(row.cell, None, None, None, row.unit, False, "1 of 1 failed: <b>limit</b>")
    entry, *entries = evidence.identification["spread"]
    page = render(
        replace(
            evidence,
            reproduction=replace(evidence.reproduction, rows=(lost, *others)),
            identification={**evidence.identification, "spread": [{**entry, "source": "<i>wide</i>"}, *entries]},
        ),
        {},
    )
    assert "<b>limit" not in page and "&lt;b&gt;limit" in page
    assert "<i>wide" not in page and "&lt;i&gt;wide" in page
    assert rows_of(page, "Table 2")[0][2:5] == ["-", "", "-"]


def test_the_page_has_the_variations(page):
    heading = "What changes with other judgement calls"
    assert rows_of(page, heading, 0) == [["1 to 10 (reported)", "8", "7", "6", "12", "33"]]
    assert rows_of(page, heading, 1) == [["5", "8", "7", "6", "13", "34"]]
    (line,) = rows_of(page, heading, 2)
    assert line[0].endswith("(shipped)")
    assert line[1:] == ["3, 0.2 deg", "4, 0.5 deg", "5, 1.2 deg"]
    assert rows_of(page, heading, 3) == [["clamp", "4.5", "2.5"]]
    assert rows_of(page, heading, 4) == [["mean", "0.950", "0.97"]]


def test_the_page_has_the_rise_time_of_the_string_force(page):
    (line,) = rows_of(page, "Rise time of the string force")
    assert line == ["testbed", "5 N", "0.25", "-", "0 of 10", "50 %"]


@pytest.mark.parametrize(("choice", "ours"), [("swapped", "biceps"), ("as-printed", "triceps")])
def test_columns_of_table_5_name_the_drive_that_they_are_compared_with(evidence, choice, ours):
    readings = Readings(isav_columns=choice)
    reproduction = replace(evidence.reproduction, readings=readings)
    assert our_drive("triceps", readings) == ours
    assert f"column triceps / drive of the {ours} [rad2/s]" in overview(reproduction).head[5]
    note = cross_check_table(replace(evidence, reproduction=reproduction)).note
    assert f"column triceps (here drive of the {ours})" in note
    assert ("taken as exchanged" in exchange_in_words(readings)) == (choice == "swapped")


def test_the_page_says_that_the_columns_of_table_5_are_exchanged(evidence, page):
    assert exchange_in_words(evidence.reproduction.readings) in text_of(page)
