"""The tables of a benchmark, which are also written as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.evaluation.metrics import COST_OF, EFFORT_OF, METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.contenders import CONSTANT, split_loop
from amulett_gym.reporting.table import Table, csv_text
from amulett_gym.reporting.words import interval, number, with_interval
from amulett_gym.storage.writing import write_text
from amulett_gym.studies.benchmark.by_loop import by_loop
from amulett_gym.studies.benchmark.claims import Claim
from amulett_gym.studies.benchmark.description import PAPER_STEP
from amulett_gym.studies.benchmark.results import POSITION_ONLY, SEARCHED, TUNED_LAW, Content

FOLDER = "tables"

HOLDS = {True: "yes", False: "NO", None: "-"}
"""Whether a claim is met, in words."""

Estimate = Mapping[str, float | None]


def tables(found: Content, claims: Sequence[Claim]) -> dict[str, Table]:
    """Return all tables by name, without empty ones."""
    full = found["track"] == FULL_CONTROL
    made = {
        "claims": claims_table(claims),
        **(by_loop(found) if full else {}),
        "ranking": ranking(found),
        "suites": by_suite(found),
        **({} if full else {"scores": scores(found)}),
        "metrics": physical(found),
        "paper_step": paper_step(found),
        **({} if full else {"constants": constants(found)}),
        "seeds": by_seed(found),
        "ablations": ablations(found),
        "references": references(found),
        "budgets": budgets(found),
        "worst": worst(found),
    }
    return {name: table for name, table in made.items() if table.rows}


def claims_table(claims: Sequence[Claim]) -> Table:
    """Return the claims, the measured numbers, and whether they hold."""
    rows = [
        [
            *(claim.about, claim.claim),
            str(claim.measured) if isinstance(claim.measured, int) else number(claim.measured),
            *(interval(claim.low, claim.high), HOLDS[claim.holds], claim.note),
        ]
        for claim in claims
    ]
    held, judged = sum(claim.holds is True for claim in claims), sum(claim.holds is not None for claim in claims)
    note = f"{held} of {judged} claims are met. A dash: not measured here, or reported only."
    head = ("scenarios", "claim", "measured", "95 % interval", "met", "what is measured")
    return Table("Claims", head, rows, note, left=(0, 1, 5))


def ranking(found: Content) -> Table:
    """Return all contenders on the headline suite, held-out, the lowest cost first."""
    place, overall = _headline(found), found["constants"]["overall"]
    rows = []
    for name, numbers in sorted(_reported(found, place).items(), key=lambda item: item[1]["cost"]["mean"]):
        better, failures = numbers["better_than"].get(TUNED_LAW), numbers["failures"]
        rows.append(
            [
                label(found, name),
                number(numbers["cost"]["mean"]),
                *(with_interval(numbers["ratio"].get(other)) for other in (YARDSTICK, overall, TUNED_LAW)),
                *(number(numbers[key]["mean"]) for key in ("iqm", "worst_decile")),
                "-" if better is None or better["mean"] is None else f"{better['mean']:.0%}",
                f"{failures['count']} of {failures['total']}",
                number(numbers["metrics"]["resting_stiffness"]["mean"]),
            ]
        )
    head = (
        *("", "cost", "ratio to eq6", "ratio to the best constant", f"ratio to {TUNED_LAW}", "IQM", "CVaR"),
        *(f"P(cost below {TUNED_LAW}'s)", "failed", METRICS["resting_stiffness"].heading),
    )
    note = (
        "Ratios of costs in the same scenarios, with 95 % intervals over training seeds and scenarios. IQM: "
        "interquartile mean, the mean of the middle half; CVaR: mean of the worst tenth; P: share of scenarios in "
        f"which the cost is below that of {TUNED_LAW}, a tie counts half. {_position_only(found)}"
    )
    return Table(f"{_words(place)}: all contenders by {_cost(found)}", head, rows, note)


def by_suite(found: Content) -> Table:
    """Return each entry's cost as a share of eq. 6's on every suite and split."""
    names = [name for name in found["entries"] if is_main(found, name) and name != YARDSTICK]
    rows = []
    for place, results in found["results"].items():
        ratios, best = _to_eq6(results), found["constants"]["best"][place.split("/")[0]]
        constant = f"{label(found, best).removeprefix('constant ')}: {number(ratios[best]['mean'])}"
        rows.append([_words(place), constant, *(with_interval(ratios.get(name)) for name in names)])
    head = ("", "best constant on this suite", *(label(found, name) for name in names))
    note = (
        "Cost divided by that of eq. 6 (as its text describes it) in the same scenarios. A suite's best constant is "
        "chosen on its split train."
    )
    return Table("Cost divided by eq. 6's, by suite and split", head, rows, note)


def scores(found: Content) -> Table:
    """Return scores: 0 is the best constant overall, 1 the clairvoyant reference."""
    names = [name for name in found["entries"] if is_main(found, name)]
    rows = [
        [f"{suite} ({goal['scenarios']})", *(with_interval(goal["score"].get(name)) for name in names)]
        for suite, goal in found["references"]["clairvoyant"].items()
    ]
    note = (
        "On the suite's first held-out scenarios (their number in parentheses). 0: the best constant overall; 1: the "
        "clairvoyant reference. " + _position_only(found)
    )
    return Table("Score", ("", *(label(found, name) for name in names)), rows, note)


def physical(found: Content) -> Table:
    """Return physical metrics on the headline suite, held-out, and their ratios to eq. 6's."""
    keys = (
        *("position_ise", "isav_biceps", "isav_triceps", EFFORT_OF[found["track"]], "contact_ise", "contact_peak"),
        *("push_deflection", "resting_stiffness"),
    )
    effort = METRICS[EFFORT_OF[found["track"]]]
    note = (
        f"Means over all episodes; in parentheses the ratio to eq. 6's. {effort.name.capitalize()}: {effort.meaning}. "
        "Stiffness is not better or worse by itself."
    )
    place = _headline(found)
    head = ("", *(METRICS[key].heading for key in keys))
    return Table(f"{_words(place)}: physical metrics", head, _metric_rows(found, place, keys), note)


