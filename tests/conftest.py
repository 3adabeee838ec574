"""Shared fixtures: the shipped profiles and environments."""

from __future__ import annotations

import os

import pytest

from amulett_gym.config import Profile, load_profile

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")


@pytest.fixture(params=["testbed", "simulation"])
def profile(request: pytest.FixtureRequest) -> Profile:
    """Each of the shipped profiles."""
    return load_profile(request.param)
