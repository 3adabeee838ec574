"""A profile's numbers reach the kernel: none is replaced by a constant on the way."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import PROFILES

from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import BY_STIFFNESS, DRIVES, LOOPS, pack_loop, pack_parameters
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
        if path[-1] == "lead" and profile.drives.lag == 0.0:
            continue  # a share of no lag
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


@pytest.mark.parametrize("control", BY_STIFFNESS)
@pytest.mark.parametrize(
    ("spring", "reason"),
    [
        ({"free_length": 0.0}, r"is 1.932e\+04 N/m at rest and 1.932e\+04 N/m at their end"),
        ({"measured_curve": "deflection_m,force_N\n0,0\n0.001,5\n0.002,9\n0.004,12\n"}, "soften, from .* N/m at .* mm"),
    ],
    ids=["linear", "softening"],
)
def test_a_stiffness_needs_springs_that_stiffen(control, spring, reason):
    profile = load_profile({"name": "other", "base": "testbed", "spring": spring})
    with pytest.raises(AmulettError, match=f"control '{control}' sets the joint stiffness.*{reason}"):
        pack_loop(profile, control)
    pack_loop(profile, "co-rotation")


@pytest.mark.parametrize("control", [*LOOPS, DRIVES])
def test_loops_take_the_end_of_the_springs_table_whatever_follows(control):
    held = pack_loop(load_profile("testbed"), control)
    for spring in ({"beyond": "continued"}, {"beyond": "hard-stop", "stop_stiffness": 4e4}):
        changed = {"name": "changed", "base": "testbed", "spring": spring, "drives": {"stall_torque": 0.3}}
        assert pack_loop(load_profile(changed), control).tobytes() == held.tobytes()


def test_a_lead_is_a_share_of_the_lag():
    profile = load_profile("testbed")
    for share in (0.0, 1.0, 2.5):
        own = changed(profile, ("loops", "cascade", "lead"), share)
        assert pack_loop(own, "cascade")["lead"] == share * profile.drives.lag


@pytest.mark.parametrize(
    ("control", "name"),
    [
        ("feedback-linearisation", "taut_force"),
        ("computed-torque", "least_tension"),
        ("minimal-motion", "least_tension"),
    ],
)
def test_springs_have_to_reach_the_force_that_a_loop_needs(control, name):
    def soft(force):
        gains = {control.replace("-", "_"): {name: force}}
        return load_profile({"name": "soft", "base": "testbed", "spring": {"stiffness": 1500.0}, "loops": gains})

    reason = rf"'{control}'.*'loops\.{control.replace('-', '_')}\.{name}', 3.5 N.* at most 3.367 N"
    with pytest.raises(AmulettError, match=reason):
        Simulation(soft(3.5), 1, control)
    Simulation(soft(3.3), 1, control)
    Simulation(soft(3.5), 1, "co-rotation")


@pytest.mark.parametrize("control", BY_STIFFNESS)
def test_a_measured_curve_may_have_a_dent(control):
    deflection = np.linspace(0.0, 0.006, 12)
    force = 1e8 * deflection**3
    force[6] *= 1.05
    curve = {"deflection_m": deflection, "force_N": force}
    profile = load_profile({"name": "other", "base": "testbed", "spring": {"measured_curve": curve}})
    assert np.diff(build_tables(profile.spring).force[:, 1]).min() < 0.0
    pack_loop(profile, control)
