"""Whatever device, scenario and actions: no NaN, strings that never push, limits that hold, no energy from nowhere.

`pytest tests/simulation/test_numbers.py --hypothesis-profile=nightly` tries 10,000 examples of each; CI tries 200.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from any_device import actions, profiles, scenarios, tension_ranges
from helpers import NO_GAINS, device
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from amulett_gym import FAILURES
from amulett_gym.envs import eq6_costs
from amulett_gym.envs.single import TensionEnv
from amulett_gym.envs.transition import METRICS
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import CELLS, build_tables
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import BY_STIFFNESS, CONTROLS, STATE_NAMES, TENSION_LAWS
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import load_scenario, pack

KEYWORDS = st.fixed_dictionaries(
    {
        "control": st.sampled_from(CONTROLS),
        "tension_law": st.sampled_from(list(TENSION_LAWS)),
        "tension_range": tension_ranges,
        "observation_noise": st.sampled_from([0.0, 0.1, 1e300]),
        "privileged": st.booleans(),
    }
)
MAY_BE_NAN = ("inside_since", "stiffness_setpoint")
ROUNDING = 1 + 1e-9
SINGLE = 1 + 1e-6  # a scenario's numbers are kept as float32

# Devices whose springs cannot hold the posture that is drawn are refused, with reason; and there are many keys.
many = settings(suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow, HealthCheck.data_too_large])


@pytest.fixture(scope="module", autouse=True)
def brief() -> Iterator[None]:
    """Measure what eq. 6 costs on each of many devices with a short episode, and keep none of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eq6_costs, "cache_folder", lambda: None)
        patch.setattr(eq6_costs, "_known", {})
        patch.setattr(eq6_costs, "EPISODES", 4)
        patch.setattr(eq6_costs, "DURATION", 0.6)
        patch.setattr(eq6_costs, "MOST_STEPS", 10_000)
        yield


def played(make: Any) -> Any:
    """Return what a device gives, unless it is refused: by an error of ours, never by another."""
    try:
        return make()
    except AmulettError:
        assume(False)


@st.composite
def episodes(draw: st.DrawFn) -> tuple[TensionEnv, dict[str, Any]]:
    profile = draw(profiles())
    period = profile.loop.control_period * draw(st.sampled_from([1, 2, 8]))
    env = played(lambda: TensionEnv(profile=profile, agent_period=period, **draw(KEYWORDS)))
    scenario = draw(scenarios(profile))
    played(lambda: env.reset(seed=0, options={"scenario": scenario}))
    # Position-only control may have to start beyond the drives' limits where something loads the arm.
    assume(env.episodes.simulation.parameters["tension_loop"][0] or drives_within_limits(env))
    return env, scenario


@many
@given(episodes(), st.lists(actions, min_size=1, max_size=10))
def test_no_number_is_nan_and_no_limit_is_passed(episode, agent):
    env, scenario = episode
    observation, info = env.reset(seed=0, options={"scenario": scenario})
    reward, terminated = 0.0, False
    for action in [*agent, None]:
        assert env.observation_space.contains(observation)
        assert math.isfinite(reward) and reward <= 0
        assert terminated == (info["failure"] != 0)
        assert ("stiffness_setpoint" in info) == (env.settings.control in BY_STIFFNESS)
        assert all(map(math.isfinite, info.values())), info
        assert all(info[name] >= 0 for name in METRICS), info
        strings_only_pull(env, scenario["device"])
        assert drives_within_limits(env)
        if action is None or terminated:
            break
        before = {name: env.episodes.simulation.read(name)[0] for name in ("drive_biceps", "drive_triceps")}
        observation, reward, terminated, _, info = env.step(np.array([action]))
        speed_keeps_its_limit(env, before)
    for name in STATE_NAMES:
        assert np.isfinite(env.episodes.simulation.read(name)[0]) or name in MAY_BE_NAN, name


