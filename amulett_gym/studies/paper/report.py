"""Reports of a reproduction: terminal, files, HTML page, generated part of a document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from amulett_gym import __version__
from amulett_gym.reporting.document import image, marks, update_document
from amulett_gym.reporting.page import fill_page
from amulett_gym.reporting.table import Table, csv_text, fill
from amulett_gym.reporting.words import html, number, pretty
from amulett_gym.storage.writing import after_results, write_json, write_text
from amulett_gym.studies.paper.claims import METRICS, CheckedClaim, Verdict
from amulett_gym.studies.paper.figures import CAPTIONS, paper_figures, with_remark
from amulett_gym.studies.paper.reproduction import MEASUREMENT_TIME, Reproduction, explained
from amulett_gym.studies.paper.results import (
    HOLDS,
    TABLES,
    Evidence,
    bounds_in_words,
    content,
    counts_in_words,
    cross_check_table,
    exchange_in_words,
    force_rise_table,
    hypothesis_table,
    overview,
    paper_table,
    place,
    predictions_table,
    readings_content,
    readings_table,
    rows_content,
    sensitivity_tables,
    springs_table,
    status,
)
from amulett_gym.studies.paper.study_words import spread_table
from amulett_gym.studies.paper.tables import PROTOCOL

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

MARKS = marks("amulett reproduce")
"""Lines around the generated part of a document."""

REPRODUCTION_MARKS = ("reproduction.json",)
"""The file by which a reproduction's folder is recognised; it is written first."""

_KINDS = {**dict(zip(HOLDS.values(), ("yes", "no", "open"), strict=True)), "supported": "yes", "not supported": "no"}
"""Words in cells -> their class on the page."""


def in_words(evidence: Evidence) -> str:
    """Return the evidence for the terminal: rows, readings, hypotheses, explanations."""
    reproduction = evidence.reproduction
    predicted = [row.explained for rows in evidence.predicted.values() for row in rows]
    shown = [
        *(paper_table(reproduction, table, short=True) for table in TABLES),
        readings_table(evidence),
        *(
            replace(hypothesis_table(answer), title=f"Hypothesis {answer.number}: {answer.verdict}")
            for answer in evidence.hypotheses
        ),
    ]
    sentences = (
        counts_in_words(evidence),
        bounds_in_words(),
        f"±: standard deviation of the testbed's {PROTOCOL.repetitions_testbed} repetitions, which differ by their "
        f"sensor noise. T of eqs. 7 and 8 is {MEASUREMENT_TIME:g} s. Table 2 is compared with the "
        f"{reproduction.readings.rise_time} time.",
        f"Fitted to three configurations, the model explains {sum(predicted)} of {len(predicted)} numbers of the one "
        "left out, over all four.",
        status(evidence),
    )
    return "\n\n".join([*(table.text() for table in shown), *map(fill, sentences)])


def draw(evidence: Evidence) -> dict[str, Figure]:
    """Return the paper's figures on our devices, by the names of `figures.CAPTIONS`."""
    return paper_figures(evidence.reproduction.profiles, evidence.reproduction.readings)


def write_numbers(evidence: Evidence, folder: str | Path) -> dict[str, Any]:
    """Write ``reproduction.json`` and the CSV files into a folder; return the content of ``reproduction.json``.

    ``rows.csv`` has the rows with their spread and nearest reading, ``readings.csv`` every row under every reading,
    ``claims.csv`` the paper's claims. Each file is written whole or not at all. The folder of a process that was killed
    is recognised and can be used again.

    Raises AmulettError if a file cannot be written.
    """
    folder = Path(folder)
    result = content(evidence)
    write_json(folder / "reproduction.json", result)
    for name, rows in (
        ("rows", rows_content(evidence, result)),
        ("readings", readings_content(evidence.reproduction)),
        ("claims", result["claims"]),
    ):
        write_text(folder / f"{name}.csv", csv_text(list(rows[0]), (row.values() for row in rows)))
    return result


