"""Gains of a loop are tuned in their own ranges, with as many episodes for each loop, into a profile."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import Field

from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import FULL_CONTROL, TRACKS
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search import law_search
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.evaluation.search.gains import _parameter, gains_of, group_name, profile_text, shapes_of, shipped_text
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.law_search import mean_costs
from amulett_gym.evaluation.search.laws import profile_path, result_path, tune, tune_all
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.profile import load_profile
from amulett_gym.settings import Sourced
from amulett_gym.simulation.layout import LOOPS, pack_loop
from amulett_gym.storage.safe_yaml import parse_yaml
from amulett_gym.workers.call import Workers

TESTBED = load_profile("testbed")
SMALL = Recipe(
    "gains", seeds=(1,), population=6, generations=((2, 3), (3, 2)), validation=3, control="equilibrium-point"
)


@pytest.fixture(scope="module")
def trials():
    return Trials(Protocol(TESTBED, split="train", episodes=3), "co-rotation")


@pytest.mark.parametrize("control", LOOPS)
def test_every_gain_of_every_loop_has_a_range_that_its_group_allows(control):
    space = gains_of(control, TESTBED)
    group = type(getattr(TESTBED.loops, group_name(control)))
    *gains, tension = space.parameters
    assert gains and tension.unit == "N"
    for end in (0.0, 0.5, 1.0):
        vector = space.from_unit(np.full(len(space.parameters), end))
        group(**{gain.name: float(value) for gain, value in zip(gains, vector, strict=False)})
        pack_loop(space.profile(TESTBED, vector), control)  # the device can do it, too
    assert all(gain.low <= gain.start <= gain.high for gain in space.parameters)
    assert (space.to_unit(space.start()) >= 0.0).all() and (space.to_unit(space.start()) <= 1.0).all()


def test_ranges_come_from_the_field():
    class Group(Sourced):
        plain: float = Field(default=2.0, ge=0, le=100, description="a gain [N/rad]")
        limited: float = Field(default=2.0, ge=1, le=3)
        off: float = Field(default=0.0, ge=0, le=10)
        named: float = Field(default=0.0, ge=0, le=10, json_schema_extra={"search": [0.0, 4.0]})

    found = {
        name: _parameter(name, field, getattr(Group(), name))
        for name, field in Group.model_fields.items()
        if name != "sources"
    }
    assert (found["plain"].low, found["plain"].high, found["plain"].logarithmic) == (
        pytest.approx(2.0 / 30.0),
        60.0,
        True,
    )
    assert (found["plain"].meaning, found["plain"].unit) == ("a gain", "N/rad")
    assert (found["limited"].low, found["limited"].high) == (1.0, 3.0)
    assert found["off"] is None
    assert (found["named"].low, found["named"].high, found["named"].logarithmic) == (0.0, 4.0, False)


def test_all_loops_have_the_same_number_of_episodes():
    for budget in (None, 30_000):
        recipes = [Recipe("gains", control=control) for control in LOOPS]
        found = {(recipe if budget is None else recipe.within(budget)).episodes for recipe in recipes}
        assert len(found) == 1
    assert Recipe("gains", control=LOOPS[0]).episodes == 204_288


def test_candidates_are_played_with_their_own_gains(trials):
    space = gains_of("co-rotation", TESTBED)
    vectors = space.from_unit(np.random.default_rng(0).uniform(0.3, 0.7, size=(3, len(space.parameters))))
    costs = mean_costs(space, vectors, trials, np.arange(3), FULL_CONTROL)
    assert len(set(costs.tolist())) == 3
    for vector, cost in zip(vectors, costs, strict=True):
        own = Trials(replace(trials.protocol, profile=space.profile(TESTBED, vector)), "co-rotation")
        choose = held(np.full(3, vector[-1]), own.tension_range)
        assert own.control_costs(np.arange(3), choose).mean() == cost
    present = held(np.full(3, 8.0), trials.tension_range)  # afterwards the profile's own gains hold again
    fresh = Trials(trials.protocol, "co-rotation")
    assert trials.control_costs(np.arange(3), present).tolist() == fresh.control_costs(np.arange(3), present).tolist()


@pytest.mark.parametrize("profile", ["testbed", {"name": "mine", "base": "testbed", "drives": {"lag": 0.1}}])
def test_tuned_gains_are_a_profile_with_their_source(tmp_path, profile):
    recipe = replace(SMALL, profile=profile)
    content = tune(tmp_path, recipe)
    space, base = gains_of("equilibrium-point", TESTBED), load_profile(profile)
    train, _ = recipe.trials()
    start = mean_costs(space, space.start()[None], train, np.arange(3), FULL_CONTROL)[0]
    assert content["starts"]["1"]["train"] <= start
    found = load_profile(tmp_path / "profile.yaml")
    assert found.name == ("mine" if isinstance(profile, dict) else "testbed-tuned")
    assert found.drives == base.drives and found.root == base.root
    group = found.loops.equilibrium_point
    for name in ("reference_time", "lead"):
        assert getattr(group, name) == pytest.approx(content["parameters"][name]["value"], rel=1e-5)
        assert group.sources[name].startswith("identified: tuned on train of steps, 102 simulated episodes, with a")
    assert group.reference == content["parameters"]["reference"]["value"]
    assert group.sources["reference"] == group.sources["lead"]
    assert found.loops.model_copy(update={"equilibrium_point": base.loops.equilibrium_point}) == base.loops


def test_a_shipped_profile_is_written_with_all_else_as_it_was(tmp_path, monkeypatch):
    (tmp_path / "profiles").mkdir()
    path = tmp_path / "profiles" / "testbed.yaml"
    text = "# kept\nname: testbed\nloops:\n  co_rotation: {kp: 0.3}\n# of the loops\ndrives: {lag: 0.1}  # kept, too\n"
    path.write_text(text)
    monkeypatch.setattr(tuning.resources, "files", lambda package: tmp_path)
    parameters = {"reference_time": {"value": 0.2}, "lead": {"value": 0.1234567}, "co_contraction": {"value": 8.0}}
    parameters["reference"] = {"value": "first-order"}
    assert tuning.ship(SMALL, {"parameters": parameters}) == path
    written = path.read_text()
    assert written.startswith("# kept\nname: testbed\n") and "drives: {lag: 0.1}  # kept, too\n" in written
    loops = parse_yaml(written, "profile")["loops"]
    assert loops["co_rotation"] == {"kp": 0.3}
    assert loops["equilibrium_point"]["lead"] == 0.123457
    assert loops["equilibrium_point"]["reference"] == "first-order"
    again = shipped_text(written, {"co_rotation": {"kp": 0.5}})
    assert again.count("loops:") == 1
    loops["co_rotation"] = {"kp": 0.5}
    assert parse_yaml(again, "profile")["loops"] == loops


def test_gains_of_the_papers_loop_are_tuned_as_the_others_but_never_shipped(tmp_path):
    recipe = replace(SMALL, control="decentralized")
    content = tune(tmp_path, recipe)
    assert content["cost"] == "control_cost" and "reference" not in content["parameters"]
    found, loop = load_profile(tmp_path / "profile.yaml").loop, TESTBED.loop
    assert found.position != loop.position and found.tension != loop.tension
    assert found.position.ki == pytest.approx(content["parameters"]["position_ki"]["value"], rel=1e-5)
    assert found.tension.kp == pytest.approx(content["parameters"]["tension_kp"]["value"], rel=1e-5)
    assert found.sources["tension"].startswith("identified: tuned on train")
    assert found.sources["switch_filter"] == loop.sources["switch_filter"]
    kept = {"position": loop.position, "tension": loop.tension, "sources": loop.sources}
    assert found.model_copy(update=kept) == loop
    space = gains_of("decentralized", TESTBED)
    train, _ = recipe.trials()
    costs = mean_costs(space, np.array([space.start(), space.start()]), train, np.arange(3), FULL_CONTROL)
    own = train.control_costs(np.arange(3), held([10.0] * 3)).mean()
    assert costs.tolist() == [pytest.approx(own, rel=1e-6)] * 2
    own = load_profile(tmp_path / "profile.yaml")
    assert own.divisors_of == "testbed"
    for track in TRACKS:  # the same unit as before, so that the costs can be compared
        np.testing.assert_array_equal(prices(own, "mixed", track=track), prices(TESTBED, "mixed", track=track))
    with pytest.raises(AmulettError, match="gains of the paper's loop stay"):
        tuning.check_shippable(recipe)


def test_sources_of_other_loops_stay():
    def tuned(profile, control, source):
        space = gains_of(control, profile)
        return load_profile(parse_yaml(profile_text(profile, space.changes(profile, space.start(), source)), "profile"))

    twice = tuned(tuned(TESTBED, "co-rotation", "identified: a"), "equilibrium-point", "identified: b")
    assert twice.loops.co_rotation.sources["kp"] == "identified: a"
    sources = twice.loops.equilibrium_point.sources
    assert {sources[name] for name in ("reference_time", "lead")} == {"identified: b"}
    assert twice.name == "testbed-tuned" and twice.root == "testbed"


def test_the_shape_of_the_reference_motion_is_chosen_within_the_budget(tmp_path, monkeypatch):
    seen = []

    def costs(space, vectors, trials, scenarios, track):
        seen.append((space.reference, scenarios.size))
        extra = {"minimum-jerk": 0.3, "critically-damped": 0.1, "first-order": 0.2}[space.reference]
        return extra + space.to_unit(vectors).mean(axis=1)

    monkeypatch.setattr(law_search, "mean_costs", costs)
    recipe = replace(SMALL, generations=((2, 14), (3, 2)), profile={"name": "mine", "base": "testbed"})
    content = tune(tmp_path, recipe)
    tries = [(shape, 2) for shape in shapes_of("equilibrium-point") for _ in range(2)]
    chosen = "critically-damped"
    assert seen == [*tries, *[(chosen, 2)] * 9, *[(chosen, 3)] * 4 + [(chosen, 3)]]
    start = content["starts"]["1"]
    assert start["reference"] == content["parameters"]["reference"]["value"] == chosen
    assert [*start["reached"]] == [*shapes_of("equilibrium-point")]
    assert min(start["reached"], key=start["reached"].get) == chosen
    stage = parse_yaml((tmp_path / "stages" / "equilibrium-point-gains-steps-1.json").read_text(), "stage")["result"]
    assert stage["history"][-1][0] == recipe.episodes
    assert load_profile(tmp_path / "profile.yaml").loops.equilibrium_point.reference == chosen


@pytest.mark.parametrize("number", [2, 3, 5, 6, 50, 121])
def test_trying_shapes_takes_half_of_the_first_stage_at_most(number):
    recipe = replace(SMALL, generations=((2, number), (3, 2)))
    shapes, (scenarios, each), stages = recipe.stages()
    assert shapes == shapes_of("co-rotation") and scenarios == 2
    tries, rest = 3 * (1 + each), [1 + generations for count, generations in stages if count == 2]
    assert tries + sum(rest) == 1 + number
    assert tries == 3 or tries <= (1 + number) / 2
    assert stages[-1] == (3, 2)
    plain = replace(recipe, control="decentralized")
    assert plain.stages() == ((), (), [(2, number), (3, 2)]) and plain.episodes == recipe.episodes


def test_too_few_generations_for_all_shapes_are_refused():
    with pytest.raises(
        AmulettError, match="the first stage has 1 generations; it needs at least 2, to try the 3 shapes"
    ):
        replace(SMALL, generations=((2, 1), (3, 2)))
    replace(SMALL, generations=((2, 1), (3, 2)), control="decentralized")


def test_an_interrupted_choice_of_a_shape_goes_on(tmp_path, monkeypatch):
    first = tune(tmp_path / "whole", SMALL)
    costs, played = law_search.mean_costs, []

    def interrupted(*given):
        if len(played) == 2:
            raise KeyboardInterrupt
        played.append(1)
        return costs(*given)

    monkeypatch.setattr(law_search, "mean_costs", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tune(tmp_path / "parts", SMALL)
    monkeypatch.setattr(law_search, "mean_costs", lambda *given: played.append(1) or costs(*given))
    assert tune(tmp_path / "parts", SMALL) == first
    assert len(played) == 4 + 3 + 2  # generations, and what was found on both splits


def test_gains_are_tuned_on_as_many_scenarios_of_each_family():
    recipe = Recipe("gains", "mixed", control="decentralized")
    train, validation = recipe.trials()
    for count in (14, 42):
        assert np.unique(train.rows["family"][:count], return_counts=True)[1].tolist() == [count // 7] * 7
    drawn = Trials(recipe.protocol("train", 42)).rows
    assert (drawn["family"] == 2).sum() < 6  # but with the first 42 scenarios as they come
    assert len(validation.rows) == 200


def test_several_loops_are_tuned_into_one_profile_in_any_number_of_processes(tmp_path):
    recipes = [replace(SMALL, control=control) for control in ("decentralized", "equilibrium-point")]
    begun, reported = [], []
    contents = tune_all(tmp_path / "one", recipes, lambda recipe, seed, start: reported.append(recipe.control))
    assert reported == ["decentralized", "equilibrium-point"]
    assert tune_all(tmp_path / "two", recipes, begin=begun.append, workers=Workers(2)) == contents
    assert tune_all(tmp_path / "two", recipes, begin=begun.append, workers=Workers(2)) == contents
    assert begun == [0, 2 * (SMALL.episodes + SMALL.judging)]
    for recipe, content in zip(recipes, contents, strict=True):
        alone = tmp_path / recipe.control
        assert tune(alone, recipe) == content
        assert result_path(alone, recipe).read_text() == result_path(tmp_path / "two", recipe).read_text()
    both, paper, other = (
        load_profile(profile_path(tmp_path / name)) for name in ("two", *(r.control for r in recipes))
    )
    assert profile_path(tmp_path / "two").read_text() == profile_path(tmp_path / "one").read_text()
    assert both.loop == paper.loop != TESTBED.loop and both.loops == other.loops != TESTBED.loops


@pytest.mark.parametrize(
    ("control", "tension", "cost"), [("decentralized", 12.01, 0.5859), ("computed-torque", 8.68, 0.5651)]
)
def test_the_gains_that_the_benchmark_of_loops_uses_have_their_cost(control, tension, cost):
    profile = load_profile(Path(__file__).parents[3] / "configs" / "full_control" / "testbed.yaml")
    played = Trials(Protocol(profile, "mixed", "validation", episodes=200), control, track=FULL_CONTROL)
    scenarios = np.arange(200)
    found = played.control_costs(scenarios, held(np.full(scenarios.size, tension), played.tension_range)).mean()
    assert found == pytest.approx(cost, rel=2e-3)
