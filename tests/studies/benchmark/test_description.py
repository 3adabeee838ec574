"""The benchmark's description: its defaults are those that people copy, and what is wrong is named."""

from pathlib import Path

import pytest
import yaml

from amulett_gym.errors import AmulettError
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.studies.benchmark.description import (
    PAPER_STEP,
    PAPERS,
    Benchmark,
    load_benchmark,
    load_profile_of,
    quick,
    recipe_folder,
    training_recipe,
)
from amulett_gym.studies.benchmark.runs import required_runs, trained_loops

ROOT = Path(__file__).parents[3]
FULL = {"track": "full-control", "learned": {}, "ablations": []}


def test_the_shipped_file_writes_out_the_defaults():
    content = yaml.safe_load((ROOT / "configs" / "benchmark.yaml").read_text())
    assert load_benchmark(ROOT / "configs" / "benchmark.yaml") == load_benchmark() == Benchmark()
    assert set(content) == set(Benchmark.model_fields)


def test_the_claims_number_of_seeds_and_scenarios_is_met():
    description = load_benchmark()
    assert len(description.learned[description.best_learned].seeds) >= 10
    assert description.episodes >= 200
    assert len(description.places()) == 2 * len(description.suites) - 1
    assert (PAPER_STEP, "shifted") not in description.places()


def test_every_recipe_that_is_named_can_be_read():
    folder = recipe_folder(None)
    for entry in load_benchmark().learned.values():
        config = training_recipe(entry, 7, folder)
        assert config.seed == 7
        assert config.env.suite == "mixed"
        assert config.env.privileged == entry.reference


def test_the_shipped_file_of_full_control_is_of_all_loops_and_laws():
    path = ROOT / "configs" / "full_control.yaml"
    description = load_benchmark(path)
    assert description.loops == [PAPERS, *LOOPS] and description.law_names()[:2] == ["eq6", f"{LOOPS[0]}/eq6"]
    assert {"constant:4", "co-rotation/constant:0"} <= set(description.constant_names())
    assert "constant:0" not in description.constant_names()
    runs = required_runs(description, path.parent, Path("runs"))
    assert {(run.entry, run.config.env.control) for run in runs} == {
        *((f"{loop}/ppo", loop) for loop in LOOPS),
        ("ppo", "decentralized"),
        ("drives", "decentralized"),
    }
    assert Path("runs/co-rotation/ppo/seed-0") in [run.folder for run in runs]
    assert all(run.config.env.tension_range[0] == (4.0 if run.entry == "ppo" else 0.0) for run in runs)
    small = quick(description)
    assert small.loops == [PAPERS, "equilibrium-point", "co-rotation"] and small.track == "full-control"
    assert set(small.tuned_budget) == set(description.tuned_budget) and small.optimal == 0 < description.optimal


def test_the_loop_of_the_best_constant_gets_more_seeds():
    path = ROOT / "configs" / "full_control.yaml"
    description = load_benchmark(path)
    assert description.best_learned == "auto" and {len(entry.seeds) for entry in description.learned.values()} == {1}
    trained = trained_loops(required_runs(description, path.parent, Path("runs")))
    assert trained["drives"] == "drives" and trained["ppo"] == PAPERS
    for loop, name in (("cascade", "cascade/ppo"), (PAPERS, "ppo")):
        best = description.in_best_loop(loop, trained)
        assert best.best_learned == name and len(best.learned[name].seeds) >= 3
        assert all(entry.seeds == [0] for other, entry in best.learned.items() if other != name)
        assert Benchmark.model_validate(best.model_dump()) == best


def test_nothing_learned_in_the_best_loop_is_no_best_learned():
    drives, reference = {"seeds": [0]}, {"seeds": [0], "reference": True}
    own = Benchmark.model_validate({**FULL, "learned": {"drives": drives, "causal": reference}, "best_learned": "auto"})
    trained = {"drives": "drives", "causal": PAPERS}
    for loop in ("cascade", PAPERS):
        best = own.in_best_loop(loop, trained)
        assert best.best_learned is None and Benchmark.model_validate(best.model_dump()) == best
    assert own.in_best_loop(PAPERS, {**trained, "drives": PAPERS}).best_learned == "drives"
    with pytest.raises(ValueError, match="best_learned is null; this is for the track full-control"):
        Benchmark(best_learned=None)


