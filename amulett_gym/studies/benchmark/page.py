"""The output files of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE
from amulett_gym.evaluation.metrics import COST_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.reporting.page import fill_page
from amulett_gym.reporting.table import Table, fill
from amulett_gym.reporting.words import number, with_interval
from amulett_gym.storage.writing import after_results, write_json, write_text
from amulett_gym.studies.benchmark.by_loop import answers
from amulett_gym.studies.benchmark.claims import Claim, as_plain
from amulett_gym.studies.benchmark.description import loop_of
from amulett_gym.studies.benchmark.results import Content, write_worst
from amulett_gym.studies.benchmark.stages import Evidence
from amulett_gym.studies.benchmark.tables import FOLDER as TABLES
from amulett_gym.studies.benchmark.tables import HOLDS, tables, write_csv

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

RESULTS, PAGE, FIGURES = "benchmark.json", "benchmark.html", "figures"

_COLOURED = {
    word: Markup(f'<span class="{kind}">{shown}</span>')
    for word, kind, shown in zip(HOLDS.values(), ("yes", "no", "open"), ("yes", "no", "–"), strict=True)
}

CAPTIONS = {
    "score": "Score on each suite's first held-out scenarios (their number in parentheses), with 95 % intervals. "
    "Arrows: beyond the axis.",
    "ratios": "Cost divided by eq. 6's in the same scenarios, by suite and split, with 95 % intervals.",
    "pareto": "Ratios to eq. 6's values, with paired 95 % intervals. Left: effort over position ISE. Right: deflection "
    "of a held posture under pushes over the peak torque of a contact. Lines: the constants. Lower left is better.",
    "law": "Tension setpoint over position error. Black: both forms of eq. 6 (the paper's Figure 6). Dots: agent steps "
    "of up to 100 held-out scenarios; thick lines: medians while the joint moves towards the setpoint, stands or moves "
    "away. Of a learned policy, the training seed with the lowest validation cost is shown.",
    "law_by_velocity": "Median tension setpoint over position error and the rate at which the joint approaches its "
    "setpoint (below zero it moves away). Grey: too few agent steps. Eq. 6 does not depend on the rate.",
    "responses": "The same step with each contender: joint angle, and the antagonist's tension with its setpoint.",
    "profiles": "Performance profiles: the share of episodes whose cost is at most the value on the axis; for learned "
    "policies with 95 % intervals.",
    "families": "The main suite by family: cost divided by eq. 6's, with the number of scenarios in parentheses.",
    "constants": "Cost of a constant tension on the split train, divided by that of the best constant: the best "
    "constant depends on the suite, and on the control loop.",
    "learning": "Validation cost of every training run over agent steps and over wall-clock time. Dotted: cost of the "
    "laws on the same scenarios.",
    "resting": "Resting stiffness, and deflection under pushes: shows whether a cost is low only because the arm is "
    "slack. All contenders, all constants.",
    "search": "Mean cost of the clairvoyant search over the number of episodes tried for each scenario.",
    "worst": "The scenario in which the learned policy is worst, compared with the best tuned law.",
}


def write_benchmark(evidence: Evidence, found: Content, claims: list[Claim], folder: str | Path) -> dict[str, Figure]:
    """Write ``benchmark.json``, tables, lost scenarios, figures, then ``benchmark.html``; return the figures.

    All numbers are written before anything is drawn. Raises AmulettError if the folder cannot be written.
    """
    folder = Path(folder)
    write_csv(found, claims, folder / TABLES)
    write_worst(evidence, found, folder)
    write_json(folder / RESULTS, judged(found, claims))
    with after_results(f"{RESULTS} and {TABLES} in {folder}"):
        from amulett_gym.reporting.style import save_figures
        from amulett_gym.studies.benchmark.figures import draw

        figures = draw(evidence, found)
        save_figures(figures, folder / FIGURES)
        write_text(folder / PAGE, render(found, claims, figures))
    return figures


def judged(found: Content, claims: list[Claim]) -> Content:
    """Return the content of ``benchmark.json``: measurements, claims, verdict."""
    return {**found, "claims": as_plain(claims), "verdict": verdict(found, claims)}


def render(found: Content, claims: Sequence[Claim], figures: Mapping[str, Figure]) -> str:
    """Return the page: one HTML file with inline figures, styles and no script."""
    return filled(
        *("studies/benchmark/benchmark.html.j2", found, claims, tables(found, claims), figures, CAPTIONS),
        verdict=verdict(found, claims),
        answers=said(found),
        description=found["description"],
    )


def filled(
    template: str,
    found: Content,
    claims: Sequence[Claim],
    made: Mapping[str, Table],
    figures: Mapping[str, Figure],
    captions: Mapping[str, str],
    **more: Any,
) -> str:
    """Return a page with tables and figures; `more` are further variables of its template."""
    from amulett_gym.reporting.style import figure_svg

    if claims:
        rows = [[*row[:4], _COLOURED[row[4]], row[5]] for row in made["claims"].rows]
        made = {**made, "claims": replace(made["claims"], rows=rows)}
    return fill_page(
        template,
        found=found,
        not_met=not_met(claims),
        titles={name: table.title for name, table in made.items()},
        tables={
            name: table.html("stack" if name == "claims" else "stack lines narrow") for name, table in made.items()
        },
        figures={name: figure_svg(figure, name) for name, figure in figures.items()},
        captions=captions,
        **more,
    )


def verdict(found: Content, claims: Sequence[Claim]) -> str:
    """Return in a few sentences the learned entry's cost, and how many claims are met or why none is judged."""
    place = f"{found['description']['headline']}/held-out"
    results, best, law = found["results"][place], found["best_learned"], found["best_by_hand"]
    scenarios = f"{found['description']['episodes']} held-out scenarios of {found['description']['headline']}"
    costs = number(results[law]["ratio"][YARDSTICK]["mean"])
    cost = METRICS[COST_OF[found.get("track", SCHEDULE)]].name
    if best is None:
        others = any(entry["kind"] == "learned" for entry in found["entries"].values())
        where = f" in {loop_of(found['constants']['overall'])}, the loop of the best constant" if others else ""
        return f"Nothing was learned{where}. The best tuned law, {law}, has {costs} of eq. 6's {cost} in {scenarios}."
    seeds = len(found["entries"][best]["seeds"])
    text = (
        f"{best}, over {seeds} training seed{'s' if seeds > 1 else ''}, has "
        f"{with_interval(results[best]['ratio'][YARDSTICK])} of eq. 6's {cost} in {scenarios}; the best tuned law, "
        f"{law}, has {costs}."
    )
    if found.get("quick"):
        steps = max(run["steps"] for run in found["training"][best]["runs"].values())
        return (
            f"{text} This was a quick run, which only shows that everything works: {found['description']['episodes']} "
            f"scenarios for each suite and {steps:,} training steps for each seed. No claim is judged by it."
        )
    judged = [claim for claim in claims if claim.holds is not None]
    return f"{text} {sum(bool(claim.holds) for claim in judged)} of {len(judged)} claims are met."


def said(found: Content) -> list[str]:
    """Return the answers to the questions of the track *full control*; none on *schedule*, or if the run was quick."""
    return answers(found) if found.get("track") == FULL_CONTROL and not found.get("quick") else []


def not_met(claims: Sequence[Claim]) -> list[str]:
    """Return one line for each claim that is not met."""
    return [f"Not met: {claim.about}: {claim.claim}" for claim in claims if claim.holds is False]


def in_words(found: Content, claims: Sequence[Claim]) -> str:
    """Return the text for the terminal: claims, ranking, verdict."""
    made = tables(found, claims)
    shown = [made["ranking"]]
    if claims:
        table = made["claims"]
        shown = [replace(table, head=table.head[:5], rows=[row[:5] for row in table.rows], left=(0, 1)), *shown]
    lines = "\n".join(map(fill, (verdict(found, claims), *said(found), *not_met(claims))))
    return "\n\n".join([*(table.text() for table in shown), lines])
