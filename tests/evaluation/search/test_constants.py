"""The table of constant tensions."""

from __future__ import annotations

import numpy as np

from amulett_gym.evaluation.runner import evaluate
from amulett_gym.evaluation.search import constants


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
