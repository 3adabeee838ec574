"""The time until PPO beats its baselines counts training alone, and held-out scenarios confirm that it beats them."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("torch")
from amulett_agents.speed import learning_time
from amulett_agents.speed.learning_time import CONSTANTS, Baselines, Evaluator, time_to_beat, with_neutral_start
from amulett_gym.evaluation.runner import evaluate


def test_the_baselines_are_what_eq6_and_the_best_constant_cost(recipe):
    evaluator = Evaluator(with_neutral_start(recipe))
    baselines = evaluator.baselines["validation"]
    names = [f"constant:{tension:g}" for tension in CONSTANTS]
    results = evaluate(["eq6", *names], "mixed", split="validation", episodes=4, duration=1.25, agent_period=0.05)
    costs = {name: values["cost"].mean() for name, values in results.values.items()}
    assert baselines.eq6 == pytest.approx(costs["eq6"], rel=1e-6) and baselines.eq6 > 0.0
    assert baselines.constant == pytest.approx(min(costs[name] for name in names), rel=1e-3)
    assert baselines.lower == min(baselines.eq6, baselines.constant)


def evaluator_of(costs: list[float], held_out: float) -> Any:
    """Return an evaluator with these costs one after another, and baselines at 1 and 0.5."""
    evaluator = object.__new__(Evaluator)
    evaluator.baselines = dict.fromkeys(("validation", "held-out"), Baselines(1.0, 0.5, 5.0))
    given = iter(costs)
    evaluator.cost = lambda model, split="validation": held_out if split == "held-out" else next(given)  # type: ignore
    return evaluator


def test_evaluations_are_not_counted(recipe, clock, monkeypatch):
    monkeypatch.setattr(learning_time, "warm_up", lambda config: None)
    evaluator = evaluator_of([2.0, 0.9, 0.4], held_out=0.3)
    slow = evaluator.cost
    evaluator.cost = lambda model, split="validation": ([clock() for _ in range(1000)], slow(model, split))[1]
    run = time_to_beat(recipe, evaluator, limit=1000.0)
    assert [cost for *_, cost in run.curve] == [2.0, 0.9, 0.4]
    assert 0 < run.curve[0][0] < run.eq6 < run.lower < 200
    assert run.eq6 == run.curve[1][0]


def test_a_baseline_counts_as_beaten_only_if_held_out_scenarios_confirm_it(recipe, clock):
    run = time_to_beat(recipe, evaluator_of([0.4] * 1000, held_out=0.8), limit=1e6)
    assert run.eq6 == run.curve[0][0]
    assert run.lower is None
    assert run.curve[-1][1] == recipe.total_steps


def test_a_run_ends_at_its_limit(recipe, clock):
    run = time_to_beat(recipe, evaluator_of([2.0] * 1000, held_out=2.0), limit=100.0)
    assert run.curve[-1][1] < recipe.total_steps
    assert run.eq6 is None