def write_pictures(evidence: Evidence, folder: str | Path) -> dict[str, Figure]:
    """Draw the figures, write them and ``reproduction.html`` into the folder of the numbers, and return them.

    Raises AmulettError if a file cannot be written.
    """
    from amulett_gym.reporting.style import save_figures

    with after_results(f"reproduction.json and CSV files in {folder}"):
        figures = draw(evidence)
        save_figures(figures, Path(folder))
        write_text(Path(folder) / "reproduction.html", render(evidence, figures))
    return figures


def render(evidence: Evidence, figures: Mapping[str, Figure]) -> str:
    """Return a reproduction as one HTML page with inline styles, inline figures (may be none), and no script."""
    return fill_page(
        "studies/paper/reproduction.html.j2",
        counts=counts_in_words(evidence),
        status=status(evidence),
        bounds=bounds_in_words(),
        summary=_html(_summary(evidence.reproduction)),
        hypotheses=[(answer.number, _coloured(answer.verdict)) for answer in evidence.hypotheses],
        sections=[*_sections(evidence, figures)],
        measurement_time=f"{MEASUREMENT_TIME:g}",
        study=evidence.folder,
        versions={package: version(package) for package in ("numba", "numpy")} | {"amulett-gym": __version__},
    )


def block(evidence: Evidence) -> str:
    """Return the generated part of a document as Markdown."""
    spread = spread_table(evidence.identification)
    tables = (
        force_rise_table(evidence),
        readings_table(evidence),
        cross_check_table(evidence),
        replace(spread, head=spread.head[:-1], rows=[row[:-1] for row in spread.rows]),
        springs_table(evidence),
        *sensitivity_tables(evidence),
    )
    bold = {HOLDS[False]: f"**{HOLDS[False]}**"}
    hypotheses = []
    for answer in evidence.hypotheses:
        table = hypothesis_table(answer)
        rows = [[bold.get(cell, cell) for cell in row] for row in table.rows]
        hypotheses.append(f'**{answer.number}. {answer.verdict.capitalize()}.** "{answer.hypothesis}."')
        hypotheses.append(replace(table, rows=rows).markdown())
    parts = [
        *([] if evidence.folder is None else [status(evidence)]),
        f"### Tables 2-5\n\n{counts_in_words(evidence)} {bounds_in_words()}",
        "In the table: paper / this model (ratio); **bold**: not explained. "
        + exchange_in_words(evidence.reproduction.readings),
        overview(evidence.reproduction).markdown(),
        *(table.markdown() for table in tables),
        "### Hypotheses of section 1.2",
        *hypotheses,
        "### Claims of sections 3 to 5\n\n`reproduction.html` and `claims.csv` have them one by one, with numbers.",
        "### Figures",
        *(image(name, with_remark(text, evidence.remarks.get(name)), name) for name, text in CAPTIONS.items()),
    ]
    return pretty("\n\n".join(parts))


def write_document(evidence: Evidence, figures: Mapping[str, Figure], path: str | Path) -> None:
    """Renew the generated part of a document, and its figures (from `draw`) in the folder ``images`` next to it.

    Raises AmulettError as `reporting.document.check_document` does.
    """
    update_document(path, {MARKS: block(evidence)}, figures)