def paper_step(found: Content) -> Table:
    """Return the metrics of the paper's Tables 2-5 on its step."""
    keys = ("rise_time", "settling_time", "position_ise", "tension_ise", "isav_biceps", "isav_triceps", "overshoot")
    note = (
        "In parentheses the ratio to eq. 6's. Tension ISE: computed from the true force. Episodes differ by sensor "
        "noise only."
    )
    head = ("", *(METRICS[key].paper_heading for key in keys))
    return Table("The paper's step", head, _metric_rows(found, f"{PAPER_STEP}/held-out", keys), note)


def constants(found: Content) -> Table:
    """Return the costs of constants on each suite's split train."""
    tried, best = found["constants"]["tried"], found["constants"]["best"]
    names = list(next(iter(tried.values())))
    rows = [[suite, *(number(costs[name]) for name in names), _tension(best[suite])] for suite, costs in tried.items()]
    overall = _tension(found["constants"]["overall"])
    headline = found["description"]["headline"]
    note = f"Mean cost on the split train, on which constants are chosen. Chosen overall, on {headline}: {overall}."
    head = ("", *map(_tension, names), "best")
    return Table("How the best constant differs between suites", head, rows, note)


def by_seed(found: Content) -> Table:
    """Return the costs of each training seed on the headline suite, held-out."""
    rows = []
    for name, numbers in found["results"][_headline(found)].items():
        ratios, missing = numbers.get("seed_ratios", {}), [None] * len(found["entries"][name]["seeds"])
        if found["entries"][name]["kind"] not in ("learned", "reference"):
            continue
        for k, seed in enumerate(found["entries"][name]["seeds"]):
            run = found["training"][name]["runs"][str(seed)]
            against = (ratios.get(other, missing)[k] for other in (YARDSTICK, TUNED_LAW))
            costs = (number(cost, 4) for cost in (numbers["seeds"][k], *against, run["best_cost"]))
            steps = (f"{run[key]:,}" for key in ("best_steps", "steps"))
            rows.append([f"{name}, seed {seed}", *costs, *steps, f"{run['seconds']:.0f}"])
    head = (
        *("", "cost", "ratio to eq6", f"ratio to {TUNED_LAW}", "capped cost on validation"),
        *("steps of the chosen policy", "steps", "training time [s]"),
    )
    return Table("Training seeds, one by one", head, rows)


