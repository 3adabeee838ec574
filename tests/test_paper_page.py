"""The page has every number, needs nothing else, and escapes what it is given."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from amulett_gym.evaluation.results import number, pretty
from amulett_gym.paper.claims import CLAIMS, check_claims
from amulett_gym.paper.hypotheses import answer_hypotheses
from amulett_gym.paper.page import render
from amulett_gym.paper.reproduction import ALTERNATIVES, Reproduction, Row, reproduce
from amulett_gym.paper.results import entry
from amulett_gym.paper.statements import our_numbers
from amulett_gym.paper.tables import TABLES_2_TO_5

SECTIONS = ("Cross-check", "Which parameters the tables determine", "Which spring laws the tables allow", "Figures")


@pytest.fixture(scope="module")
def reproduction() -> Reproduction:
    return reproduce()


@pytest.fixture(scope="module")
def answers(reproduction):
    """Claims and hypotheses, without motions: those are undecided."""
    return check_claims(reproduction, {}), answer_hypotheses(our_numbers(reproduction))


@pytest.fixture(scope="module")
def page(reproduction, answers) -> str:
    return render(reproduction, *answers, {})


def rows_of(page: str, heading: str) -> list[list[str]]:
    """Return the cells of the table below a heading, as text."""
    table = page.split(f"<h2>{heading}")[1].split("<tbody>")[1].split("</tbody>")[0]
    rows = re.findall(r"<tr.*?</tr>", table, flags=re.DOTALL)
    cells = [re.findall(r"<td.*?</td>", row, flags=re.DOTALL) for row in rows]
    return [[html.unescape(" ".join(re.sub(r"<.*?>", " ", cell).split())) for cell in row] for row in cells]


def test_every_number_of_the_tables_is_there_beside_ours(page, reproduction):
    for table in (2, 3, 4, 5):
        shown = rows_of(page, f"Table {table}")
        rows = [row for row in reproduction.rows if row.cell.table == table]
        for cells, row in zip(shown, rows, strict=True):
            assert pretty(f"{row.cell.value:g}") in cells
            ours = pretty(number(row.ours, 4))
            assert any(cell == ours or cell.startswith(f"{ours} ±") for cell in cells)
            assert ("not explained" in cells) != row.explained
            assert row.cell.drive is None or row.cell.drive in cells


def test_it_says_how_many_numbers_are_explained(page, reproduction):
    explained = sum(row.explained for row in reproduction.rows)
    assert f"{explained} of the {len(TABLES_2_TO_5)} numbers of Tables 2-5 are explained" in page


def test_every_reading_is_there(page):
    assert len(rows_of(page, "Readings")) == 1 + len(ALTERNATIVES)


def test_claims_and_hypotheses_are_there(page, answers):
    claims, hypotheses = answers
    shown = rows_of(page, "The paper's claims")
    for cells, item in zip(shown, claims, strict=True):
        assert cells[0] == item.claim.section
        assert ("contradict it" in cells[2]) == item.contradicted
        truth = {True: "holds", False: "does not hold", None: "undecided"}[item.ours.holds]
        assert cells[3].startswith(truth)
    assert len(shown) == len(CLAIMS)
    for answer in hypotheses:
        assert f"{answer.number}. {answer.verdict.capitalize()}" in page


def test_sections_appear_only_with_what_they_show(page, reproduction, answers):
    assert not any(f"<h2>{section}" in page for section in SECTIONS)
    rows = [
        {**row, "left_out": "variable"} for row in map(entry, reproduction.rows) if row["configuration"] == "variable"
    ]
    ratio = {
        "name": "R_1/R_2",
        "unit": "",
        "value": 0.2871,
        "low": 0.25,
        "high": 0.31,
        "determined": True,
        "source": "x",
    }
    identification = {
        "cross_check": rows,
        "spread": [ratio, {**ratio, "name": "<i>width</i>", "determined": False}],
        "springs": [{"law": "geometric", "length_ratio": 0.9, "cost": 12.3, "met": 20, "of": 40, "stiffening": 1.7}],
    }
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    full = render(reproduction, *answers, {"figure_5b_force": figure}, identification, {"figure_5b_force": "a < b"})
    assert all(f"<h2>{section}" in full for section in SECTIONS)
    assert len(rows_of(full, "Cross-check")) == len(rows)
    assert rows_of(full, "Which parameters")[0][:4] == ["R_1/R_2", "0.287", "0.250", "0.310"]
    assert rows_of(full, "Which parameters")[1][5] == "not determined"
    assert rows_of(full, "Which spring laws") == [["geometric", "0.900", "12.3", "20 of 40", "1.70"]]
    assert "<strong>Figure 5b.</strong> a &lt; b" in full
    assert "<i>width" not in full and "&lt;i&gt;width" in full
    assert full.count("<svg") == 1
    needs_nothing_else(full)


def test_it_needs_nothing_else(page):
    needs_nothing_else(page)


def needs_nothing_else(page: str) -> None:
    assert "<script" not in page
    assert "<link" not in page
    assert "@import" not in page
    assert not re.findall(r"\bsrc\s*=", page)
    assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', page))
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", page))


def test_text_is_escaped_and_a_missing_number_is_a_dash(reproduction, answers):
    row = reproduction.rows[0]
    lost = Row(row.cell, None, None, None, row.unit, False, "1 of 1 failed: <b>limit</b>")
    page = render(replace(reproduction, rows=(lost, *reproduction.rows[1:])), *answers, {})
    assert "<b>limit" not in page and "&lt;b&gt;limit" in page
    assert rows_of(page, "Table 2")[0][3:5] == ["-", "-"]