def test_further_seeds_without_a_loop_are_refused():
    changes = ["env.id=Amulett/Drives-v0", "env.track=full-control", "env.tension_range=[0.0, 15.0]"]
    entry = {"set": changes, "seeds": [0], "best_loop_seeds": [1]}
    description = Benchmark.model_validate({**FULL, "learned": {"drives": entry}, "best_learned": "auto"})
    with pytest.raises(AmulettError, match="'drives' is trained in Amulett/Drives-v0.*best_loop_seeds has to be empty"):
        required_runs(description, ROOT, Path("runs"))


@pytest.mark.parametrize("turned", [False, True])
def test_two_learned_entries_of_one_name_are_refused(turned):
    entries = [("ppo", {"loops": ["co-rotation"], "seeds": [0]}), ("co-rotation/ppo", {"seeds": [1]})]
    learned = dict(reversed(entries) if turned else entries)
    with pytest.raises(ValueError, match="two learned entries would be called 'co-rotation/ppo'"):
        Benchmark.model_validate({**FULL, "learned": learned, "best_learned": "auto"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"track": "schedule"}, "learned.a.loops is of the track full-control"),
        ({"loops": [PAPERS]}, "learned.a.loops is .*; it has to be all, or some of 'loops'"),
        ({"ablations": ["effort"]}, "best_learned is 'auto'"),
        ({"altered": ["noise-x3"]}, "noise-x2"),
    ],
)
def test_what_cannot_be_learned_in_several_loops_is_refused(changes, message):
    learned = {"learned": {"a": {"seeds": [0], "loops": ["co-rotation"]}}, "best_learned": "auto"}
    with pytest.raises((AmulettError, ValueError), match=message):
        Benchmark.model_validate({**FULL, **learned, **changes})


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("cascaded", ["env.control=co-rotation"], "in the loop co-rotation; call it 'co-rotation/cascaded'"),
        ("co-rotation/a", [], "in the loop decentralized; call it 'a'"),
        ("equilibrium-point/a", ["env.control=co-rotation"], "call it 'co-rotation/a'"),
        ("a", ["env.track=schedule"], "trained on the track schedule; set env.track=full-control"),
    ],
)
def test_a_schedule_is_named_by_the_loop_in_which_it_is_trained(name, changes, message):
    changes = ["env.track=full-control", "env.tension_range=[4.0, 15.0]", *changes]
    learned = {"learned": {name: {"set": changes, "seeds": [0]}}, "best_learned": name, "ablations": []}
    with pytest.raises(AmulettError, match=message):
        required_runs(Benchmark(track="full-control", **learned), ROOT, Path("runs"))


def test_loops_that_do_not_fit_the_device_are_named_with_those_that_do(tmp_path):
    (tmp_path / "linear.yaml").write_text("{name: linear, base: testbed, spring: {free_length: 0}}")
    description = Benchmark.model_validate({**FULL, "profile": "linear.yaml"})
    with pytest.raises(
        AmulettError, match=r"device 'linear'; write loops: \[decentralized, .*torque-stiffness: control"
    ):
        load_profile_of(description, tmp_path)
    fit = [loop for loop in description.loops if loop not in ("torque-stiffness", "feedforward-feedback")]
    assert load_profile_of(description.model_copy(update={"loops": fit}), tmp_path).name == "linear"
    assert load_profile_of(description.model_copy(update={"loops": []}), tmp_path).name == "linear"


def test_schedules_are_trained_on_the_device_of_the_benchmark(tmp_path):
    (tmp_path / "tuned.yaml").write_text("{name: tuned, base: testbed, loops: {co_rotation: {lead: 0.05}}}")
    entry = {"set": ["env.control=co-rotation", "env.track=full-control"], "seeds": [0]}
    learned = {"learned": {"co-rotation/ppo": entry}, "best_learned": "co-rotation/ppo", "ablations": []}
    (run,) = required_runs(Benchmark(track="full-control", profile="tuned.yaml", **learned), tmp_path, Path("runs"))
    assert run.config.env.profile["loops"]["co_rotation"]["lead"] == 0.05


