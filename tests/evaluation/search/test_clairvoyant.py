"""The clairvoyant reference: never worse than what it starts from, what it says, and kept."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import fork_processes
from scipy.optimize import differential_evolution

from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol, evaluate
from amulett_gym.evaluation.search import clairvoyant as module
from amulett_gym.evaluation.search.clairvoyant import (
    CONSTANTS,
    LAWS,
    Effort,
    Stage,
    clairvoyant,
    replay,
    start_schedules,
)
from amulett_gym.evaluation.search.trials import Trials, scheduled
from amulett_gym.profile import load_profile
from amulett_gym.workers.call import Workers

EFFORT = Effort((Stage(4, 0.06, 0.6, 2.0), Stage(4, 0.02, 0.2, 1.0)), restarts=2, candidates=8)
PROTOCOL = Protocol(load_profile("testbed"), episodes=3, seed=7, duration=4.0)


@pytest.fixture(scope="module")
def trials():
    return Trials(PROTOCOL)


@pytest.fixture(scope="module")
def found(trials):
    return clairvoyant(trials, EFFORT)


def test_it_is_never_worse_than_any_start_and_better_on_the_whole(found):
    best = np.min(list(found.starts.values()), axis=0)
    assert len(found.starts) == len([tension for tension in CONSTANTS if tension >= 4.0]) + len(LAWS)
    assert (found.costs <= best).all()
    assert found.costs.sum() < 0.97 * best.sum()


def test_its_schedules_cost_in_the_environment_what_it_says(trials, found):
    replayed = trials.play(np.arange(3), scheduled(found.actions)).sum(axis=0)
    np.testing.assert_allclose(replayed, found.costs, rtol=1e-12)
    assert (np.abs(found.actions) <= 1.0).all()


def test_in_another_loop_it_lowers_that_loops_cost_on_its_track():
    protocol = replace(PROTOCOL, duration=2.0, episodes=2)
    trials = Trials(protocol, "co-rotation", track=FULL_CONTROL)
    effort = replace(EFFORT, stages=tuple(replace(stage, rounds=2) for stage in EFFORT.stages))
    found = clairvoyant(trials, effort, laws=["eq6-tuned"])
    assert "constant:0" in found.starts and found.costs.sum() < np.min(list(found.starts.values()), axis=0).sum()
    results = evaluate(["co-rotation/constant:1", "co-rotation/eq6-tuned"], episodes=2, seed=7, duration=2.0)
    for name in ("constant:1", "eq6-tuned"):
        costs = results.values[f"co-rotation/{name}"]["control_cost"]
        np.testing.assert_allclose(found.starts[name], costs, rtol=1e-6)
    assert trials.digest() != Trials(protocol, "co-rotation").digest()


def test_starts_cost_what_their_laws_cost(found):
    results = evaluate(["eq6-held", "constant:8"], episodes=3, seed=7, duration=4.0)
    for name in ("eq6-held", "constant:8"):
        np.testing.assert_allclose(found.starts[name], -results.values[name]["return"], rtol=1e-12)


def test_more_search_never_costs_more_and_the_curve_tells(trials, found):
    assert (np.diff(found.curve[:, 1]) <= 0.0).all()
    assert (np.diff(found.curve[:, 0]) > 0).all()
    assert found.curve[-1, 1] == pytest.approx(found.costs.mean())
    assert found.restarts.shape == (2, 3)
    assert (found.restarts.min(axis=0) == found.costs).all()
    less = clairvoyant(trials, replace(EFFORT, stages=EFFORT.stages[:1]))
    assert (found.costs <= less.costs).all()
    assert less.curve.tolist() == found.curve[:5].tolist()


def test_foresight_is_judged_by_draws_that_are_not_the_scenarios_own(trials, found):
    several = trials.redrawn(3)
    foreseen = clairvoyant(several, EFFORT)
    each = several.play(np.arange(9), scheduled(np.repeat(foreseen.actions, 3, axis=0))).sum(axis=0)
    np.testing.assert_allclose(foreseen.costs, each.reshape(3, 3).mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(foreseen.costs, replay(several, foreseen.actions), rtol=1e-12)
    # What answers one draw of the noise costs more in others than what was found for several.
    others = trials.redrawn(20, 100)
    assert replay(others, found.actions).mean() > found.costs.mean()
    assert replay(others, foreseen.actions).mean() < replay(others, found.actions).mean()


def test_few_decisions_are_taken_as_well_as_differential_evolution_takes_them():
    trials = Trials(replace(PROTOCOL, duration=2.0, agent_period=0.25, episodes=2))
    effort = Effort((Stage(40, 0.25, 1.0, 2.0), Stage(40, 0.25, 0.5, 1.0)), restarts=2, candidates=16)
    found = clairvoyant(trials, effort)
    for scenario, cost in enumerate(found.costs):

        def value(columns, scenario=scenario):
            return trials.play(np.full(columns.shape[1], scenario), scheduled(columns.T.astype(np.float32))).sum(axis=0)

        best = differential_evolution(
            value, [(-1.0, 1.0)] * trials.steps, maxiter=100, seed=1, vectorized=True, updating="deferred", polish=False
        )
        assert cost <= 1.02 * best.fun


def test_the_same_seed_finds_the_same_and_another_one_something_else(trials, found):
    again = clairvoyant(trials, EFFORT)
    assert again.costs.tolist() == found.costs.tolist()
    assert (again.actions == found.actions).all()
    assert (clairvoyant(trials, replace(EFFORT, seed=1)).costs != found.costs).any()


def test_what_was_found_is_kept_until_something_changes(trials, found, tmp_path, monkeypatch):
    rounds, rounds_again = [], []
    first = clairvoyant(trials, EFFORT, folder=tmp_path, block=2, report=rounds.append)
    assert len(list(tmp_path.rglob("*.npz"))) == 2
    searched = []
    improve = module.improve
    monkeypatch.setattr(module, "improve", lambda *given: searched.append(given[1].tolist()) or improve(*given))
    again = clairvoyant(trials, EFFORT, folder=tmp_path, block=2, report=rounds_again.append)
    assert not searched
    assert rounds == [1] * 2 * EFFORT.rounds and rounds_again == [EFFORT.rounds] * 2
    assert again.costs.tolist() == first.costs.tolist()
    assert again.curve.tolist() == first.curve.tolist()
    assert list(again.starts) == list(found.starts)
    short = replace(EFFORT, stages=(Stage(1, 0.1, 0.2, 2.0),))
    clairvoyant(trials, short, folder=tmp_path, block=2)
    assert searched == [[0, 1], [2]]
    clairvoyant(Trials(replace(PROTOCOL, duration=3.0)), short, folder=tmp_path, block=2)
    assert searched == [[0, 1], [2], [0, 1], [2]]


def test_workers_find_and_keep_the_same(trials, tmp_path, monkeypatch):
    fork_processes(monkeypatch)
    rounds = []
    folders = tmp_path / "one", tmp_path / "two"
    alone = clairvoyant(trials, EFFORT, folder=folders[0], block=2)
    several = clairvoyant(trials, EFFORT, folder=folders[1], block=2, report=rounds.append, workers=Workers(2))
    assert sum(rounds) == 2 * EFFORT.rounds
    assert several.costs.tolist() == alone.costs.tolist() and several.curve.tolist() == alone.curve.tolist()
    kept = [{path.name: path.read_bytes() for path in folder.rglob("*.npz")} for folder in folders]
    assert kept[0] == kept[1] and len(kept[0]) == 2


def test_more_scenarios_search_only_what_is_missing(trials, tmp_path, monkeypatch):
    short = replace(EFFORT, stages=(Stage(1, 0.1, 0.2, 2.0),))
    clairvoyant(trials, short, folder=tmp_path, block=3)
    searched = []
    improve = module.improve
    monkeypatch.setattr(module, "improve", lambda *given: searched.append(given[1].tolist()) or improve(*given))
    clairvoyant(Trials(replace(PROTOCOL, episodes=5)), short, folder=tmp_path, block=3)
    assert searched == [[3, 4]]


def test_schedules_that_are_damaged_or_of_another_simulation_are_searched_for_again(trials, tmp_path, monkeypatch):
    short = replace(EFFORT, stages=(Stage(1, 0.1, 0.2, 2.0),))
    first = clairvoyant(trials, short, folder=tmp_path, block=2)
    damaged, stale = sorted((tmp_path / "testbed").iterdir())
    damaged.write_bytes(b"PK nothing")
    with np.load(stale) as arrays:
        content = dict(arrays)
    np.savez(stale, **{**content, "costs": 0.9 * content["costs"]})
    searched = []
    improve = module.improve
    monkeypatch.setattr(module, "improve", lambda *given: searched.append(given[1].tolist()) or improve(*given))
    for _ in range(2):
        assert clairvoyant(trials, short, folder=tmp_path, block=2).costs.tolist() == first.costs.tolist()
    assert searched == [[0, 1], [2]]


def test_what_acts_in_the_loop_is_no_start(trials):
    with pytest.raises(AmulettError, match="acts inside the loop"):
        start_schedules(trials, ["position-only"])


def test_the_command_tells_how_all_stand(tmp_path, monkeypatch, capsys):
    short = replace(EFFORT, stages=(Stage(2, 0.1, 0.5, 2.0),))
    search = module.clairvoyant
    monkeypatch.setattr(module, "clairvoyant", lambda trials, **given: search(trials, short, **given))
    module.main(["--suite", "reach", "--episodes", "2", "--out", str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    costs = {line[2:46].strip(): float(line[46:]) for line in lines if line.startswith("  ") and line[46:].strip()}
    eq6 = evaluate(["eq6"], suite="reach", episodes=2).values["eq6"]["return"].mean()
    assert costs["eq6 (in the loop)"] == pytest.approx(-eq6, abs=1e-4)
    assert costs["clairvoyant"] <= costs["best start of each scenario"] <= costs["eq6-held"]
    assert len(list(tmp_path.rglob("reach-held-out-0.npz"))) == 1
