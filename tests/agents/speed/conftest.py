"""A small recipe, and a clock for tests that must not depend on the machine's speed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from helpers import SMALL_RECIPE


@pytest.fixture
def recipe():
    """Return a small recipe."""
    from amulett_agents import load_train_config

    return load_train_config(None, SMALL_RECIPE)


@pytest.fixture
def clock(monkeypatch):
    """Replace the clock by one that advances by a second each time it is read."""
    from amulett_agents.speed import learning_time, throughput

    ticking = iter(range(1_000_000))
    for module in (learning_time, throughput):
        monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: float(next(ticking))))
    return lambda: next(ticking)