def test_the_quick_one_is_a_small_one_of_the_same_make():
    whole = load_benchmark()
    small = quick(whole)
    assert set(small.suites) < set(whole.suites) and small.headline == whole.headline
    assert small.episodes < whole.episodes and not small.ablations
    assert small.contenders == whole.contenders and set(small.constants) < set(whole.constants)
    ((name, entry),) = small.learned.items()
    assert name == whole.best_learned and len(entry.seeds) == 2
    assert entry.set[: len(whole.learned[name].set)] == whole.learned[name].set


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"suits": ["mixed"]}, "unknown key 'suits'; did you mean 'suites'"),
        ({"suites": ["steps"]}, "headline is 'mixed', which is none of the suites"),
        ({"suites": ["mixed", "step"]}, "unknown suite 'step'.*did you mean 'steps'"),
        ({"splits": ["shifted"]}, "'splits' has to hold held-out"),
        ({"splits": ["train"]}, "splits.0.*'held-out' or 'shifted'"),
        ({"episodes": 1}, "'episodes' is 1"),
        ({"constants": [3.0]}, "3.0 N"),
        ({"contenders": ["eq6", "eq6"]}, "'contenders' names something twice"),
        ({"best_learned": "sacc"}, "unknown learned entry 'sacc'"),
        ({"learned": {"a/b": {"seeds": [0]}}, "best_learned": "a/b"}, "'a/b' cannot be a learned entry's name"),
        ({"learned": {"eq6": {"seeds": [0]}}, "best_learned": "eq6"}, "'eq6' cannot be a learned entry's name"),
        ({"learned": {"x": {"seeds": [1, 1]}}, "best_learned": "x"}, "seeds have to differ"),
        ({"learned": {"x": {"seeds": [1], "reference": True}}, "best_learned": "x"}, "a reference and no contender"),
        ({"ablations": ["stiffness"]}, "unknown reward term 'stiffness'"),
        ({"clairvoyant": {"scenarios": {"mixed": 501}}}, "names 501 of mixed"),
        ({"clairvoyant": {"scenarios": {"mixed": 1}}}, "an interval needs at least 2"),
        ({"loops": ["co-rotation"]}, "'loops' is of the track full-control; the track is schedule"),
        ({"tuned_budget": {"parametric": 9}}, "'tuned_budget' is of the track full-control"),
        ({"track": "full"}, "unknown track 'full'.*did you mean 'full-control'"),
        ({**FULL, "loops": ["decentralized", "co-rotaton"]}, "did you mean 'co-rotation'"),
        ({**FULL, "loops": ["co-rotation"]}, "'loops' has to hold decentralized"),
        ({**FULL, "loops": ["decentralized", "position-only"]}, "none without a tension"),
        ({**FULL, "loops": ["decentralized", "decentralized"]}, "'loops' names something twice"),
        ({**FULL, "constants": [16.0]}, "16.0 N; the default actions reach from 0 to 15 N"),
        ({**FULL, "loops": ["decentralized"], "constants": [1.0]}, "'constants' holds 1.0 N"),
        ({**FULL, "contenders": ["eq6"], "tuned_budget": {"eq6": 9}}, "unknown law that can be tuned 'eq6'"),
        ({**FULL, "tuned_budget": {"eq6-tuned": 9}}, "'eq6-tuned' is tuned in each loop"),
        ({**FULL, "optimal": 1}, "optimal is 1; it has to be 0, or from 2 to episodes, 500"),
        ({"learned": {"co-rotation/x": {"seeds": [0]}}, "best_learned": "co-rotation/x"}, "the track is schedule"),
        ({"bootstrap": {"resamples": 1}}, "'bootstrap.resamples' is 1"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, message):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(AmulettError, match=message):
        load_benchmark(path)


def test_a_wrong_recipe_is_named_before_anything_is_trained():
    entry = Benchmark(learned={"x": {"seeds": [0], "set": ["ppo.gama=1"]}}, best_learned="x").learned["x"]
    with pytest.raises(AmulettError, match=r"ppo\.gama.*did you mean 'gamma'"):
        training_recipe(entry, 0, ROOT)