def strings_only_pull(env: TensionEnv, built: dict[str, float]) -> None:
    state = {name: float(env.episodes.simulation.read(name)[0]) for name in STATE_NAMES}
    radius = env.profile.plant.drive_pulley_radius
    wound = state["angle"] * env.profile.plant.joint_pulley_radius
    for drive, sign in (("biceps", 1.0), ("triceps", -1.0)):
        stretch = sign * (state[f"drive_{drive}"] * radius * built[f"pulley_{drive}"] - wound)
        most = built[f"spring_{drive}"] * env.episodes.simulation.max_force
        held = env.profile.spring.beyond in (None, "held")  # else the force rises beyond the table's end
        assert 0 <= state[f"force_{drive}"] <= (most * SINGLE if held else math.inf)
        doubt = 1e-12 + (SINGLE - 1) * (abs(wound) + abs(state[f"drive_{drive}"]) * radius * built[f"pulley_{drive}"])
        assert stretch > -doubt or state[f"force_{drive}"] == 0
        assert state[f"estimate_{drive}"] >= -1e-12 * most  # on its way to 0 the low-pass may round to just beyond


def drives_within_limits(env: TensionEnv) -> bool:
    limit = env.episodes.simulation.parameters["command_limit"][0] * ROUNDING
    names = (f"{kind}_{drive}" for kind in ("command", "drive") for drive in ("biceps", "triceps"))
    return all(abs(env.episodes.simulation.read(name)[0]) <= limit for name in names)


def speed_keeps_its_limit(env: TensionEnv, before: dict[str, float]) -> None:
    if env.profile.drives.lag > 0 and env.profile.drives.rate_limit_deg is not None:
        most = math.radians(env.profile.drives.rate_limit_deg) * env.episodes.agent_period
        for name, was in before.items():
            turned = abs(env.episodes.simulation.read(name)[0] - was)
            assert turned <= most * ROUNDING + 1e-12 * abs(was), name


@st.composite
def passive_arms(draw: st.DrawFn) -> tuple[Profile, dict[str, Any]]:
    """Draw an arm between held drives, thrown by a push, whose swing takes 300 integration steps or more."""
    still = {"position": NO_GAINS, "tension": NO_GAINS, "position_only": NO_GAINS, "agonist": "biceps"}
    limits = {"angle_limit_deg": 180.0, "velocity_limit_deg": 1e5}
    profile = draw(profiles(only=("plant", "spring", "damping"), plant=limits))
    tables = build_tables(profile.spring)
    scenario = {
        "initial_tension": draw(st.floats(0.05, 0.6)) * tables.max_force,
        "initial_angle_deg": draw(st.floats(-60, 60)),
        "orientation": draw(st.sampled_from(["horizontal", "vertical"])),
    }
    row = played(lambda: pack(load_scenario(scenario), profile))
    inertia, pulley = float(row["inertia"][0]), profile.plant.joint_pulley_radius
    swing = math.sqrt(2 * tables.max_stiffness * pulley**2 / inertia)
    swing += math.sqrt(float(row["static_torque"][0]) / inertia) + 2 * profile.damping.d
    period = min(0.1, 1 / swing)
    assume(period >= 1e-6)
    thrown = draw(st.floats(-0.9, 0.9)) * tables.max_force * pulley
    scenario["pushes"] = [{"time": 0.0, "duration": 2 * period, "torque": min(max(thrown, -100), 100)}]
    loop = {**profile.loop.model_dump(), **still, "control_period": period, "substeps": 50}
    ideal = {"lag": 0.0, "rate_limit_deg": None, "command_limit_deg": None}
    groups = {"base": profile.base, "plant": profile.plant.model_dump(), "spring": profile.spring.model_dump()}
    groups |= {"damping": profile.damping.model_dump(), "loop": loop, "drives": ideal}
    return load_profile({"name": "passive", **groups}), scenario


@many
@given(passive_arms())
def test_an_arm_between_held_drives_never_gains_energy(arm):
    profile, scenario = arm
    simulation = Simulation(profile)
    played(lambda: simulation.reset(pack(load_scenario(scenario), profile)))
    motion = record(simulation, 60)
    energy, error = mechanical_energy(profile, scenario, motion)
    free = energy[3:]  # the push is over
    grown = (free - np.minimum.accumulate(free)).max()
    assert grown <= error


