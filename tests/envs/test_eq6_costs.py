"""What eq. 6 costs on a device is measured once, kept by content, and right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from helpers import HELD_DRIVES, device

from amulett_gym import ENV_IDS
from amulett_gym.envs import eq6_costs as module
from amulett_gym.envs.eq6_costs import NO_CONTACT, Eq6Costs, device_digest, eq6_costs, measure, shipped_costs
from amulett_gym.profile import Profile, device_names, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.tasks.suites import episode_keys, families_of, sample

MINE = {"name": "mine", "base": "testbed", "drives": {"lag": 0.2}}

WEAK = {"spring": {"stiffness": 1.0}}
"""Springs that cannot hold the nominal tension."""

RACING = {"plant": {"velocity_limit_deg": 120.0}}
"""A joint that fails in fast motions."""

MAKE = """
import json, sys
import gymnasium as gym
from amulett_gym.envs import eq6_costs
measured = eq6_costs.measure
def measure(*arguments):
    print("measured")
    return measured(*arguments)
eq6_costs.measure = measure
env = gym.make("amulett_gym:Amulett/Scaling-v0", profile={"name": "mine", "base": "testbed", "drives": {"lag": 0.2}})
print(env.unwrapped.episodes._constants["prices"].tolist())
"""


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder in which measured costs are kept; nothing is in memory, and measuring takes little."""
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(module, "_known", {})
    monkeypatch.setattr(module, "EPISODES", 8)
    return tmp_path / module.FOLDER


