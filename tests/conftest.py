"""Shared fixtures: the shipped profiles and environments. Hypothesis: 200 examples, or 10,000 by its profile `nightly`.

``pytest --hypothesis-profile=nightly`` chooses it; tests that name their own number of examples keep that. The 200 are
always the same, so that one code gets one verdict; the 10,000 are others each night.
"""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Callable

import pytest
from hypothesis import settings

from amulett_gym.profile import Profile, load_profile

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

settings.register_profile("ci", max_examples=200, deadline=None, derandomize=True)  # of one code, one verdict
settings.register_profile("nightly", max_examples=10_000, deadline=None)
settings.load_profile("ci")


@pytest.fixture(params=["testbed", "simulation"])
def profile(request: pytest.FixtureRequest) -> Profile:
    """Each of the shipped profiles."""
    return load_profile(request.param)


@pytest.fixture
def faults(request: pytest.FixtureRequest) -> Callable[[str, int], None]:
    """Count what became of the faults that a test injects; the counts are printed at the end of the run."""

    def count(outcome: str, number: int = 1) -> None:
        request.node.user_properties.append((f"faults {outcome}", number))

    count("lost", 0)  # so that a test that fails before it has counted is known to have injected some
    return count


def pytest_collection_finish() -> None:
    """Let searches for garbage pass by what was imported and collected until now: each would take half a second."""
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how many faults were injected, and what became of them."""
    counts: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if getattr(report, "when", None) == "call":
                found = [(name, number) for name, number in report.user_properties if name.startswith("faults ")]
                for name, number in found:
                    if number:
                        counts[f"{name} by {report.location[0]}"] += number
                counts["lost"] += bool(found) and report.failed
    if any(counts.values()):
        terminalreporter.section("faults injected")
        for name, number in sorted(counts.items()):
            terminalreporter.write_line(f"{number:8,d} {name.removeprefix('faults ')}")
