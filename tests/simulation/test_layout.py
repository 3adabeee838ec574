"""A profile's numbers reach the kernel: none is replaced by a constant on the way."""

from __future__ import annotations

import pytest
from helpers import PROFILES

from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.layout import LOOPS, pack_loop, pack_parameters
from amulett_gym.tasks.scenario import empty_rows


def numbers(tree, *path):
    """Yield the path and value of each number in a profile, those in lists by their index."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield (*path, key), value
        yield from numbers(value, *path, key)


def packed(profile):
    """Return all that the kernel reads of a profile."""
    parameters = (pack_parameters(profile, control, "eq6").tobytes() for control in ("decentralized", "position-only"))
    loops = (pack_loop(profile, control).tobytes() for control in LOOPS)
    return b"".join([*parameters, *loops, empty_rows(1, profile).tobytes()])


def changed(profile, path, value):
    """Return the profile with one number replaced."""
    content = profile.model_dump()
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return load_profile(merge(content, {"name": "changed"}))


@pytest.mark.parametrize("base", PROFILES)
def test_every_number_of_a_profile_reaches_the_kernel(base):
    profile = load_profile(base)
    before, met = packed(profile), 0
    for path, value in numbers(profile.model_dump()):
        others = {type(value)(other) for other in (value * 1.01, value * 0.99, value + 1, value - 1, 1e-4)} - {value}
        for other in others:
            try:
                after = packed(changed(profile, path, other))
            except AmulettError:  # out of its range, or against another key: try the next
                continue
            assert after != before, ".".join(map(str, path))
            met += 1
            break
        else:
            raise AssertionError(f"{path} can have no other value")
    assert met > 40
