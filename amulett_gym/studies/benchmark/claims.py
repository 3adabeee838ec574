"""Claims about the learned policy, each judged by the measured numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.evaluation.metrics import METRICS
from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.reporting.words import with_interval
from amulett_gym.studies.benchmark.description import PAPER_STEP, named
from amulett_gym.studies.benchmark.results import POSITION_ONLY, SEARCHED, TUNED_EQ6, TUNED_LAW, Content

COST_SHARE = 0.65
"""Largest share of eq. 6's cost that the learned policy may have, held-out."""

TRADE = 1.02
"""Largest ratio to eq. 6's value of a metric of Tables 2-5."""

HALF = 0.5

BEST_LOOP_SHARE = 0.5
"""Largest share of eq. 6's cost on the paper's step that the best loop may have, on *full control*."""

FEWEST_FAMILIES = 3
"""Fewest families in which a schedule learned in the best loop costs less than a constant, on *full control*."""

SEED_SHARE = 0.9
MOST_SECONDS = 300.0
"""Duration of one training run."""

PAPER_METRICS = ("settling_time", "position_ise", "tension_ise", "isav_biceps", "isav_triceps")
"""Metrics of the paper's Tables 2-5, as the reproduction reads them."""


@dataclass(frozen=True)
class Claim:
    """A claim with the measured number, None if there is none, and its 95 % interval, if any."""

    about: str  # suite and split, or another heading
    claim: str
    measured: float | None  # an int: a count
    low: float | None
    high: float | None
    holds: bool | None  # None: not measured, or reported without a claim
    note: str = ""


Number = dict[str, float | None]
Judge = Callable[[Any, Any, Any], bool]


def check_claims(found: Content) -> list[Claim]:
    """Return all claims, judged; none on a quick run.

    On the track *schedule* they are about the headline's learned entry: none if nothing was learned.
    """
    best = found["best_learned"]
    if found.get("track") == FULL_CONTROL:
        return [] if found.get("quick") else _on_full_control(found)
    if best is None or found.get("quick"):
        return []
    parts = (_on_held_out, _on_shares, _on_shifted, _on_paper_step, _on_seeds)
    return [claim for part in parts for claim in part(found, best)]


def as_plain(claims: list[Claim]) -> list[Content]:
    """Return claims as plain data."""
    return [asdict(claim) for claim in claims]


def _on_held_out(found: Content, best: str) -> list[Claim]:
    headline, overall = found["description"]["headline"], found["constants"]["overall"]
    about, results = f"{headline}, held-out", found["results"][f"{headline}/held-out"]
    mine, failures = results[best], results[best]["failures"]
    fewest = min(
        results[name]["failures"]["count"] / results[name]["failures"]["total"]
        for name, entry in found["entries"].items()
        if entry["kind"] not in ("ablation", "reference") and name != best
    )
    share = {"mean": failures["count"] / failures["total"], "low": failures["low"], "high": failures["high"]}
    note = f"{failures['count']} of {failures['total']} episodes; lowest rate of any contender: {fewest:.2%}"
    text = f"cost at most {COST_SHARE} of eq. 6's (as its text describes it)"
    beside = _beside_references(found, best)
    claims = [
        claim_of(about, text, mine["ratio"][YARDSTICK], _at_most(COST_SHARE), beside),
        *(
            claim_of(about, f"lower cost than {name}", mine["ratio"].get(other), _below_one, "ratio of costs")
            for other, name in (
                (overall, f"the best constant overall ({overall})"),
                (TUNED_EQ6, TUNED_EQ6),
                (TUNED_LAW, TUNED_LAW),
            )
        ),
        claim_of(about, "no more failures than any contender", share, _at_most(fewest), note),
    ]
    for key in ("position_ise", "isav_biceps", "isav_triceps"):
        ratio, text = mine["metrics"][key]["ratio_to_eq6"], f"{METRICS[key].name} below eq. 6's"
        claims.append(claim_of(about, text, ratio, lambda mean, low, high: mean < 1.0, "ratio"))
    if POSITION_ONLY in mine["ratio"]:
        note = "ratio of costs; reported only: position-only has other gains and no tension loop"
        claims.append(claim_of(about, "cost compared with position-only", mine["ratio"][POSITION_ONLY], None, note))
    return claims


def _beside_references(found: Content, best: str) -> str:
    """Return the references' shares of eq. 6's cost, and that of the learned entry in the same scenarios."""
    references, headline = found["references"], found["description"]["headline"]
    parts = []
    for kind in SEARCHED:
        goal = references[kind].get(headline)
        if goal is not None:
            beside = f"; {best} in these: {goal['entries_to_eq6'][best]['mean']:.3f}"
            parts.append(f"{kind} {goal['ratio_to_eq6']['mean']:.3f} (in {goal['scenarios']} scenarios{beside})")
    parts += [f"{name} {goal['ratio_to_eq6']['mean']:.3f}" for name, goal in references["causal"].items()]
    return f"ratio of costs; references: {', '.join(parts)}" if parts else "ratio of costs"