@pytest.mark.parametrize("end", [{}, {"beyond": "continued"}, {"beyond": "hard-stop", "stop_stiffness": 2e4}])
def test_an_arm_that_pulls_a_string_beyond_its_springs_table_never_gains_energy(end):
    still = {"position": NO_GAINS, "tension": NO_GAINS, "position_only": NO_GAINS, "agonist": "biceps"}
    profile = load_profile(
        {
            "name": "passive",
            "base": "simulation",
            "spring": end,
            "damping": {"a": 0.0, "d": 5.445},
            "loop": {**still, "control_period": 0.004, "substeps": 50},
        }
    )
    scenario = {"initial_tension": 12.0, "pushes": [{"time": 0.0, "duration": 0.012, "torque": 1.5}]}
    simulation = Simulation(profile)
    simulation.reset(pack(load_scenario(scenario), profile))
    motion = record(simulation, 120)
    stretch = motion["angle"] * profile.plant.joint_pulley_radius
    stretch = stretch - motion["drive_triceps"] * profile.plant.drive_pulley_radius
    assert stretch.max() > 1.05 * build_tables(profile.spring).max_deflection
    energy, error = mechanical_energy(profile, scenario, motion)
    free = energy[4:]
    assert (free - np.minimum.accumulate(free)).max() <= error


def mechanical_energy(profile: Profile, scenario: dict[str, Any], motion: Any) -> tuple[Any, float]:
    """Return kinetic energy, springs' and weight's in each tick [J], and a bound on the integration's error."""
    tables = build_tables(profile.spring)
    knots = np.linspace(0, tables.max_deflection, CELLS + 1)
    stored = PchipInterpolator(knots, np.append(tables.force[:, 0], tables.max_force)).antiderivative()

    slope, free_length, width, _ = tables.beyond

    def spring_energy(stretch: Any) -> Any:
        inside = stored(np.clip(stretch, 0, tables.max_deflection))
        x = np.maximum(stretch / tables.max_deflection, 1.0)  # beyond the table's end the force rises by g(x) - g(1)
        reach, reach_at_end = np.hypot(width, x), math.hypot(width, 1.0)
        rise = slope * (0.5 * (x * x - 1.0) - free_length * (reach - reach_at_end))
        held = tables.max_force - slope * (1.0 - free_length / reach_at_end)
        return inside + tables.max_deflection * (rise + held * (x - 1.0))

    row = pack(load_scenario(scenario), profile)[0]
    radius, pulley = profile.plant.drive_pulley_radius, profile.plant.joint_pulley_radius
    parts = [
        0.5 * row["inertia"] * motion["velocity"] ** 2,
        -row["static_torque"] * np.cos(motion["angle"]),
        spring_energy(motion["drive_biceps"] * radius - motion["angle"] * pulley),
        spring_energy(motion["angle"] * pulley - motion["drive_triceps"] * radius),
    ]
    rounding = 1e-13 * max(motion["force_biceps"].max(), motion["force_triceps"].max()) * pulley
    rounding += 1e-13 * sum(np.abs(part).max() for part in parts)
    return sum(parts), 1e-4 * sum(np.ptp(part) for part in parts) + rounding


@st.composite
def batches(draw: st.DrawFn) -> tuple[Profile, dict[str, Any], list[Any], int]:
    """Draw devices of one kind, each in a scenario of its own, and which of them to throw off its limits."""
    profile = draw(profiles())
    keywords = {**draw(KEYWORDS), "agent_period": profile.loop.control_period * draw(st.sampled_from([1, 8]))}
    env = played(lambda: TensionEnv(profile=profile, **keywords))
    rest = {"initial_tension": 0.1 * env.episodes.simulation.max_force}
    rows = []
    for _ in range(draw(st.integers(2, 5))):
        scenario = draw(scenarios(profile))
        try:
            env.reset(seed=0, options={"scenario": scenario})
        except AmulettError:
            scenario = rest
        rows.append(scenario)
    return profile, keywords, rows, draw(st.integers(0, len(rows) - 1))


def go(env: Any, steps: Any) -> list[Any]:
    """Return all that the given steps give, arrays one row a device."""
    gone = []
    for action in steps:
        observations, rewards, terminated, truncated, info = env.step(action)
        gone += [observations, rewards, terminated, truncated, *info.values()]
    return gone


