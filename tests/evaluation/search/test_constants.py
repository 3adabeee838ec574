"""Best constant tensions."""

from __future__ import annotations

import numpy as np
import pytest

from amulett_gym.evaluation.runner import Protocol, evaluate
from amulett_gym.evaluation.search import constants
from amulett_gym.evaluation.search.trials import Trials, held
from amulett_gym.fleet import load_fleet


def test_costs_are_those_of_evaluate(capsys, monkeypatch):
    monkeypatch.setattr(constants, "TENSIONS", (8, 12))
    monkeypatch.setattr(constants, "suite_names", lambda: ["steps"])
    constants.main(["--scenarios", "3"])
    *_, row = capsys.readouterr().out.splitlines()
    suite, low, high, eq6, best, *_ = row.split()
    values = evaluate(["constant:8", "constant:12", "eq6"], episodes=3).values
    expected = [float(np.mean(values[name]["cost"])) for name in ("constant:8", "constant:12", "eq6")]
    assert suite == "steps" and [float(text) for text in (low, high, eq6)] == [round(cost, 3) for cost in expected]
    assert int(best) == (8 if expected[0] < expected[1] else 12)


@pytest.mark.parametrize(("control", "track"), [("decentralized", "schedule"), ("co-rotation", "full-control")])
def test_the_best_constant_of_each_device_is_found(control, track):
    fleet = load_fleet(["testbed", "simulation"])
    tensions, costs = constants.best_constants(fleet, "steps", control, track, scenarios=2)
    for profile, tension, cost in zip(fleet, tensions, costs, strict=True):
        trials = Trials(Protocol(profile, "steps", "train", episodes=2), control, track=track)
        low, high = trials.tension_range

        def mean(tension, trials=trials):
            return trials.costs(np.arange(2), held([tension] * 2, trials.tension_range), track=track).mean()

        assert cost == mean(tension)
        others = [min(max(tension + change, low), high) for change in (-1.0, -0.25, 0.25, 1.0)]
        assert cost <= min(mean(other) for other in [*others, low, 0.5 * (low + high), high])
    assert tensions[0] != tensions[1]