def _on_shares(found: Content, best: str) -> list[Claim]:
    references, headline = found["references"], found["description"]["headline"]
    goals = {"the clairvoyant reference": references["clairvoyant"].get(headline)}
    goals |= {f"the causal reference ({name})": causal for name, causal in references["causal"].items()}
    if not references["causal"]:
        goals["the causal reference"] = None
    about, gap = f"{headline}, held-out", f"the gap between {references['from']}, the best tuned law, and"
    claims = [
        claim_of(about, f"closes at least half of {gap} {name}", _share(goal, best), _at_least_half, _gap(goal, best))
        for name, goal in goals.items()
    ]
    foreseen = references["foresight"].get(headline)
    if foreseen is not None:
        text = f"share of {gap} the foresight reference that is closed"
        claims.append(claim_of(about, text, _share(foreseen, best), None, f"{_gap(foreseen, best)}; reported only"))
    return claims


def _share(goal: Content | None, best: str) -> Number | None:
    return None if goal is None else goal["share_from_hand"][best]


def _gap(goal: Content | None, best: str) -> str:
    """Return on how many scenarios a share of the gap is computed, or why there is none."""
    if goal is None:
        return "no such reference here"
    if goal["share_from_hand"][best]["mean"] is None:
        return "this reference costs no less than the law"
    return f"share of the gap, {goal['scenarios']} scenarios" if "scenarios" in goal else "share of the gap"


def _on_shifted(found: Content, best: str) -> list[Claim]:
    headline, overall = found["description"]["headline"], found["constants"]["overall"]
    results = found["results"].get(f"{headline}/shifted")
    mine = {} if results is None else results[best]["ratio"]
    return [
        claim_of(f"{headline}, shifted", f"lower cost than {name}", mine.get(other), _below_one, "ratio of costs")
        for other, name in ((YARDSTICK, "eq. 6"), (overall, f"the best constant overall ({overall})"))
    ]


def _on_paper_step(found: Content, best: str) -> list[Claim]:
    results = found["results"].get(f"{PAPER_STEP}/held-out")
    claims = []
    for key in PAPER_METRICS:
        name = METRICS[key].paper_name or METRICS[key].name
        ratio = None if results is None else results[best]["metrics"][key]["ratio_to_eq6"]
        text = f"{name} at most {TRADE} times eq. 6's, or 1 is within the 95 % interval of the ratio"
        claims.append(claim_of(PAPER_STEP, text, ratio, _about_one, "ratio"))
    return claims


def _on_seeds(found: Content, best: str) -> list[Claim]:
    mine = found["results"][f"{found['description']['headline']}/held-out"][best]
    ratios = mine["seed_ratios"].get(TUNED_LAW)
    longest = max(run["seconds"] for run in found["training"][best]["runs"].values())
    wanted = f"at least {SEED_SHARE * 10:.0f} of 10 training seeds have a lower cost than {TUNED_LAW}"
    if ratios is None:
        seeds = Claim("training", wanted, None, None, None, None, "not compared")
    else:
        better = sum(ratio < 1.0 for ratio in ratios)
        note = f"{better} of {len(ratios)} seeds"
        seeds = Claim("training", wanted, better, None, None, better >= SEED_SHARE * len(ratios), note)
    text = f"one training takes at most {MOST_SECONDS / 60:.0f} minutes on 2 cores"
    note = "seconds, the longest of all seeds, on the machine that trained"
    return [seeds, Claim("training", text, longest, None, None, longest <= MOST_SECONDS, note)]


def _on_full_control(found: Content) -> list[Claim]:
    """Return the claims of the track *full control*: about the best loop on the paper's step, and about scheduling."""
    headline, overall = found["description"]["headline"], found["constants"]["overall"]
    step, chosen = found["results"].get(f"{PAPER_STEP}/held-out"), found["constants"]["best"].get(PAPER_STEP)
    ratio = None if step is None else step[chosen]["ratio"][YARDSTICK]
    text = f"the best loop with its best constant has at most {BEST_LOOP_SHARE} of eq. 6's full-control cost"
    claims = [
        claim_of(PAPER_STEP, text, ratio, _at_most(BEST_LOOP_SHARE), f"{chosen}, chosen on train; ratio of costs")
    ]
    claims += _to_paper_gains(found, PAPER_STEP, chosen)
    if step is not None:
        shares = {name: step[name]["ratio_of_commands"] for name in found["constants"]["best_by_loop"][PAPER_STEP]}
        name = min(shares, key=lambda name: shares[name]["mean"])
        note = f"{name}; gains tuned by the full-control cost; reported only"
        text = "the same, by the cost of the track schedule without its tension term"
        claims.append(claim_of(PAPER_STEP, text, shares[name], None, note))
    text = "the best loop's best constant, relative to eq. 6 in the paper's loop"
    ratio = found["results"][f"{headline}/held-out"][overall]["ratio"][YARDSTICK]
    claims.append(claim_of(f"{headline}, held-out", text, ratio, None, f"{overall}; ratio of costs; reported only"))
    claims += _to_paper_gains(found, headline, overall)
    return [*claims, *_on_scheduling(found, overall)]


