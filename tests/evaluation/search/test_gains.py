"""Gains of a loop are tuned in their own ranges, with as many episodes for each loop, into a profile."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import Field

from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.evaluation.search.gains import _parameter, gains_of, group_name, profile_text, shipped_text
from amulett_gym.evaluation.search.laws import Recipe, mean_costs, tune
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.profile import load_profile
from amulett_gym.settings import Sourced
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.safe_yaml import parse_yaml

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
    assert found.loops.model_copy(update={"equilibrium_point": base.loops.equilibrium_point}) == base.loops


def test_a_shipped_profile_is_written_with_all_else_as_it_was(tmp_path, monkeypatch):
    (tmp_path / "profiles").mkdir()
    path = tmp_path / "profiles" / "testbed.yaml"
    text = "# kept\nname: testbed\nloops:\n  co_rotation: {kp: 0.3}\n# of the loops\ndrives: {lag: 0.1}  # kept, too\n"
    path.write_text(text)
    monkeypatch.setattr(tuning.resources, "files", lambda package: tmp_path)
    parameters = {"reference_time": {"value": 0.2}, "lead": {"value": 0.1234567}, "co_contraction": {"value": 8.0}}
    assert tuning.ship(SMALL, {"parameters": parameters}) == path
    written = path.read_text()
    assert written.startswith("# kept\nname: testbed\n") and "drives: {lag: 0.1}  # kept, too\n" in written
    loops = parse_yaml(written, "profile")["loops"]
    assert loops["co_rotation"] == {"kp": 0.3}
    assert loops["equilibrium_point"]["lead"] == 0.123457
    again = shipped_text(written, {"co_rotation": {"kp": 0.5}})
    assert again.count("loops:") == 1
    loops["co_rotation"] = {"kp": 0.5}
    assert parse_yaml(again, "profile")["loops"] == loops


def test_gains_of_the_papers_loop_are_tuned_as_the_others_but_never_shipped(tmp_path):
    recipe = replace(SMALL, control="decentralized")
    content = tune(tmp_path, recipe)
    assert content["cost"] == "control_cost"
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