def ablations(found: Content) -> Table:
    """Return the costs of the learned entry trained without each reward term."""
    place = _headline(found)
    ratios, keys = _to_eq6(found["results"][place]), ("position_ise", "effort", "contact_ise")
    names = [name for name, entry in found["entries"].items() if entry["kind"] == "ablation"]
    rows = [
        [label(found, name), with_interval(ratios[name]), *_metric_cells(found["results"][place][name], keys)]
        for name in (found["best_learned"], *names)
        if names
    ]
    head = ("", "cost, ratio to eq6", *(METRICS[key].heading for key in keys))
    note = (
        "Trained again with one weight of the reward set to zero, one seed each; evaluated with the same cost as all."
    )
    return Table("Without a reward term", head, rows, note)


def references(found: Content) -> Table:
    """Return the references' costs, the shares of the gap to them that are closed, and checks of the search."""
    best, rows = found["best_learned"], []
    for kind in SEARCHED:
        for suite, goal in found["references"][kind].items():
            second = goal.get("second_search")
            rows.append(
                [
                    *(f"{kind}, {suite} ({goal['scenarios']})", number(goal["cost"], 4)),
                    *map(with_interval, (goal["ratio_to_eq6"], goal["share_from_hand"].get(best))),
                    *(number(goal["with_other_noise"], 4), f"{goal['last_quarter']:.2%}"),
                    " and ".join(number(cost, 4) for cost in goal["searches_alone"]),
                    "-" if second is None else f"{second['either'] - 1:+.2%} ({second['scenarios']})",
                    f"{goal['cost_more_than_an_entry']} of {goal['scenarios']}",
                ]
            )
    solved = found["references"].get("optimal")
    if solved is not None:
        shares = with_interval(solved["ratio_to_eq6"]), with_interval(solved["share_from_hand"].get(best))
        title = f"optimal control, {found['description']['headline']} ({solved['scenarios']})"
        rows.append([title, number(solved["cost"], 4), *shares, *"-----"])
    for name, goal in found["references"]["causal"].items():
        shares = with_interval(goal["ratio_to_eq6"]), with_interval(goal["share_from_hand"].get(best))
        rows.append([f"causal ({name})", number(goal["cost"], 4), *shares, *"-----"])
    head = (
        *("", "cost", "ratio to eq6", "share of the gap" + ("" if best is None else f", {best}"), "cost, other noise"),
        *("fall in the last quarter", "each start alone", "change by a second search", "contender below"),
    )
    note = (
        'In the row foresight, "cost" is with the scenarios\' own sensor noise, but "each start alone" and "fall in '
        'the last quarter" are with the noise draws of the search: do not compare them. Clairvoyant: the best schedule '
        "found for each scenario with everything known, its noise too. Foresight: the same without its noise; the "
        "search uses other draws. Share of the gap: 0 is "
        f"{found['references']['from']}, the best tuned law, 1 the reference. "
        "Cost, other noise: of the same schedules with new draws. Fall in the last quarter: of the mean cost, in the "
        "last quarter of the search. Each start alone: the cost reached from each of the search's two starts. Change "
        "by a second search (number of scenarios): of the mean cost, if each scenario gets the cheaper schedule of "
        "both searches. The second has another seed and twice as many rounds. Contender below: scenarios in which a "
        "policy or law costs less than the reference. All training seeds count, and so do the causal reference and "
        "trainings without a reward term. A lower cost has one of three reasons. "
        "The contender acts inside the loop (eq6, eq6-printed, position-only), which no schedule can do. "
        "Or the search did not converge. Or, for foresight, the contender reacts to the actual noise, which a "
        "schedule cannot."
    )
    if solved is not None:
        note += (
            " Optimal control: both drives are commanded directly within their limits, with the true device, pushes "
            "and contacts known, but no setpoint jump before it happens; local optima, no proven bound. Solved: "
            f"{solved['solved']} of {solved['scenarios']}."
        )
    return Table("References", head, rows, note)