@pytest.fixture
def count(fresh: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Return how often anything was measured."""
    calls = []
    original = module.measure
    monkeypatch.setattr(module, "measure", lambda *arguments: calls.append(arguments) or original(*arguments))
    return lambda: len(calls)


def test_costs_are_the_mean_metrics_of_eq6_in_training_scenarios():
    profile, numbers = load_profile(MINE), np.arange(400, dtype=np.uint64)
    simulation = Simulation(profile, 400, tension_law="eq6")
    simulation.reset(sample("contact", episode_keys(numbers, 0 * numbers, "train"), profile))
    simulation.advance(4000)
    squared = np.degrees(1.0) ** 2
    metrics = {
        "position": squared * simulation.read("position_ise"),
        "effort": squared * (simulation.read("effort_biceps") + simulation.read("effort_triceps")),
        "tension": simulation.read("tension_ise"),
        "contact": simulation.read("contact_ise"),
        "drive_effort": squared * simulation.read("drive_effort"),
    }
    found = measure(profile, "contact")
    assert found is not None and found.failed == 0.0 and found.families == {"contact": found.mean}
    means = {term: values.mean() for term, values in metrics.items()}
    assert found.mean.model_dump() == pytest.approx(means, rel=6e-4)  # 4 digits


@pytest.mark.parametrize("suite", ["reach", "mixed"])
def test_costs_of_a_shipped_fleets_device_are_read_not_measured(suite, count, fresh, monkeypatch):
    profile = load_profile(MINE)
    found = measure(profile, suite)
    content = json.loads(json.dumps({device_digest(profile): {suite: module.compact(found), "steps": None}}))
    monkeypatch.setattr(module, "_fleet_costs", lambda: content)
    assert eq6_costs(profile, suite) == found and eq6_costs(profile, "steps") is None and count() == 0
    assert eq6_costs(profile, "track") is not None and count() == 1  # as of a device that is not shipped
    assert eq6_costs(load_profile({**MINE, "drives": {"lag": 0.21}}), suite) != found and count() == 2


def test_each_family_of_the_mix_has_its_own_costs():
    found = measure(load_profile(MINE), "mixed")
    assert found is not None and list(found.families) == families_of("mixed")
    positions = [costs.position for costs in found.families.values()]
    assert found.mean.position == pytest.approx(np.mean(positions), rel=0.05)
    assert max(positions) > 50.0 * min(positions)
    assert [family for family, costs in found.families.items() if costs.contact != NO_CONTACT] == ["contact"]


@pytest.mark.parametrize("name", device_names())
def test_names_sources_and_gains_of_other_loops_make_no_other_device(name):
    shipped = load_profile(name)
    other = next(each for each in device_names() if each != name)
    plain = {key: value for key, value in shipped.model_dump().items() if key != "loops"}
    plain["drives"] = {**plain["drives"], "sources": {}}
    same = load_profile({**plain, "name": other, "base": None, "description": "x"})
    assert device_digest(same) == device_digest(shipped)
    assert shipped_costs(same) == shipped_costs(shipped) == name
    assert shipped_costs(shipped.model_copy(update={"loops": load_profile(other).loops})) == name
    for group, key in (("plant", "drive_pulley_radius"), ("loop", "switch_filter"), ("sensors", "force_filter")):
        content = shipped.model_dump()
        changed = load_profile(merge(content, {group: {key: content[group][key] * 1.01 + 1e-4}}))
        assert shipped_costs(changed) is None and device_digest(changed) != device_digest(shipped)


def test_measured_once_by_content(count, fresh, monkeypatch):
    first = eq6_costs(load_profile(MINE), "reach")
    assert eq6_costs(load_profile({**MINE, "name": "the same"}), "reach") == first and count() == 1
    [path] = fresh.iterdir()
    monkeypatch.setattr(module, "_known", {})  # as another process
    assert eq6_costs(load_profile(MINE), "reach") == first and count() == 1
    eq6_costs(load_profile(MINE), "steps")
    eq6_costs(load_profile({**MINE, "drives": {"lag": 0.21}}), "reach")
    assert count() == 3 and len(list(fresh.iterdir())) == 3
    assert Eq6Costs.model_validate_json(path.read_text()) == first


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: "",
        lambda content: json.dumps(content)[:-9],
        lambda content: json.dumps({**content, "families": {}}),
        lambda content: json.dumps({**content, "mean": {**content["mean"], "effort": 0.0}}),
        lambda content: json.dumps({**content, "mean": {**content["mean"], "effort": "1"}}),
    ],
)
def test_a_damaged_file_is_measured_again(damage, count, fresh, monkeypatch):
    found = eq6_costs(load_profile(MINE), "reach")
    [path] = fresh.iterdir()
    path.write_text(damage(json.loads(path.read_text())))
    monkeypatch.setattr(module, "_known", {})
    assert eq6_costs(load_profile(MINE), "reach") == found and count() == 2
    assert Eq6Costs.model_validate_json(path.read_text()) == found


@pytest.mark.parametrize("place", ["none", "a file"])
def test_without_a_place_for_files_they_are_kept_in_memory(place, count, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(module, "cache_folder", lambda: None if place == "none" else tmp_path / "file")
    profile = load_profile(MINE)
    assert eq6_costs(profile, "reach") == eq6_costs(profile, "reach") == measure(profile, "reach")
    assert count() == 1


def test_processes_that_start_together_find_the_same_and_say_nothing(tmp_path):
    places = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    environment = {**os.environ, **places}
    compiled = module.cache_folder()
    assert compiled is not None
    here = tmp_path / "cache" / "amulett-gym" / compiled.name
    here.parent.mkdir(parents=True)
    here.mkdir()
    for path in compiled.glob("*.nb?"):
        (here / path.name).symlink_to(path)

    def make(number: int) -> tuple[str, str]:
        done = subprocess.run([sys.executable, "-c", MAKE], env=environment, capture_output=True, text=True, check=True)
        return done.stdout, done.stderr

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(make, range(2)))
    table = found[0][0].splitlines()[-1]
    assert all(out.splitlines()[-1] == table for out, _ in found)
    assert make(0) == (f"{table}\n", "")
    assert [path.suffix for path in (here / module.FOLDER).iterdir()] == [".json"]  # no temporary file is left
    assert {err for _, err in found} == {""}


def test_only_what_is_needed_is_measured(count, fresh):
    env = gym.make(ENV_IDS[0], profile=MINE, suite="reach").unwrapped
    assert [path.name.rpartition("-")[2] for path in fresh.iterdir()] == ["reach.json"]
    env.reset(seed=0)
    assert count() == 1
    env.reset(options={"scenario": {"obstacle": {"angle_deg": 30.0, "stiffness": 5.0}}})
    assert count() == 2
    reward = env.step(np.zeros(1, dtype=np.float32))[1]
    state = env.get_state()
    other = gym.make(ENV_IDS[0], profile=MINE, suite="reach").unwrapped
    other.set_state(state)  # a scenario of a family that it has never met
    for each in (env, other):
        rewards = [each.step(np.ones(1, dtype=np.float32))[1] for _ in range(3)]
        assert np.isfinite([reward, *rewards]).all()


@pytest.mark.parametrize("suite", ["hold-push", "reach"])
def test_a_loop_that_does_nothing_divides_by_no_zero(fresh, suite):
    still = device("testbed", loop=HELD_DRIVES)
    found = measure(still, suite)
    assert found is not None
    assert found.mean.effort == found.mean.drive_effort == 1.0  # the least
    assert found.mean.contact == NO_CONTACT


def test_costs_until_a_failure_count_as_rates(fresh, monkeypatch):
    monkeypatch.setattr(module, "EPISODES", 40)
    whole, racing = measure(load_profile("testbed"), "steps"), measure(device("testbed", **RACING), "steps")
    assert whole is not None and racing is not None
    assert whole.failed == 0.0 and 0.5 < racing.failed < 1.0
    # Those of the 3 s until a typical failure would be a third of these.
    for term in ("position", "tension", "drive_effort"):
        assert getattr(racing.mean, term) == pytest.approx(getattr(whole.mean, term), rel=0.25)


@pytest.mark.parametrize("groups", [WEAK, {"loop": {"control_period": 1e-6}}], ids=["weak", "fast"])
def test_a_device_that_eq6_cannot_play_is_not_measured(fresh, groups):
    assert eq6_costs(device("testbed", **groups), "steps") is None
    assert not fresh.exists()


def test_short_integration_steps_mean_fewer_episodes(monkeypatch):
    seen = []
    monkeypatch.setattr(module, "_play", lambda profile, rows: seen.append(len(rows)) or np.ones((7, len(rows))))
    for substeps in (1, 10, 100):
        seen.append(0)
        measure(device("testbed", loop={"substeps": substeps}), "reach")
        total, seen = sum(seen), []
        assert total == {1: 400, 10: 100, 100: module.LEAST_EPISODES}[substeps]


def test_the_number_of_cores_changes_no_bit(monkeypatch):
    monkeypatch.setattr(module, "EPISODES", 30)
    profile: Profile = load_profile(MINE)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(module, "_cores", lambda cores=cores: cores)
        found.append(measure(profile, "payload"))
    assert found[0] == found[1] is not None