def _sections(evidence: Evidence, figures: Mapping[str, Figure]) -> Iterator[tuple[str, str, Markup]]:
    """Yield the page's sections: id, heading, content."""
    yield from (_section(f"table-{table}", paper_table(evidence.reproduction, table)) for table in TABLES)
    yield _section("force-rise", force_rise_table(evidence))
    if figures:
        yield "figures", "Figures", Markup("\n").join(_figure(evidence, *item) for item in figures.items())
    yield _section("readings", readings_table(evidence))
    folded = "<details><summary>Every predicted number</summary>{}</details>"
    anchor, title, shown = _section("cross-check", cross_check_table(evidence))
    yield anchor, title, shown + Markup(folded).format(_html(predictions_table(evidence)))
    yield _section("parameters", spread_table(evidence.identification))
    yield _section("springs", springs_table(evidence))
    varied = (Markup("<h3>{}</h3>").format(table.title) + _html(table) for table in sensitivity_tables(evidence))
    yield "sensitivity", "What changes with other judgement calls", Markup("\n").join(varied)
    yield _section("claims", _claims(evidence.claims))
    answers = (
        Markup("<h3>{}. {}</h3>\n<blockquote>“{}”</blockquote>\n").format(
            answer.number, answer.verdict.capitalize(), answer.hypothesis
        )
        + _html(hypothesis_table(answer))
        for answer in evidence.hypotheses
    )
    yield "hypotheses", "The hypotheses of section 1.2", Markup("\n").join(answers)


def _section(anchor: str, table: Table) -> tuple[str, str, Markup]:
    return anchor, table.title, _html(table)


def _summary(reproduction: Reproduction) -> Table:
    """Return the number of explained rows of each table, and the unexplained ones."""
    body = []
    for table, (count, size) in explained(reproduction.rows).items():
        missed = [row for row in reproduction.rows if row.cell.table == table and not row.explained]
        name = Markup('<a href="#table-{0}">Table {0}</a>').format(table)
        places = ", ".join(f"{place(row).replace(',', '')} ({number(row.ratio)})" for row in missed)
        body.append([name, METRICS[TABLES[table]], f"{count} of {size}", places or "none"])
    return Table(
        "", ("table", "metric", "explained", "not explained (ours divided by the paper's)"), body, left=(0, 1, 3)
    )


def _claims(claims: Sequence[CheckedClaim]) -> Table:
    """Return the paper's claims as a table with HTML cells: its words, the verdict of its own tables, and ours."""

    def verdict(found: Verdict | None, words: Mapping[bool | None, str]) -> Markup:
        if found is None:
            return Markup('<span class="open">print no number about it</span>')
        kind = dict(zip(HOLDS, ("yes", "no", "open"), strict=True))[found.holds]
        text = '<span class="{}">{}</span><span class="small wrapped">{}</span>'
        return Markup(text).format(kind, words[found.holds], html(found.words))

    return Table(
        "Claims of the paper, one by one",
        ("section", "the paper says", "its own tables", "ours"),
        [
            [
                Markup('<span id="{}">{}</span>').format(item.claim.id, item.claim.section),
                Markup('“{}”<span class="small wrapped">taken as: {}</span>').format(
                    html(item.claim.quote), html(item.claim.taken_as)
                ),
                verdict(item.paper, {True: "agree", False: "contradict it", None: "lack a number"}),
                verdict(item.ours, {True: "holds", False: "does not hold", None: "undecided: a number is missing"}),
            ]
            for item in claims
        ],
        "Changes are relative to position-only control unless another configuration is named. A change of half a "
        "percent or less counts as none.",
        left=(0, 1, 2, 3),
    )


def _figure(evidence: Evidence, name: str, figure: Figure) -> Markup:
    from amulett_gym.reporting.style import figure_svg

    title = " ".join(name.split("_")[:2]).capitalize()  # "Figure 5b"
    caption = with_remark(CAPTIONS.get(name, ""), evidence.remarks.get(name))
    return Markup('<figure id="{}">{}<figcaption><strong>{}.</strong> {}</figcaption></figure>').format(
        title.lower().replace(" ", "-"), Markup(figure_svg(figure, name)), title, html(caption)
    )


def _html(table: Table) -> Markup:
    """Return a table as HTML with coloured verdicts."""
    return replace(table, rows=[[_coloured(cell) for cell in row] for row in table.rows]).html("stack")


def _coloured(cell: str) -> str:
    kind = _KINDS.get(cell)
    return Markup('<span class="{}">{}</span>').format(kind, cell) if kind else cell