def budgets(found: Content) -> Table:
    """Return how many episodes learning and tuning simulated."""
    rows = []
    for name, entry in found["training"].items():
        if "runs" in entry:
            runs = entry["runs"].values()
            times, episodes = sorted(run["seconds"] for run in runs), max(run["episodes"] for run in runs)
            rows.append([name, f"{episodes:,}", f"{len(times)}", f"{times[0]:.0f} to {times[-1]:.0f}"])
        else:
            rows.append([name, f"{entry['tuned_episodes']:,}", f"1 ({len(entry['recipe']['seeds'])} starts)", "-"])
    head = ("", "simulated episodes", "runs", "training time [s]")
    note = (
        "Simulated episodes: of one run; of a tuned law, the sum over all starts. Of a run: its agent steps divided by "
        "those of an episode (`env.max_episode_steps` of its recipe), plus one for each device, which is simulated "
        "before the training to stagger the devices' episodes (`staggered`)."
    )
    return Table("Cost of learning and tuning", head, rows, note)


def worst(found: Content) -> Table:
    """Return the scenarios in which the learned policy is worst, compared with the best tuned law."""
    rows = [
        [
            f"{item['family']}, seed {item['seed']}",
            *(number(item[key]) for key in ("learned", "by_hand", "eq6")),
            "yes" if item["loses"] else "no",
            item["file"],
        ]
        for item in found["worst"]
    ]
    head = ("", found["best_learned"], found["best_by_hand"], YARDSTICK, "higher cost", "scenario")
    note = (
        "Costs; for the learned policy the mean over its training seeds. Higher cost: yes if it is "
        f"above that of {found['best_by_hand']}. Replay: `amulett simulate --scenario FILE --suite "
        f"{found['description']['headline']} --law ...`."
    )
    return Table("Worst scenarios of the learned policy", head, rows, note)


def write_csv(found: Content, claims: Sequence[Claim], folder: Path) -> list[Path]:
    """Write the numbers as CSV: ``results``, ``seeds``, ``constants``, ``claims``, ``families``; return the paths."""
    files = {
        "results": (("suite", "split", "entry", "kind", "quantity", "against", "mean", "low", "high"), _long(found)),
        "seeds": (("suite", "split", "entry", "seed", "cost"), _seeds(found)),
        "constants": (
            ("suite", "constant", "train_cost"),
            ((suite, *item) for suite, costs in found["constants"]["tried"].items() for item in costs.items()),
        ),
        "claims": (
            ("about", "claim", "measured", "low", "high", "holds", "note"),
            ((c.about, c.claim, c.measured, c.low, c.high, c.holds, c.note) for c in claims),
        ),
        "families": (
            ("family", "scenarios", "entry", "ratio_to_eq6", "low", "high"),
            (
                (family, entry["scenarios"], name, *_three(estimate))
                for family, entry in found["families"].items()
                for name, estimate in entry["ratio_to_eq6"].items()
            ),
        ),
    }
    paths = [folder / f"{name}.csv" for name in files]
    for path, (head, rows) in zip(paths, files.values(), strict=True):
        write_text(path, csv_text(head, rows))
    return paths


