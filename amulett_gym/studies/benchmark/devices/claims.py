"""Claims about the policy that is trained over devices, each judged by the measured numbers."""

from __future__ import annotations

import math
from typing import Any

from amulett_gym.evaluation.runner import YARDSTICK
from amulett_gym.laws.parametric import PARAMETRIC
from amulett_gym.studies.benchmark.claims import Claim, claim_of
from amulett_gym.studies.benchmark.devices.description import (
    ADAPTED,
    CONSTANT,
    EQ6_WITH_GAINS,
    OWN_CONSTANT,
    SPECIALIST,
)
from amulett_gym.studies.benchmark.devices.results import Content

MOST_DEVICES = 26 / 32
"""Least share of the devices on which the learned policy costs less than a law tuned on the training devices."""

NEAR = 1.05
"""Largest ratio to the cost of a specialist."""

ADAPTED_DEVICES = 6 / 8
"""Least share of the devices on which the adapted policy costs less than its start and than the best constant."""

MOST_SECONDS = 900.0
"""Duration of one training run."""

ADAPTATION_SECONDS = 60.0


def check_claims(found: Content) -> list[Claim]:
    """Return all claims, judged; none on a quick run."""
    if found.get("quick"):
        return []
    return [*_on_devices(found), *_on_families(found), *_aims(found), *_on_adaptation(found), *_on_training(found)]


def _on_devices(found: Content) -> list[Claim]:
    mine = found["results"][found["best_learned"]]
    count, total, worst = mine["lower_on"][YARDSTICK]["count"], mine["devices"], mine["worst"]
    note = f"devices; highest ratio: {worst['ratio_to_eq6']:.3f}, on {worst['device']}"
    claims = [
        _ratio(found, "held-out devices", "cost relative to eq. 6, overall", YARDSTICK, judged=False),
        _count("held-out devices", "lower cost than eq. 6 on every device", count, total, total, note),
    ]
    for law, text in ((CONSTANT, _constant(found)), (PARAMETRIC.name, "the richer law")):
        if law in mine["ratio"]:
            text = f"{text}, tuned on the training devices"
            claims.append(_ratio(found, "held-out devices", f"lower cost than {text}, overall", law))
            lower, least = mine["lower_on"][law], math.ceil(MOST_DEVICES * total)
            wanted = f"lower cost than {text}, on at least {least} devices"
            claims.append(_count("held-out devices", wanted, lower["count"], least, total))
    for law in found["laws"]:
        if law not in (YARDSTICK, CONSTANT, PARAMETRIC.name):
            text = f"cost relative to {law}, tuned on the training devices, overall"
            claims.append(_ratio(found, "held-out devices", text, law, judged=False))
    if "eq6_gains" in found:
        text = f"relative to eq. 6 in the paper's loop with the gains of {found['eq6_gains']}, overall"
        claims.append(_ratio(found, "held-out devices", f"cost {text}", EQ6_WITH_GAINS, judged=False))
        if CONSTANT in found["results"]:
            ratio, note = found["results"][CONSTANT]["ratio"][EQ6_WITH_GAINS], "ratio of costs; reported only"
            claims.append(claim_of("held-out devices", f"{_constant(found)}, {text}", ratio, None, note))
    return claims


def _on_families(found: Content) -> list[Claim]:
    """Return the claim that no hand-tuned law costs less in a family, by more than its interval."""
    lost = [
        f"{family} to {law} ({ratio['mean']:.3f} [{ratio['low']:.3f}, {ratio['high']:.3f}])"
        for family, numbers in found["families"].items()
        for law, ratio in numbers["ratio_of_learned"].items()
        if ratio["low"] is not None and ratio["low"] > 1.0
    ]
    text = "no family in which a hand-tuned law costs less, by more than its interval"
    note = f"families and laws; lost: {', '.join(lost)}" if lost else "families and laws"
    return [Claim("families", text, len(lost), None, None, not lost, note)]


def _aims(found: Content) -> list[Claim]:
    best, results = found["best_learned"], found["results"]
    claims = []
    if OWN_CONSTANT in results[best]["ratio"]:
        lower = results[best]["lower_on"][OWN_CONSTANT]
        note = f"ratio of costs; lower on {lower['count']} of {lower['devices']} devices"
        text = "aim: lower cost than the best constant of that very device, overall"
        claims.append(_ratio(found, "held-out devices", text, OWN_CONSTANT, note=note))
    if SPECIALIST in results[best]["ratio"]:
        count = results[SPECIALIST]["devices"]
        ratio = results[best]["ratio"][SPECIALIST]
        text = f"aim: cost at most {NEAR} of that of a specialist, trained on that very device"
        note = f"ratio of costs on {count} devices"
        claims.append(claim_of("held-out devices", text, ratio, lambda mean, low, high: bool(mean <= NEAR), note))
    return claims


def _on_adaptation(found: Content) -> list[Claim]:
    adapted = found["adaptation"]
    if not adapted:
        return []
    # Where no trained policy was better on the validation scenarios, the start's is kept, up to rounding.
    below = [one for one in adapted.values() if one["best_steps"] > 0 and one[ADAPTED] < one["start"]]
    won = [one for one in below if one[ADAPTED] < one[OWN_CONSTANT] and one["seconds"] <= ADAPTATION_SECONDS]
    least, longest = math.ceil(ADAPTED_DEVICES * len(adapted)), max(one["seconds"] for one in adapted.values())
    text = (
        f"adapted within {ADAPTATION_SECONDS:.0f} s, lower cost than the policy it started from and than the best "
        f"constant of the device, on at least {least} devices"
    )
    same = sum(one["best_steps"] == 0 for one in adapted.values())
    note = f"devices; below its start on {len(below)}, start kept on {same}; longest training: {longest:.0f} s"
    return [_count("adaptation", text, len(won), least, len(adapted), note)]


def _on_training(found: Content) -> list[Claim]:
    runs = found["training"][found["best_learned"]]["runs"].values()
    longest = max(run["seconds"] for run in runs)
    text = f"one training takes at most {MOST_SECONDS / 60:.0f} minutes on 2 cores"
    note = "seconds, the longest of all seeds, on the machine that trained"
    return [Claim("training", text, longest, None, None, longest <= MOST_SECONDS, note)]


def _constant(found: Content) -> str:
    tension = found["constants"]["tuned"]
    return "the best constant" if tension is None else f"the best constant ({tension:.3g} N)"


def _ratio(found: Content, about: str, text: str, other: str, judged: bool = True, note: str = "") -> Claim:
    number = found["results"][found["best_learned"]]["ratio"][other]
    note = note or ("ratio of costs" if judged else "ratio of costs; reported only")
    return claim_of(about, text, number, _below_one if judged else None, note)


def _below_one(mean: Any, low: Any, high: Any) -> bool:
    return high is not None and high < 1.0


def _count(about: str, text: str, count: int, least: int, total: int, note: str = "devices") -> Claim:
    return Claim(about, text, count, None, None, count >= least, f"{count} of {total} {note}")
