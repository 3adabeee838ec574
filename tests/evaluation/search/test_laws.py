"""Tuning: what is found is no worse than where it began, is found again, and never saw what is reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search import laws as tuning
from amulett_gym.evaluation.search.laws import Recipe, following, mean_costs, tune
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.laws.parametric import EQ6_TUNED, PARAMETRIC, tuned_vector
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
    assert content == json.loads((tmp_path / "testbed" / "eq6-tuned-steps.json").read_text())


def test_a_law_tuned_on_a_device_of_ones_own_is_a_contender(tmp_path):
    path = tmp_path / "device.yaml"
    path.write_text("name: mine\nbase: testbed\nplant: {orientation: vertical, masses: [{mass: 0.1, arm: 0.1}]}\n")
    content = tune(tmp_path / "out", replace(SMALL, profile=str(path)))
    law, vector = tuned_vector(str(tmp_path / "out" / "mine" / "eq6-tuned-steps.json"), load_profile(path))
    assert law is EQ6_TUNED
    assert vector.tolist() == [entry["value"] for entry in content["parameters"].values()]


def test_the_episodes_that_were_simulated_are_those_of_the_recipe(tmp_path):
    stages = {}
    tune(tmp_path, SMALL, lambda name, stage: stages.update({name: stage}))
    assert sum(stage["history"][-1][0] for stage in stages.values()) == SMALL.episodes == 2 * 6 * (2 * 3 + 4 * 3)
    for stage in stages.values():
        assert [entry[0] for entry in stage["history"]] == [12, 24, 36, 60, 84, 108]


def test_no_other_splits_than_train_and_validation_are_played(tmp_path, monkeypatch):
    seen = []

    def watched(protocol):
        seen.append(protocol.split)
        return Trials(protocol)

    monkeypatch.setattr(tuning, "Trials", watched)
    tune(tmp_path, replace(SMALL, seeds=(1,)))
    assert seen == ["train", "validation"]


def test_a_finished_start_is_not_done_again_and_an_interrupted_study_goes_on(tmp_path, monkeypatch):
    first = tune(tmp_path / "whole", SMALL)
    done = []
    search = tuning.search
    monkeypatch.setattr(
        tuning, "search", lambda recipe, seed, *trials: done.append(seed) or search(recipe, seed, *trials)
    )
    tune(tmp_path / "parts", replace(SMALL, seeds=(2,)))
    assert tune(tmp_path / "parts", SMALL) == first
    assert tune(tmp_path / "parts", SMALL) == first
    assert done == [2, 1]
    tune(tmp_path / "parts", replace(SMALL, validation=6))
    assert done == [2, 1, 1, 2]


def test_a_damaged_stage_is_done_again(tmp_path):
    first = tune(tmp_path, SMALL)
    path = tmp_path / "testbed" / "stages" / "eq6-tuned-steps-1.json"
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
    ],
)
def test_wrong_recipes_are_refused(wrong, message):
    with pytest.raises(AmulettError, match=message):
        replace(SMALL, **wrong)
