"""The track *full control*, end to end on a tiny description: loops and laws by the full-control cost."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers import fork_processes

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import control_cost, control_prices
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.evaluation.search import law_recipe, law_search
from amulett_gym.evaluation.search.optimal import OptimalCosts
from amulett_gym.studies.benchmark.by_loop import BEST, answers, by_loop
from amulett_gym.studies.benchmark.claims import check_claims
from amulett_gym.studies.benchmark.description import load_benchmark, named
from amulett_gym.studies.benchmark.document import MARKS
from amulett_gym.studies.benchmark.page import verdict
from amulett_gym.studies.benchmark.results import content
from amulett_gym.studies.benchmark.stages import run_benchmark
from amulett_gym.studies.benchmark.tables import references

SHORT = [
    *("env.suite=mixed", "env.max_episode_steps=100", "network.hidden=[8]", "num_envs=8", "total_steps=256"),
    *("ppo.n_steps=16", "ppo.batch_size=64", "validation.every_steps=256", "validation.episodes=4"),
]
DRIVES = ("env.id=Amulett/Drives-v0", "env.track=full-control", "env.tension_range=[0.0, 15.0]")
TINY = {
    "track": "full-control",
    "loops": ["decentralized", "co-rotation"],
    "suites": ["mixed", "paper-step", "contact"],
    "splits": ["held-out", "shifted"],
    "altered": ["noise-x2", "wrong-parameters"],
    "episodes": 5,
    "seed": 0,
    "duration": 2.0,
    "contenders": ["eq6", "position-only"],
    "tuned_budget": {"eq6-tuned": 168},
    "constants": [1.0, 8.0],
    "learned": {
        "ppo": {"loops": ["co-rotation"], "set": SHORT, "seeds": [3], "best_loop_seeds": [3, 5]},
        "drives": {"set": [*SHORT, *DRIVES], "seeds": [4]},
    },
    "best_learned": "auto",
    "ablations": [],
    "clairvoyant": {"scenarios": {"mixed": 3}, "check": 0, "draws": 0, "effort": 0.03, "starts": ["eq6-tuned"]},
    "bootstrap": {"resamples": 100},
}
STAGES = ((1, 2), (2, 1))
LAWS = ("eq6", "eq6-tuned")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Run the benchmark, and return its folder."""
    folder = tmp_path_factory.mktemp("full-control")
    (folder / "tiny.yaml").write_text(yaml.safe_dump(TINY))
    (folder / "doc.md").write_text(f"{MARKS[0]}\n{MARKS[1]}\n")
    words = ["--config", str(folder / "tiny.yaml"), "--out", str(folder / "out"), "--doc", str(folder / "doc.md")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(law_recipe, "STAGES", STAGES)
        fork_processes(patch)
        assert main(["benchmark", *words, "--processes", "2"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def found(done):
    return json.loads((done / "benchmark.json").read_text())


def test_every_law_plays_in_every_loop(found):
    assert found["track"] == "full-control"
    kinds = {name: (entry["kind"], entry["loop"]) for name, entry in found["entries"].items()}
    other = {f"co-rotation/{law}": ("law", "co-rotation") for law in LAWS}
    constants = {f"co-rotation/constant:{tension}": ("constant", "co-rotation") for tension in (1, 8)}
    assert kinds == {
        **dict.fromkeys(LAWS, ("law", "decentralized")),
        "position-only": ("law", "position-only"),
        "constant:8": ("constant", "decentralized"),  # 1 N is below the paper's range
        **other,
        **constants,
        "co-rotation/ppo": ("learned", "co-rotation"),
        "drives": ("learned", "drives"),
    }


def test_costs_are_the_full_control_costs(done, found):
    names = ["eq6", "co-rotation/constant:1", "co-rotation/eq6"]
    tuned = str(done / "laws" / "co-rotation" / "co-rotation-eq6-tuned-mixed.json")
    results = found["results"]["mixed/held-out"]
    values = evaluate([*names, f"co-rotation/{tuned}"], suite="mixed", episodes=5, duration=2.0).values
    costs = {name: each["control_cost"] for name, each in values.items()}
    for name in names:
        assert results[name]["cost"]["mean"] == pytest.approx(costs[name].mean(), rel=1e-12)
        assert results[name]["ratio"]["eq6"]["mean"] == pytest.approx(costs[name].sum() / costs["eq6"].sum(), rel=1e-12)
    mine = results["co-rotation/eq6-tuned"]
    assert mine["cost"]["mean"] == pytest.approx(costs[f"co-rotation/{tuned}"].mean(), rel=1e-12)
    bundle = f"co-rotation/{done / 'runs' / 'co-rotation' / 'ppo' / 'seed-3'}"
    learned = evaluate([bundle], suite="mixed", episodes=5, duration=2.0).values[bundle]["control_cost"]
    assert results["co-rotation/ppo"]["cost"]["mean"] == pytest.approx(learned.mean(), rel=1e-12)
    commands = [values[name]["cost"] - values[name]["cost_tension"] for name in ("co-rotation/eq6", "eq6")]
    assert results["co-rotation/eq6"]["ratio_of_commands"]["mean"] == pytest.approx(
        commands[0].sum() / commands[1].sum(), rel=1e-12
    )


def test_laws_are_tuned_in_their_loop_by_the_full_control_cost(done, found):
    paper = json.loads((done / "laws" / "decentralized" / "eq6-tuned-mixed.json").read_text())
    other = json.loads((done / "laws" / "co-rotation" / "co-rotation-eq6-tuned-mixed.json").read_text())
    assert paper["cost"] == other["cost"] == "control_cost"
    assert paper["training_episodes"] == other["training_episodes"] <= TINY["tuned_budget"]["eq6-tuned"]
    budgets = found["training"]
    assert budgets["eq6-tuned"]["tuned_episodes"] == budgets["co-rotation/eq6-tuned"]["tuned_episodes"] == 168
    assert not any("tuned in the paper's loop" in remark for remark in found["remarks"])


def test_each_loop_has_its_best_constant_of_train(found):
    chosen = found["constants"]
    assert set(chosen["tried"]["mixed"]) == {"constant:8", "co-rotation/constant:1", "co-rotation/constant:8"}
    for suite, tried in chosen["tried"].items():
        others = {name: cost for name, cost in tried.items() if name != "constant:8"}
        assert chosen["best_by_loop"][suite] == ["constant:8", min(others, key=lambda name: others[name])]
        assert chosen["best"][suite] == min(tried, key=lambda name: tried[name])


def test_tables_compare_loops(found):
    tables = by_loop(found)
    rows = {row[0]: dict(zip(tables["loops"].head, row, strict=True)) for row in tables["loops"].rows}
    assert list(rows) == ["decentralized", "co-rotation", "position-only", "drives"]
    assert rows["drives"]["drives"] != "-" == rows["drives"]["ppo"]
    assert rows["decentralized"]["eq6"] == "1.00" and rows["decentralized"]["best constant"].startswith("8 N: ")
    ratio = found["results"]["mixed/held-out"]["co-rotation/eq6-tuned"]["ratio"]["eq6"]["mean"]
    assert float(rows["co-rotation"]["eq6-tuned"].split()[0]) == pytest.approx(ratio, rel=5e-3)
    assert rows["position-only"]["best constant"] == rows["position-only"]["eq6"] == "-"
    assert rows["co-rotation"]["ppo"] != "-" == rows["decentralized"]["ppo"]
    assert len(tables["loops_shifted"].rows) == 4
    best = tables["best_at"]
    assert best.head[-2] == "cost, ratio to eq6: mixed, shifted"
    for column in list(zip(*best.rows, strict=True))[1:]:
        numbers = [cell.removesuffix(BEST) for cell in column]
        if any(number != "-" for number in numbers):
            least = min(numbers, key=lambda number: np.inf if number == "-" else float(number.split(",")[0]))
            assert f"{least}{BEST}" in column
    assert [row[0] for row in tables["constants"].rows] == ["decentralized", "co-rotation"]


def test_each_purpose_names_the_loop_of_the_lowest_value(found):
    best = found["constants"]["best_by_loop"]["mixed"]
    rows = {row[0]: row for row in by_loop(found)["purposes"].rows}
    assert {"speed", "soft contact", "twice the sensor noise", "wrong parameters"} <= set(rows)
    for purpose, place in (("wrong parameters", "mixed/wrong-parameters"), ("all tasks together", "mixed/held-out")):
        ratios = {name: found["results"][place][name]["ratio"]["eq6"]["mean"] for name in best}
        first, then = sorted(best, key=lambda name: ratios[name])
        loop, tension = rows[purpose][2].removesuffix(" N").split(", ")
        assert named(loop, f"constant:{tension}") == first
        assert float(rows[purpose][3].split()[0]) == pytest.approx(ratios[first], rel=5e-3)
        assert float(rows[purpose][5].split()[0]) == pytest.approx(ratios[then], rel=5e-3)
    (said,) = [line for line in answers(found) if "the best loop for each purpose" in line]
    names = {purpose: row[2].removesuffix(" N").replace(", ", "/constant:") for purpose, row in rows.items()}
    assert all(f"{purpose}: {name}" in said for purpose, name in names.items())
    settling = found["results"]["paper-step/held-out"][best[1]]["settling"]
    assert settling["steps"] == 5 and settling["time"]["mean"] <= TINY["duration"]
    assert f", {settling['settled']} of 5 settled" in " ".join(rows["speed"])


def test_the_value_of_scheduling_is_relative_to_the_constant_of_the_same_loop(found):
    results, best = found["results"]["mixed/held-out"], found["constants"]["best_by_loop"]["mixed"]
    table = by_loop(found)["gains"]
    (row,) = [dict(zip(table.head, row, strict=True)) for row in table.rows if row[0].startswith("co-rotation")]
    cost = {name: numbers["cost"]["mean"] for name, numbers in results.items()}
    law = min(("co-rotation/eq6", "co-rotation/eq6-tuned"), key=lambda name: cost[name])
    assert float(row["eq6"].split()[0]) == pytest.approx(cost["co-rotation/eq6"] / cost[best[1]], rel=5e-3)
    assert float(row["learned"].split()[0]) == pytest.approx(cost["co-rotation/ppo"] / cost[best[1]], rel=5e-3)
    beside = float(row["learned, to the best law"].split()[0])
    assert beside == pytest.approx(cost["co-rotation/ppo"] / cost[law], rel=5e-3)
    below = sum(family["ratio_to_constant"]["co-rotation/ppo"]["high"] < 1.0 for family in found["families"].values())
    assert row["families"] == f"{below} of {len(found['families'])}"


def test_noise_and_wrong_parameters_are_compared_with_the_same_scenarios(found):
    name = found["constants"]["best_by_loop"]["mixed"][1]
    before, after = (found["results"][f"mixed/{split}"][name] for split in ("held-out", "noise-x2"))
    ratio = after["ratio_to_unaltered"]["mean"]
    assert ratio == pytest.approx(after["cost"]["mean"] / before["cost"]["mean"], rel=1e-9)
    assert after["cost"]["mean"] != before["cost"]["mean"]
    (row,) = [row for row in by_loop(found)["altered"].rows if row[0] == "co-rotation"]
    assert float(row[1].split()[0]) == pytest.approx(ratio, rel=5e-3)


def test_the_best_loop_has_more_seeds(found):
    assert found["entries"][found["constants"]["overall"]]["loop"] == "co-rotation"
    seeds = {name: entry["seeds"] for name, entry in found["entries"].items() if entry["kind"] == "learned"}
    assert seeds == {"co-rotation/ppo": [3, 5], "drives": [4]}
    assert found["best_learned"] == "co-rotation/ppo"


def test_without_a_schedule_in_the_best_loop_no_learned_entry_is_the_best(found):
    other = {**found, "best_learned": None}
    assert verdict(other, []).startswith("Nothing was learned in co-rotation, the loop of the best constant. The best")
    assert verdict({**other, "entries": {}}, []).startswith("Nothing was learned. The best tuned law")


def test_a_schedule_is_compared_with_the_constant_of_its_loop(found):
    top = found["constants"]["overall"]
    for family in found["families"].values():
        assert all(
            family["ratio_to_constant"][name]["mean"] == 1.0 for name in found["constants"]["best_by_loop"]["mixed"]
        )
    goal = found["references"]["clairvoyant"]["mixed"]
    assert goal["score"][top]["mean"] == 0.0 and 0.0 < goal["cost"] <= goal["best_start"]
    assert any("clairvoyant" in family for family in found["families"].values())


def test_the_document_and_the_page_show_the_loops(done):
    text = (done.parent / "doc.md").read_text()
    assert "### Loops and laws: mixed, held-out" in text and "images/full_control_pareto.png" in text
    assert (done.parent / "images" / "full_control_constants.png").exists()
    assert 'id="loops"' in (done / "benchmark.html").read_text()


def test_the_claims_are_judged_by_the_measured_numbers(found):
    claims = {claim["claim"]: claim for claim in found["claims"]}
    text = "the best loop with its best constant has at most 0.5 of eq. 6's full-control cost"
    ratio = found["results"]["paper-step/held-out"][found["constants"]["best"]["paper-step"]]["ratio"]["eq6"]["mean"]
    assert claims[text]["measured"] == ratio and claims[text]["holds"] is (ratio <= 0.5)
    alone = {name: entry for name, entry in found["entries"].items() if entry["kind"] != "learned"}
    loop, top = found["entries"][found["constants"]["overall"]]["loop"], "mine"
    found = {**found, "entries": {**alone, top: {"kind": "learned", "loop": loop}}}
    law = "parametric" if loop == "decentralized" else f"{loop}/parametric"
    found["entries"][law] = {"kind": "law", "loop": loop}
    there = found["results"]["mixed/held-out"]
    there = {**there, top: {"ratio": {law: {"mean": 0.95, "low": 0.9, "high": 0.99}}}}
    found["results"] = {**found["results"], "mixed/held-out": there}
    (beside,) = [claim for claim in check_claims(found) if f"{top} relative to {law}" in claim.claim]
    assert beside.measured == 0.95 and beside.holds is None
    assert check_claims({**found, "quick": True}) == []


def near(mean, width=0.02):
    return {"mean": mean, "low": mean - width, "high": mean + width}


@pytest.fixture
def made():
    """Return made-up results of three loops, in two of which a schedule is learned."""
    costs = {"constant:8": 0.9, "co-rotation/constant:10": 0.51, "cascade/constant:0": 0.5, "eq6": 1.0}
    costs |= {"cascade/eq6": 0.48, "cascade/ppo": 0.45, "co-rotation/ppo": 0.43}
    loops = {name: name.partition("/")[0] if "/" in name else "decentralized" for name in costs}
    best = {"decentralized": "constant:8", "co-rotation": "co-rotation/constant:10", "cascade": "cascade/constant:0"}
    results = {
        name: {
            "cost": near(cost),
            "iqm": near(cost),
            "ratio": {"eq6": near(cost), best[loops[name]]: near(cost / costs[best[loops[name]]])},
            "metrics": {
                "position_ise": near(cost),
                "drive_effort": near(2.0 - cost),
                "resting_stiffness": near(3.0),
                "push_deflection": near(4.0),
            },
            "failures": {"count": 1, "total": 40, "low": 0.01, "high": 0.1},
        }
        for name, cost in costs.items()
    }
    results["cascade/ppo"]["ratio"] |= {"cascade/eq6": near(0.94)}
    results["co-rotation/ppo"]["ratio"] |= {"co-rotation/constant:10": near(0.85, 0.3)}
    times = {"constant:8": (7.75, 2), "co-rotation/constant:10": (10.0, 0), "cascade/constant:0": (2.0, 8)}
    times |= {"eq6": (3.0, 8), "cascade/ppo": (1.0, 8)}
    step = {
        name: {"settling": {"time": near(time), "settled": settled, "steps": 8}}
        for name, (time, settled) in times.items()
    }
    family = {"scenarios": 9, "ratio_to_constant": {"cascade/ppo": near(0.9), "co-rotation/ppo": near(1.0)}}
    return {
        "description": {
            "headline": "mixed",
            "profile": "own.yaml",
            "tuned_budget": {"parametric": 58_240},
            "altered": [],
        },
        "constants": {
            "overall": "cascade/constant:0",
            "best_by_loop": {"mixed": list(best.values())},
            "tried": {"mixed": costs},
        },
        "entries": {
            name: {
                "kind": "learned" if name.endswith("ppo") else "constant" if "constant" in name else "law",
                "loop": loop,
                "seeds": {"cascade/ppo": [0, 1, 2], "co-rotation/ppo": [0]}.get(name, []),
            }
            for name, loop in loops.items()
        },
        "results": {"mixed/held-out": results, "paper-step/held-out": step, "hold-push/held-out": results},
        "families": {f"family {k}": family for k in range(3)},
        "training": {name: {"runs": {"0": {"steps": 2_500_000, "episodes": 5_000}}} for name in ("cascade/ppo",)},
        "references": {"clairvoyant": {}},
    }


def line_about(found, text):
    """Return the only answer with a text; empty if there is none."""
    (line,) = [line for line in answers(found) if text in line] or [""]
    assert not line or line.startswith("On full control, ")
    return line


def test_the_answer_names_what_cannot_be_told_apart(made):
    line = line_about(made, "best loop for each purpose")
    assert "accuracy: cascade/constant:0 (not told apart from co-rotation/constant:10); little effort" in line
    assert "little effort: decentralized/constant:8;" in line  # 1.1, the next 1.49
    made["results"]["mixed/held-out"]["constant:8"]["metrics"]["drive_effort"].update(low=None, high=None)
    line = line_about(made, "best loop for each purpose")
    assert "constant:8 (not told apart from co-rotation/constant:10 and cascade/constant:0)" in line


def test_steps_that_did_not_settle_count_as_long_as_an_episode(made):
    tables = by_loop(made)
    row = {row[0]: row for row in tables["purposes"].rows}["speed"]
    assert row[2:8] == [
        *("cascade, 0 N", "2.00 [1.98, 2.02], 8 of 8 settled", "decentralized, 8 N"),
        *("7.75 [7.73, 7.77], 2 of 8 settled", "cascade/ppo", "1.00 [0.980, 1.02], 8 of 8 settled"),
    ]
    cells = {row[0]: row[1] for row in tables["best_at"].rows}
    assert cells["co-rotation, 10 N"] == "10.0, 0 of 8 settled"
    assert cells["cascade, 0 N"] == f"2.00, 8 of 8 settled{BEST}"


def test_scheduling_lowers_the_cost_only_where_the_interval_is_below_one(made):
    line = line_about(made, "scheduling with a learned schedule")
    assert "in 1 of 2 loops with an interval below 1, most in cascade: cascade/ppo costs 0.900 [0.880, 0.920]" in line
    others = made["results"]["mixed/held-out"]["co-rotation/ppo"]["ratio"]
    others["co-rotation/constant:10"] = near(0.93)
    line = line_about(made, "scheduling with a learned schedule")
    assert "in 2 of 2 loops with an interval below 1, most in cascade (not told apart from co-rotation/ppo):" in line
    others["co-rotation/constant:10"] = near(0.85, 0.3)
    ratio = made["results"]["mixed/held-out"]["cascade/ppo"]["ratio"]
    for mean in (0.99, 1.03):
        ratio["cascade/constant:0"] = near(mean)
        line = line_about(made, "scheduling with a learned schedule")
        assert (
            "in none of 2 loops with an interval below 1: the lowest ratio to the loop's best constant is 0.85" in line
        )
        assert "(co-rotation/ppo), on mixed, held-out." in line
    laws = line_about(made, "scheduling with the best law of each loop")
    assert "(chosen by these costs, in hindsight, among eq6)" in laws
    made["entries"] = {name: entry for name, entry in made["entries"].items() if entry["kind"] != "learned"}
    assert not line_about(made, "a learned schedule") and not line_about(made, "the loop of the best constant")


def test_the_answer_about_the_best_loop(made):
    line = line_about(made, "the loop of the best constant")
    assert (
        "in cascade, the loop of the best constant, cascade/ppo costs 0.900 [0.880, 0.920] of the best constant" in line
    )
    assert "and 0.940 [0.920, 0.960] of cascade/eq6, the best law there in hindsight" in line
    assert line.endswith("with an interval below 1 in 3 of 3 families.")
    del made["entries"]["cascade/eq6"]
    assert "of the best constant, on mixed, held-out;" in line_about(made, "the loop of the best constant")


def test_the_answer_says_of_which_gains_eq6_is(made):
    assert line_about(made, "with its best constant (cascade/constant:0)").endswith("on mixed, held-out.")
    ratios = {"cascade/constant:0": near(0.3), "eq6": near(0.6)}
    made["paper_gains"] = {"mixed": {"cost": 1.02, "unit": "testbed", "ratio": ratios}}
    line = line_about(made, "with its best constant (cascade/constant:0)")
    assert "the gains of the profile own.yaml, which are not the paper's" in line
    assert "eq. 6 costs 1.02 (in the unit of all costs: eq. 6 in training on testbed); relative to that" in line
    assert "this constant costs 0.300 [0.280, 0.320]" in line
    assert line.endswith("eq. 6 with the profile's gains 0.600 [0.580, 0.620].")


def test_the_answers_name_budgets_and_single_seeds(made):
    assert line_about(made, "laws are tuned").endswith("in each loop: parametric 58,240.")
    assert line_about(made, "training run").endswith("2,500,000 agent steps, about 5,000 episodes: cascade/ppo.")
    assert line_about(made, "one training seed").endswith("the chance of training: co-rotation/ppo.")


def test_tables_of_safety_and_families_hold_the_numbers(made):
    tables = by_loop(made)
    (row,) = [row for row in tables["safety"].rows if row[0] == "cascade, 0 N"]
    assert row[1:] == ["0.0250 [0.0100, 0.100]", "3.00 [2.98, 3.02]", "4.00 [3.98, 4.02]"]
    table = tables["scheduling_learned"]
    assert table.head[1:] == tuple(f"family {k} (9)" for k in range(3))
    assert [row[:2] for row in table.rows] == [
        ["co-rotation/ppo", "1.00 [0.980, 1.02]"],
        ["cascade/ppo", "0.900 [0.880, 0.920]"],
    ]
    del made["results"]["hold-push/held-out"]
    assert not by_loop(made)["safety"].rows


@pytest.mark.parametrize(
    ("below", "clairvoyant", "holds"),
    [
        (3, None, True),
        (2, None, False),
        (2, near(0.9), False),
        (2, near(0.99), True),  # its interval reaches 1
        (None, near(1.2), True),
        (None, near(0.9), False),
        (None, None, None),
    ],
)
def test_something_is_learned_in_the_best_loop_or_there_is_nothing_to_learn(made, below, clairvoyant, holds):
    for k, family in enumerate(made["families"].values()):
        made["families"][f"family {k}"] = {
            **family,
            "ratio_to_constant": {"cascade/ppo": near(0.9 if k < (below or 0) else 1.0)},
        }
    if below is None:
        del made["entries"]["cascade/ppo"]
    if clairvoyant is not None:
        made["references"]["clairvoyant"]["mixed"] = {"scenarios": 40, "ratio_to_constant": clairvoyant}
    made["constants"]["best"] = {"paper-step": "cascade/constant:0"}
    del made["results"]["paper-step/held-out"]
    claims = check_claims({**made, "track": "full-control", "best_learned": None})
    (claim,) = [claim for claim in claims if "or a clairvoyant search finds nothing to learn" in claim.claim]
    assert claim.holds is holds and claim.measured == below
    assert ("knows the noise" in claim.note) is (clairvoyant is not None)
    counted = [claim for claim in claims if claim.claim.startswith("families in which cascade/ppo")]
    assert [(claim.measured, claim.holds) for claim in counted] == ([] if below is None else [(below, None)])


def test_eq6_with_the_papers_gains_is_beside_the_tuned_one(found, tmp_path):
    assert "paper_gains" not in found  # the testbed has these gains
    profile = {"name": "own", "base": "testbed", "loop": {"position": {"kp": 1.0}}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(profile))
    less = {"suites": ["mixed"], "learned": {}, "tuned_budget": {}, "splits": ["held-out"], "altered": []}
    less |= {"profile": "own.yaml", "clairvoyant": {"scenarios": {}}, "constants": [8.0], "duration": 1.0}
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump({**TINY, **less}))
    evidence = run_benchmark(load_benchmark(tmp_path / "tiny.yaml"), tmp_path / "out", tmp_path)
    values = evidence.paper_gains["mixed"].values
    papers = evaluate(["eq6"], suite="mixed", episodes=5, duration=1.0).values["eq6"]
    for metric in ("position_ise", "drive_effort", "contact_ise"):
        np.testing.assert_array_equal(values[metric], papers[metric])
    mine, families = evidence.headline()["eq6"].values["control_cost"][0], evidence.headline()["eq6"].families
    papers = control_cost(papers, papers["cost_failure"], control_prices(evidence.profile, "mixed", families))
    ratio = content(evidence)["paper_gains"]["mixed"]["ratio"]["eq6"]["mean"]
    assert ratio == pytest.approx(mine.sum() / papers.sum(), rel=1e-12) != 1.0
    claims = {claim.claim: claim.measured for claim in check_claims(content(evidence))}
    text = "eq. 6 with the profile's gains of the paper's loop, relative to eq. 6 with the paper's own gains"
    assert claims[text] == ratio


def test_without_casadi_nothing_begins(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump({**TINY, "tuned_budget": {}, "optimal": 2}))
    with pytest.raises(AmulettError, match="optimal control needs CasADi"):
        run_benchmark(load_benchmark(tmp_path / "tiny.yaml"), tmp_path / "out", tmp_path)
    assert not (tmp_path / "out").exists()


def test_a_budget_that_is_too_small_is_refused_before_anything_begins(tmp_path):
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump({**TINY, "learned": {}, "tuned_budget": {"parametric": 500}}))
    with pytest.raises(AmulettError, match="a budget of 500 simulated episodes is too small"):
        run_benchmark(load_benchmark(tmp_path / "tiny.yaml"), tmp_path / "out", tmp_path)
    assert not (tmp_path / "out").exists()


def test_finished_laws_and_searches_are_kept(done, monkeypatch):
    monkeypatch.setattr(law_recipe, "STAGES", STAGES)
    before = {path: path.stat().st_mtime_ns for path in done.rglob("*.npz")}

    def refuse(*given, **more):
        raise AssertionError("this was done already")

    monkeypatch.setattr(law_search, "search", refuse)
    monkeypatch.setattr("amulett_gym.evaluation.search.clairvoyant.improve", refuse)
    evidence = run_benchmark(load_benchmark(done.parent / "tiny.yaml"), done, done.parent)
    optimal = OptimalCosts(np.arange(2), np.full(2, 0.05), np.full(2, 0.04), {}, np.array([True, False]))
    found = content(replace(evidence, optimal=optimal))
    goal, eq6 = found["references"]["optimal"], evidence.headline()["eq6"].values["control_cost"][0, :2]
    assert goal["cost"] == 0.05 and goal["ratio_to_eq6"]["mean"] == pytest.approx(0.1 / eq6.sum())
    assert goal["entries_to_eq6"]["eq6"]["mean"] == 1.0
    row = references(found).rows[-1]
    assert row[0] == "optimal control, mixed (2)" and "Solved: 1 of 2." in references(found).note
    assert before == {path: path.stat().st_mtime_ns for path in done.rglob("*.npz")}
