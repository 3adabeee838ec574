"""Shared fixtures: the shipped profiles and environments. Hypothesis: 200 examples, or 10,000 by its profile `nightly`.

``pytest --hypothesis-profile=nightly`` chooses it; tests that name their own number of examples keep that.
"""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

from amulett_gym.config import Profile, load_profile

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

settings.register_profile("ci", max_examples=200, deadline=None)
settings.register_profile("nightly", max_examples=10_000, deadline=None)
settings.load_profile("ci")


@pytest.fixture(params=["testbed", "simulation"])
def profile(request: pytest.FixtureRequest) -> Profile:
    """Each of the shipped profiles."""
    return load_profile(request.param)
