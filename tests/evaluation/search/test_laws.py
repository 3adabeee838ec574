"""Tuning: what is found is no worse than where it began, is found again, and never saw what is reported."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import fleet as fleets
from amulett_gym.envs import prices
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol, evaluate
from amulett_gym.evaluation.search import law_recipe, law_search
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.law_search import following, mean_costs
from amulett_gym.evaluation.search.laws import at_ends, tune
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.laws.parametric import (
    BEST_CONSTANT,
    EQ6_TUNED,
    PARAMETRIC,
    Device,
    read_tuned,
    tuned_content,
    tuned_vector,
    tuning_differs,
)
from amulett_gym.laws.policies import load_policy
from amulett_gym.profile import load_profile

SMALL = Recipe("eq6-tuned", seeds=(1, 2), population=6, generations=((2, 2), (4, 2)), validation=5)


@pytest.fixture(scope="module")
def trials():
    return Trials(Protocol(load_profile("testbed"), split="train", episodes=4))


def test_a_batch_costs_each_candidate_what_it_costs_alone(trials):
    vectors = PARAMETRIC.from_unit(np.random.default_rng(0).uniform(size=(3, len(PARAMETRIC.parameters))))
    scenarios = np.array([0, 2])
    together = mean_costs(PARAMETRIC, vectors, trials, scenarios)
    for vector, cost in zip(vectors, together, strict=True):
        assert trials.play(scenarios, following(PARAMETRIC, vector[None], trials)).sum(axis=0).mean() == cost


def test_tuning_finds_what_is_no_worse_than_its_start(tmp_path, trials):
    content = tune(tmp_path, SMALL)
    start = mean_costs(EQ6_TUNED, EQ6_TUNED.start()[None], trials, np.arange(4))[0]
    found = EQ6_TUNED.vector({name: entry["value"] for name, entry in content["parameters"].items()})
    assert mean_costs(EQ6_TUNED, found[None], trials, np.arange(4))[0] < start
    chosen = content["starts"][str(content["chosen_seed"])]
    assert chosen["validation"] == min(start["validation"] for start in content["starts"].values())
    assert content == json.loads((tmp_path / "eq6-tuned-steps.json").read_text())


def test_the_best_constant_is_searched_as_a_law(tmp_path, trials):
    content = tune(tmp_path, replace(SMALL, law="constant"))
    found = content["parameters"]["tension"]["value"]
    tensions = np.arange(4.0, 15.5)
    costs = mean_costs(BEST_CONSTANT, tensions[:, None], trials, np.arange(4))
    assert mean_costs(BEST_CONSTANT, np.array([[found]]), trials, np.arange(4))[0] < 1.001 * costs.min()
    path = str(tmp_path / "constant-steps.json")
    both = evaluate([path, f"constant:{found!r}"], episodes=2).values
    assert both[path]["cost"].tolist() == both[f"constant:{found!r}"]["cost"].tolist()
    env = gym.make("amulett_gym:Amulett/Scaling-v0", tension_range=(found - 0.5, found + 0.5))
    assert load_policy(path, env)(np.zeros(13)) == pytest.approx([0.0], abs=1e-6)


def test_a_law_tuned_on_a_device_of_ones_own_is_a_contender(tmp_path):
    path = tmp_path / "device.yaml"
    path.write_text("name: mine\nbase: testbed\nplant: {orientation: vertical, masses: [{mass: 0.1, arm: 0.1}]}\n")
    content = tune(tmp_path / "out", replace(SMALL, profile=str(path)))
    profile, law_file = load_profile(path), str(tmp_path / "out" / "eq6-tuned-steps.json")
    law, vector = tuned_vector(law_file, profile)
    assert law is EQ6_TUNED
    assert vector.tolist() == [entry["value"] for entry in content["parameters"].values()]
    path.unlink()
    assert tuning_differs(law_file, profile) == ""
    assert tuning_differs(law_file, load_profile("testbed")) == "was tuned on the mine, not on the testbed"
    other = profile.model_copy(update={"description": "changed"})
    assert tuning_differs(law_file, other) == "was tuned on another version of the mine, not on the mine"


def test_the_episodes_that_were_simulated_are_those_of_the_recipe(tmp_path):
    stages = {}
    tune(tmp_path, SMALL, lambda seed, stage: stages.update({seed: stage}))
    assert sum(stage["history"][-1][0] for stage in stages.values()) == SMALL.episodes == 2 * 6 * (2 * 3 + 4 * 3)
    for stage in stages.values():
        assert [entry[0] for entry in stage["history"]] == [12, 24, 36, 60, 84, 108]


def test_no_other_splits_than_train_and_validation_are_played(tmp_path, monkeypatch):
    seen = []

    def watched(protocol, *loop, **track):
        seen.append(protocol.split)
        return Trials(protocol, *loop, **track)

    monkeypatch.setattr(law_recipe, "Trials", watched)
    tune(tmp_path, replace(SMALL, seeds=(1,)))
    assert set(seen) == {"train", "validation"}


def test_a_finished_start_is_not_done_again_and_an_interrupted_study_goes_on(tmp_path, monkeypatch):
    first = tune(tmp_path / "whole", SMALL)
    done = []
    search = law_search.search
    monkeypatch.setattr(
        law_search, "search", lambda recipe, seed, *rest: done.append(seed) or search(recipe, seed, *rest)
    )
    tune(tmp_path / "parts", replace(SMALL, seeds=(2,)))
    assert tune(tmp_path / "parts", SMALL) == first
    assert tune(tmp_path / "parts", SMALL) == first
    assert done == [2, 1]
    tune(tmp_path / "parts", replace(SMALL, validation=6))
    assert done == [2, 1, 1, 2]


def test_an_interrupted_start_goes_on_with_its_generation(tmp_path, monkeypatch):
    first = tune(tmp_path / "whole", SMALL)
    costs, played = law_search.mean_costs, []

    def interrupted(law, vectors, *rest):
        if len(played) == 4:
            raise KeyboardInterrupt
        played.append(len(vectors))
        return costs(law, vectors, *rest)

    monkeypatch.setattr(law_search, "mean_costs", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tune(tmp_path / "parts", SMALL)
    played.clear()
    monkeypatch.setattr(law_search, "mean_costs", lambda *given: played.append(len(given[1])) or costs(*given))
    begun = []
    assert tune(tmp_path / "parts", SMALL, begin=begun.append) == first
    assert begun == [6 * (2 + 2 + 2 + 4)]
    assert played == [6, 6, 1, 1] + [6] * 6 + [1, 1]
    assert tune(tmp_path / "parts", SMALL, begin=begun.append) == first
    assert begun[1] == SMALL.episodes + SMALL.judging == 216 + 2 * (4 + 5)
    for name in (1, 2):
        stage = Path("stages") / f"eq6-tuned-steps-{name}.json"
        assert (tmp_path / "whole" / stage).read_text() == (tmp_path / "parts" / stage).read_text()


def test_parameters_at_an_end_of_their_range_are_named():
    def described(**values):
        return {"parameters": {name: {"value": value} for name, value in values.items()}}

    found = described(nominal_tension=14.9, minimum_tension=9.0, error_offset=2.05, exponent=4.0)
    assert at_ends(SMALL, found) == ["nominal_tension", "error_offset"]


def test_a_budget_is_kept_and_the_shipped_one_gives_the_shipped_generations():
    for law in ("constant", "eq6-tuned", "parametric"):
        recipe = Recipe(law)
        assert recipe.within(recipe.episodes) == recipe
        if law != "constant":
            assert recipe.episodes == tuned_content(law, load_profile("testbed"), "steps")["training_episodes"]
    for budget in (3_024, 5_000, 100_003):
        found = Recipe("eq6-tuned").within(budget)
        assert budget - 2 * 12 * 14 < found.episodes <= budget
    with pytest.raises(AmulettError, match="budget of 3023 .* 2 times 12 candidates need at least 3024"):
        Recipe("eq6-tuned").within(3_023)


def test_the_deprecated_command_tunes_into_a_folder_of_the_device(tmp_path, monkeypatch):
    recipes = []
    monkeypatch.setattr(tuning, "tune", lambda folder, recipe, **given: recipes.append((folder, recipe)))
    with pytest.warns(DeprecationWarning, match="use amulett tune-law"):
        tuning.main(["--law", "eq6-tuned", "--seeds", "1", "--out", str(tmp_path)])
    assert recipes == [(tmp_path / "testbed", Recipe("eq6-tuned", seeds=(1,)))]


def test_only_laws_of_shipped_devices_can_be_put_into_the_package(tmp_path, monkeypatch):
    with pytest.raises(AmulettError, match="only laws tuned on a shipped device.*not on mine"):
        tuning.check_shippable(replace(SMALL, profile={"name": "mine", "base": "testbed"}))
    with pytest.raises(AmulettError, match="no tuned constant"):
        tuning.check_shippable(replace(SMALL, law="constant"))
    monkeypatch.setattr(tuning.resources, "files", lambda package: tmp_path)
    path = tuning.ship(SMALL, {"a": 1})
    assert path == tmp_path / "laws" / "tuned" / "testbed" / "eq6-tuned-steps.json"
    assert json.loads(path.read_text()) == {"a": 1}


def test_a_law_in_another_loop_is_tuned_over_its_range_by_the_full_control_cost(tmp_path):
    recipe = replace(SMALL, law="constant", seeds=(1,), control="co-rotation")
    content = tune(tmp_path, recipe)
    path = tmp_path / "co-rotation-constant-steps.json"
    law, vector = read_tuned(str(path))
    assert law.range == (0.0, 15.0)
    assert content["cost"] == "control_cost" and content["recipe"]["control"] == "co-rotation"
    train, _ = recipe.trials()
    tension_range, every = train.tension_range, np.arange(4)
    costs = [
        train.control_costs(every, held([tension] * 4, tension_range)).mean() for tension in (*range(16), vector[0])
    ]
    assert content["starts"]["1"]["train"] == costs[-1]
    assert costs[-1] < 1.02 * min(costs)
    paper = gym.make("amulett_gym:Amulett/Scaling-v0")
    other = gym.make("amulett_gym:Amulett/Scaling-v0", control="co-rotation")
    assert load_policy(str(path), other)(np.zeros(13)) == pytest.approx([vector[0] / 7.5 - 1.0], abs=1e-6)
    path.write_text(json.dumps({**content, "parameters": {"tension": {"value": 2.0}}}))
    with pytest.raises(AmulettError, match="2 N"):
        load_policy(str(path), paper)


@pytest.mark.parametrize("law", [EQ6_TUNED, PARAMETRIC], ids=lambda law: law.name)
def test_a_law_over_a_wider_range_uses_it(law):
    wide = law.over((0.0, 15.0))
    assert law.over(law.range) is law
    rows = np.random.default_rng(0).uniform(-1, 1, (200, 13))
    vectors = wide.from_unit(np.random.default_rng(1).uniform(size=(200, len(law.parameters))))
    device = Device.of(load_profile("testbed"), 0.02)
    tensions = wide.tensions(rows, vectors, device, (0.0, 15.0))
    assert tensions.min() >= 0.0 and tensions.max() <= 15.0
    assert tensions.min() < 3.0


def test_a_damaged_stage_is_done_again(tmp_path):
    first = tune(tmp_path, SMALL)
    path = tmp_path / "stages" / "eq6-tuned-steps-1.json"
    written = path.read_text()
    path.write_text("{")
    assert tune(tmp_path, SMALL) == first
    assert path.read_text() == written


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"law": "parametrc"}, "did you mean 'parametric'"),
        ({"population": 3}, "at least 5"),
        ({"seeds": (1, 1)}, "differ"),
        ({"generations": ((0, 5),)}, "at least 1"),
        ({"control": "co-rotaton"}, "did you mean 'co-rotation'"),
        ({"control": "position-only"}, "unknown control loop that takes a tension 'position-only'"),
    ],
)
def test_wrong_recipes_are_refused(wrong, message):
    with pytest.raises(AmulettError, match=message):
        replace(SMALL, **wrong)


def test_the_digest_holds_the_prices_of_the_track_that_is_tuned(monkeypatch):
    other = copy.deepcopy(prices._frozen())
    other["divisors"]["testbed"]["steps"]["drive_effort"] *= 2.0
    recipes = SMALL, replace(SMALL, control="co-rotation"), replace(SMALL, track="full-control")
    before = [recipe.trials()[0].digest() for recipe in recipes]
    monkeypatch.setattr(prices, "_frozen", lambda: other)
    after = [recipe.trials()[0].digest() for recipe in recipes]
    assert [old == new for old, new in zip(before, after, strict=True)] == [True, False, False]


TWO = ["testbed", "simulation"]
OVER = replace(SMALL, profile=None, fleet=TWO, population=8)


def test_a_law_is_tuned_over_a_fleet_by_the_mean_cost_on_its_devices(tmp_path):
    content = tune(tmp_path, OVER)
    assert content["recipe"]["fleet"] == TWO and "profile" not in content["recipe"]
    path = str(tmp_path / "eq6-tuned-steps.json")
    law, vector = read_tuned(path)
    costs = []
    for k in range(5):  # scenario k of validation, on device k modulo 2
        protocol = Protocol(load_profile(TWO[k % 2]), split="validation", episodes=1, seed=k)
        trials = Trials(protocol)
        costs.append(trials.play(np.array([0]), following(law, vector[None], trials)).sum())
    assert content["starts"][str(content["chosen_seed"])]["validation"] == pytest.approx(np.mean(costs), rel=1e-12)
    start = mean_costs(EQ6_TUNED, EQ6_TUNED.start()[None], OVER.trials()[0], np.arange(4))[0]
    assert content["starts"][str(content["chosen_seed"])]["train"] < start
    assert tune(tmp_path, OVER) == content
    for name in TWO:
        assert tuning_differs(path, load_profile(name)) == ""
    mine = load_profile({"name": "mine", "base": "testbed"})
    assert tuning_differs(path, mine) == "was tuned over a fleet of 2 devices, not on the mine"
    path = tmp_path / "named.json"
    path.write_text(json.dumps({**content, "recipe": {**content["recipe"], "fleet": "gone"}}))
    assert tuning_differs(str(path), mine) == "was tuned on a device that cannot be read, not on the mine"


def test_a_law_of_each_device_acts_by_the_constants_of_its_own(trials):
    fleet = [load_profile(name) for name in TWO]
    fleet[1] = load_profile({"name": "heavy", "base": "testbed", "plant": {"masses": [{"mass": 0.4, "arm": 0.13}]}})
    both = Trials(Protocol(fleet[0], split="train", episodes=4), fleet=fleet)
    vector = PARAMETRIC.from_unit(np.full((1, len(PARAMETRIC.parameters)), 0.6))
    chosen = np.array([3, 0, 1])
    costs = both.play(chosen, following(PARAMETRIC, vector, both, chosen))
    for index, profile in enumerate(fleet):
        alone = Trials(Protocol(profile, split="train", episodes=4))
        own = both.which[chosen] == index
        assert (alone.play(chosen[own], following(PARAMETRIC, vector, alone)) == costs[:, own]).all()


def test_the_best_start_is_chosen_on_other_devices(tmp_path):
    other = replace(OVER, seeds=(1,), choose_fleet=TWO[1:])
    train, validation = other.trials()
    assert [profile.name for profile in train.profiles] == TWO
    assert [profile.name for profile in validation.profiles] == TWO[1:]
    content = tune(tmp_path, other)
    assert content["recipe"]["choose_fleet"] == TWO[1:]
    own = tune(tmp_path, replace(OVER, seeds=(1,)))  # the kept work of the other is not taken
    assert own["starts"]["1"]["train"] == content["starts"]["1"]["train"]
    assert own["starts"]["1"]["validation"] != content["starts"]["1"]["validation"]


def test_stages_give_each_device_of_a_fleet_as_many_scenarios():
    for count, stages in ((1, (16, 64)), (3, (15, 66)), (16, (16, 64)), (64, (16, 64)), (100, (16, 100))):
        names = [{"name": f"d{k}", "base": "testbed"} for k in range(count)]
        recipe = Recipe("eq6-tuned", fleet=names)
        assert tuple(scenarios for scenarios, _ in recipe.generations) == stages
        assert recipe.population == 16  # whole blocks of 8
        short = recipe.within(20_000)
        assert tuple(scenarios for scenarios, _ in short.generations) == stages
        assert 20_000 - 2 * 16 * 16 < short.episodes <= 20_000


def test_what_is_tuned_over_a_shipped_fleet_can_be_put_into_the_package(tmp_path, monkeypatch):
    shipped = [load_profile(name) for name in TWO]
    monkeypatch.setattr(fleets, "fleet_names", lambda: ("ours",))
    monkeypatch.setattr(fleets, "_shipped", lambda name: tuple(shipped))
    with pytest.raises(AmulettError, match="not over a fleet of 1 device of your own"):
        tuning.check_shippable(replace(OVER, fleet=TWO[1:], suite="mixed"))
    with pytest.raises(AmulettError, match="for the suite mixed only"):
        tuning.check_shippable(replace(OVER, seeds=(1,)))
    recipe = replace(OVER, suite="mixed")
    assert recipe.fleet == "ours"
    monkeypatch.setattr(tuning.resources, "files", lambda package: tmp_path)
    path = tuning.ship(recipe, {"a": 1})
    assert path == tmp_path / "laws" / "tuned" / "ours" / "eq6-tuned-mixed.json"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"profile": "testbed", "fleet": TWO}, "profile and fleet are both given"),
        ({"profile": None, "choose_fleet": TWO}, "give fleet, too"),
        ({"profile": None, "fleet": TWO, "law": "gains"}, "gains are tuned for one device"),
        ({"profile": None, "fleet": []}, "at least one profile"),
        ({"profile": None, "fleet": "plausibel"}, "unknown fleet 'plausibel'"),
    ],
)
def test_wrong_fleets_are_refused(wrong, message):
    with pytest.raises(AmulettError, match=message):
        replace(SMALL, **wrong)
