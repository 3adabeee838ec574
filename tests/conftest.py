"""Shared fixtures: the shipped profiles and environments."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

from amulett_gym.config import Profile, load_profile

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

settings.register_profile("amulett", deadline=None)  # the first example of a process may have to compile
settings.load_profile("amulett")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for a night's run."""
    parser.addoption("--nightly", action="store_true", help="try 10,000 random inputs where 200 are tried by default")


@pytest.fixture(scope="session")
def tries(request: pytest.FixtureRequest) -> int:
    """How many random inputs to try."""
    return 10_000 if request.config.getoption("--nightly") else 200


@pytest.fixture(params=["testbed", "simulation"])
def profile(request: pytest.FixtureRequest) -> Profile:
    """Each of the shipped profiles."""
    return load_profile(request.param)