@many
@given(batches(), st.lists(actions, min_size=2, max_size=6))
def test_an_unstable_device_never_reaches_its_neighbours(batch, agent):
    profile, keywords, rows, place = batch
    others = [i for i in range(len(rows)) if i != place]
    steps = [np.full((len(rows), 1), action) for action in agent]
    thrown = {
        "initial_tension": rows[place].get("initial_tension"),
        "pushes": [{"time": 0.0, "duration": 100.0, "torque": 100.0}],
    }

    def play(scenarios: list[Any]) -> list[Any]:
        env = TensionVectorEnv(num_envs=len(scenarios), profile=profile, **keywords)
        env.reset(seed=0, options={"scenario": scenarios})
        return go(env, steps)

    # Refused: the suite whose episodes follow may hold a posture that the springs cannot.
    calm = played(lambda: play(rows))
    wild = played(lambda: play([*rows[:place], thrown, *rows[place + 1 :]]))
    for one, other in zip(calm, wild, strict=True):
        np.testing.assert_array_equal(one[others], other[others])


def test_a_device_that_is_thrown_off_its_limits_is_terminated_among_calm_ones():
    rest, thrown = {}, {"pushes": [{"time": 0.0, "duration": 10.0, "torque": 100.0}]}
    env = TensionVectorEnv(num_envs=3)
    env.reset(seed=0, options={"scenario": [rest, thrown, rest]})
    ended = [env.step(np.zeros((3, 1)))[2] for _ in range(20)]
    assert np.any(ended, axis=0).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("damping", "failure"),
    [
        (1.2, "joint angle limit"),
        (1.5, "joint angle limit"),
        (2.0, "state is not finite"),
        (4.0, "state is not finite"),
    ],
)
def test_however_far_an_unstable_device_gets_in_one_tick_every_number_is_finite(damping, failure):
    # A friction that its integration steps follow just so, times a scenario's factor: 1e12, 1e75, 1e157 deg, infinity.
    env = TensionEnv(profile=device("testbed", damping={"d": 72919.0}, loop={"substeps": 146}))
    push = {"time": 0.0, "duration": 1.0, "torque": 0.1}
    _, first = env.reset(seed=0, options={"scenario": {"device": {"damping": damping}, "pushes": [push]}})
    _, reward, terminated, _, info = env.step(np.zeros(1))
    assert terminated and FAILURES[info["failure"]] == failure and -501 <= reward <= -500
    if failure == "state is not finite":  # it keeps the last state, and its motion counts nowhere
        kept = "joint_angle", "force_biceps", "force_triceps", "contact_torque", "push_torque", "drive_work"
        assert [info[key] for key in kept] == [first[key] for key in kept]
    assert all(map(math.isfinite, info.values()))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plant": {"masses": [{"mass": 1e-3, "arm": 0.05}]}}, "oscillates by .* rad in an integration step"),
        ({"spring": {"beyond": "hard-stop", "stop_stiffness": 5e6}}, "oscillates by .* rad in an integration step"),
        (
            {"spring": {"beyond": "hard-stop", "stop_stiffness": 5e5}, "drives": {"stall_torque": 0.3}},
            "has drives that give way by .* time constants",
        ),
        ({"damping": {"d": 1000.0}}, "is damped by .* time constants"),
    ],
)
def test_a_device_too_quick_for_its_integration_steps_is_refused(changes, message):
    with pytest.raises(AmulettError, match=message) as refused:
        TensionEnv(profile=device("testbed", **changes))
    least = int(str(refused.value).rsplit(" ", 1)[1])
    TensionEnv(profile=device("testbed", **changes, loop={"substeps": least})).reset(seed=0)


def test_an_elastic_structure_counts_in_the_check_of_the_integration_step():
    stop = {"beyond": "hard-stop", "stop_stiffness": 5e6}
    TensionEnv(profile=device("testbed", spring=stop, structure={}))  # rigid, it is refused
    with pytest.raises(AmulettError, match="oscillates by .* rad in an integration step"):
        TensionEnv(profile=device("testbed", spring=stop, structure={"stiffness": 5e6}))


def test_a_lag_shorter_than_an_integration_step_is_refused():
    with pytest.raises(AmulettError, match=r"drives.lag is 0.0005 s; .* it has to be 0, or at least 0.001 s"):
        device("testbed", drives={"lag": 5e-4})