def _to_paper_gains(found: Content, suite: str, constant: str | None) -> list[Claim]:
    """Return a constant's cost, and that of eq. 6, relative to eq. 6 with the paper's gains, if others are in use."""
    papers = found.get("paper_gains", {}).get(suite)
    if papers is None or constant is None:
        return []
    note = f"ratio of costs; eq. 6 with the paper's gains costs {papers['cost']:.3g}; reported only"
    return [
        claim_of(f"{suite}, held-out", f"{what}, relative to eq. 6 with the paper's own gains", ratio, None, note)
        for what, ratio in (
            (f"the best loop's best constant ({constant})", papers["ratio"].get(constant)),
            ("eq. 6 with the profile's gains of the paper's loop", papers["ratio"].get(YARDSTICK)),
        )
    ]


def _on_scheduling(found: Content, overall: str) -> list[Claim]:
    """Return the claim about scheduling in the best loop, and the numbers behind it."""
    headline, loop = found["description"]["headline"], found["entries"][overall]["loop"]
    goal = found["references"]["clairvoyant"].get(headline)
    claims, counts = [], []
    learned = [name for name, entry in found["entries"].items() if entry["kind"] == "learned" and entry["loop"] == loop]
    about = f"{headline}, held-out"
    for name in learned:
        ratios = {key: family["ratio_to_constant"].get(name) for key, family in found["families"].items()}
        lower = [key for key, ratio in ratios.items() if ratio and ratio["high"] is not None and ratio["high"] < 1.0]
        counts.append(len(lower))
        note = f"families with an interval below 1: {', '.join(lower) or 'none'}; reported only"
        number = {"mean": float(len(lower)), "low": None, "high": None}
        claims.append(claim_of(about, f"families in which {name} costs less than {overall}", number, None, note))
        law = named(loop, TUNED_LAW)
        if law in found["entries"]:
            mine = found["results"][f"{headline}/held-out"][name]["ratio"].get(law)
            text = f"cost of {name} relative to {law}, tuned in that loop"
            claims.append(claim_of(about, text, mine, None, "ratio of costs; reported only"))
    if goal is not None:
        text = f"clairvoyant schedules in {loop}, relative to {overall}"
        claims.append(claim_of(about, text, goal["ratio_to_constant"], None, f"{_CLAIRVOYANT}; reported only"))
    for key, family in found["families"].items() if goal is not None else ():
        text = f"clairvoyant schedules in {loop}, relative to {overall}: {key}"
        claims.append(claim_of(about, text, family.get("clairvoyant"), None, "ratio of costs; reported only"))
    return [_something_learned_or_nothing_to_learn(about, loop, overall, counts, goal), *claims]


_CLAIRVOYANT = "ratio of costs; the search knows the noise, which no schedule of a device can, and is no proven bound"


def _something_learned_or_nothing_to_learn(
    about: str, loop: str, overall: str, counts: list[int], goal: Content | None
) -> Claim:
    """Return the claim that a learned schedule costs less than the constant, or that there is nothing to learn.

    `counts` are the numbers of families in which each learned schedule costs less. There is nothing to learn if the
    interval of the clairvoyant's cost, relative to the constant's, reaches 1 or is above it.
    """
    ratio = None if goal is None else goal["ratio_to_constant"]
    nothing = None if ratio is None or ratio["high"] is None else ratio["high"] >= 1.0
    text = (
        f"in {loop}, the best loop, a learned schedule costs less than {overall} in at least {FEWEST_FAMILIES} "
        "families, or a clairvoyant search finds nothing to learn"
    )
    most = max(counts, default=None)
    enough = None if most is None else most >= FEWEST_FAMILIES
    holds = None if enough is None and nothing is None else bool(enough) or bool(nothing)
    note = "nothing was learned there" if most is None else "measured: most families with an interval below 1"
    if goal is None or ratio is None or nothing is None:
        note += "; no clairvoyant search"
    else:
        there = "nothing to learn" if nothing else "something to learn"
        note += (
            f"; clairvoyant: {with_interval(ratio)} of the constant's cost in {goal['scenarios']} scenarios, {there} "
            f"(an interval that reaches 1 counts as nothing, and with few scenarios does not prove it); {_CLAIRVOYANT}"
        )
    return Claim(about, text, None if most is None else float(most), None, None, holds, note)


def _below_one(mean: float, low: float | None, high: float | None) -> bool:
    return high is not None and high < 1.0


def _about_one(mean: float, low: float | None, high: float | None) -> bool:
    return mean <= TRADE or (low is not None and low <= 1.0)


def _at_least_half(mean: float, low: float | None, high: float | None) -> bool:
    return mean >= HALF


def _at_most(most: float) -> Judge:
    return lambda mean, low, high: bool(mean <= most)


def claim_of(about: str, claim: str, number: Number | None, judge: Judge | None, note: str = "") -> Claim:
    """Return a claim judged by a number with its interval; None if there is no number."""
    if number is None or number["mean"] is None:
        return Claim(about, claim, None, None, None, None, note)
    mean, low, high = number["mean"], number["low"], number["high"]
    return Claim(about, claim, mean, low, high, None if judge is None else judge(mean, low, high), note)