def _long(found: Content) -> Iterable[Sequence[Any]]:
    for place, results in found["results"].items():
        suite, split = place.split("/")
        for name, numbers in results.items():
            about = suite, split, name, found["entries"][name]["kind"]
            for quantity in ("cost", "iqm", "worst_decile"):
                if quantity in numbers:
                    yield (*about, quantity, "", *_three(numbers[quantity]))
            for quantity in ("ratio", "better_than"):
                for other, estimate in numbers.get(quantity, {}).items():
                    yield (*about, quantity, other, *_three(estimate))
            failures = numbers["failures"]
            yield (*about, "failed", "", failures["count"] / failures["total"], failures["low"], failures["high"])
            for metric, estimate in numbers["metrics"].items():
                yield (*about, metric, "", *_three(estimate))
                if "ratio_to_eq6" in estimate:
                    yield (*about, f"ratio of {metric}", YARDSTICK, *_three(estimate["ratio_to_eq6"]))


def _seeds(found: Content) -> Iterable[Sequence[Any]]:
    for place, results in found["results"].items():
        suite, split = place.split("/")
        for name, entry in found["entries"].items():
            costs = results[name]["seeds"] if name in results else []
            for seed, cost in zip(entry["seeds"], costs, strict=False):
                yield suite, split, name, seed, cost


def _three(estimate: Estimate) -> tuple[float | None, float | None, float | None]:
    return estimate["mean"], estimate["low"], estimate["high"]


def _metric_rows(found: Content, place: str, keys: Sequence[str]) -> list[list[str]]:
    """Return metrics of all entries on a suite and split; nothing if it was not played."""
    return [[label(found, name), *_metric_cells(numbers, keys)] for name, numbers in _reported(found, place).items()]


def _metric_cells(numbers: Content, keys: Iterable[str]) -> list[str]:
    cells = []
    for key in keys:
        mean, over = numbers["metrics"][key]["mean"], numbers["metrics"][key]["ratio_to_eq6"]["mean"]
        cells.append(number(mean) + ("" if over is None else f" ({number(over)})"))
    return cells


def _reported(found: Content, place: str) -> Content:
    """Return the results on a suite and split of all entries but ablations that have more than a cost."""
    return {
        name: numbers
        for name, numbers in found["results"].get(place, {}).items()
        if "iqm" in numbers and found["entries"][name]["kind"] != "ablation"
    }


def _headline(found: Content) -> str:
    return f"{found['description']['headline']}/held-out"


def _words(place: str) -> str:
    return place.replace("/", ", ")


def _to_eq6(results: Content) -> dict[str, Estimate]:
    return {name: numbers["ratio"][YARDSTICK] for name, numbers in results.items()}


def _tension(constant: str) -> str:
    return f"{constant.removeprefix(CONSTANT)} N"


def is_main(found: Content, name: str) -> bool:
    """Return whether an entry is shown everywhere.

    These are all but ablations, and but constants other than the best overall. On *full control*, with its many laws,
    they are eq. 6 in the paper's loop, the best constant of each loop, and what was learned or is the user's own.
    """
    kind, best = found["entries"][name]["kind"], [found["constants"]["overall"]]
    if found["track"] == FULL_CONTROL:
        best = [YARDSTICK, *found["constants"]["best_by_loop"][found["description"]["headline"]]]
    left_out = ("constant", "ablation", *(["law"] if found["track"] == FULL_CONTROL else []))
    return kind not in left_out or name in best


def label(found: Content, name: str) -> str:
    """Return an entry's label: constants by their tension, trained entries with the number of their seeds."""
    loop, law = split_loop(name)
    if law.startswith(CONSTANT):
        return f"{loop}, constant {_tension(law)}".removeprefix(", ")
    count = len(found["entries"][name]["seeds"])
    return f"{name} ({count} seeds)" if count > 1 else name


def _cost(found: Content) -> str:
    return METRICS[COST_OF[found["track"]]].name


def _position_only(found: Content) -> str:
    if POSITION_ONLY not in found["entries"]:
        return ""
    return (
        f"{POSITION_ONLY} has other gains and no tension loop: it follows no tension schedule, so its cost can be "
        "below that of a reference."
    )
