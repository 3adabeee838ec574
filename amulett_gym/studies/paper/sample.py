"""A sample of plausible devices: physics that explains Tables 2-5 under one configuration of the testbed's loop.

The testbed's loop (control period, filters, gains, floor) is that of the shipped profile; only physics is searched,
and the filters of the simulation, which is another device. Independent searches, some of them with a given law of the
spring, are each followed by a walk through the sets whose cost exceeds the least one by at most a bound. The last
places of the walkers are a sample of these sets. Each gets a draw of what no table sees (`parameters.UNSEEN`), and is
taken in if it is still within the bound, and if the environments can play it. Each fleet gets springs of all kinds.
Stages are kept as in `study`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.envs.eq6_costs import FLEET_COSTS, compact, device_digest, measure
from amulett_gym.envs.settings import Settings
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.diagnosis import diagnose
from amulett_gym.evaluation.search.constants import best_constants
from amulett_gym.identification.parameters import UNSEEN, profile_changes, resized, searched
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import write_json, write_text
from amulett_gym.studies.paper.objective import SIMULATED, WEIGHTS, cost, reproduced, residual
from amulett_gym.studies.paper.reproduction import Readings
from amulett_gym.studies.paper.stages import Report, begin_stages
from amulett_gym.studies.paper.study import EQUAL, shipped
from amulett_gym.studies.paper.tables import TABLES_2_TO_5
from amulett_gym.tasks.suites import episode_keys, suite_names
from amulett_gym.tasks.suites import sample as sample_suite
from amulett_gym.workers.call import ALONE, Workers

FLEETS = {"plausible": "plausible", "plausible-choose": "choose", "plausible-held-out": "held-out"}
"""Name of each fleet -> begin of its devices' names."""

RECIPE, CONTENT = "fleet-recipe.json", "fleet.json"
"""Files of a sample's folder: what was asked for, by which the folder is recognised, and the result."""

PASSES = 20
"""Most draws of what no table sees for each of the walked sets."""

UNUSABLE = ("cannot start", "fails", "spring end")
"""Findings of `diagnose` in the default tension range with which a device is not taken in."""

BEGUN = 100
"""Training scenarios of each suite that a device has to be able to begin."""

SUITE = "mixed"
SCENARIOS = 40
STIFFNESS_AT = (5.0, 15.0)
"""What shows how different the devices are for a law: the best constant in 40 training scenarios of a suite, what eq. 6
costs in it, and the stiffness of the resting joint at two tensions [N]."""


@dataclass(frozen=True)
class Recipe:
    """Size of a sample; the defaults gave the shipped fleets."""

    seeds: tuple[int, ...] = (1, 2, 3, 4, 5, 6)  # of the independent starts; the first one draws
    spring_laws: tuple[float, ...] = (0.0, 0.7)  # `length_ratio` of a further start each: linear, strong pretension
    population: int = 150  # candidates of each start; half as many walk from each
    generations: int = 160  # of each start
    steps: int = 60  # moves of each walker
    bound: float = EQUAL  # largest cost above the least one
    devices: tuple[int, ...] = (64, 16, 32)  # of each of `FLEETS`


def sample(
    folder: str | Path,
    recipe: Recipe,
    readings: Readings,
    workers: Workers = ALONE,
    report: Report = lambda name, stage: None,
    overwrite: bool = False,
    command: Sequence[str] = (),
) -> dict[str, Any]:
    """Draw a sample of devices, write it, and return the content of ``fleet.json``.

    Parameters
    ----------
    folder : str or Path
        For ``stages/*.json``, ``fleet.json``, a YAML file for each of `FLEETS`, and what eq. 6 costs on the devices.
    readings : Readings
        With the treatment of the floor and the end of the springs' curve that the devices have.
    report : callable
        Called with the name and the result of each of the `stage_count` stages.
    overwrite : bool
        Whether a sample of another recipe in the folder may be replaced.
    command : sequence of str
        The words of the command, for ``command.json`` and the head of the YAML files.

    Raises
    ------
    AmulettError
        If a file cannot be read or written, the folder holds a sample of another recipe that may not be replaced, or
        too few sets are within the bound.
    """
    folder = Path(folder)
    stages, run = begin_stages(folder, RECIPE, recipe, readings, workers, report, overwrite, command)
    run(_starts(recipe))
    starts = {name: stages[name] for name in _starts(recipe)}
    limit = min(start["cost"] for start in starts.values()) + recipe.bound
    walk = {"limit": limit, "walkers": max(recipe.population // 2, 2), "steps": recipe.steps, "last": True}
    walks = {
        f"walk-{name}": {"seed": k, "candidates": start["population"], **walk, "loop": False}
        for k, (name, start) in enumerate(starts.items())
    }
    run(walks)
    walked = [member for name in walks for member in stages[name]]
    members = [{name: float(f"{value:.6g}") for name, value in member.items()} for member in walked]
    count = sum(recipe.devices)
    draws = {"members": members, "limit": limit, "count": count, "seed": recipe.seeds[0]}
    run({"draws": {**draws, "unseen": [asdict(free) for free in UNSEEN], "passes": PASSES, "begun": BEGUN}}, _draw)
    drawn = stages["draws"]["devices"]
    if len(drawn) < count:
        raise AmulettError(
            f"only {len(drawn)} of {count} devices were found among {len(members)} sets within the bound of "
            f"{recipe.bound:g}; more walkers (--population), a larger --bound or fewer --devices give them"
        )
    named = _split(drawn, recipe)
    profiles = {name: profile_content(name, device["parameters"], readings) for name, device in named.items()}
    law = {"suite": SUITE, "scenarios": SCENARIOS, "stiffness_at": STIFFNESS_AT}
    run({f"device-{name}": {"profile": profiles[name], **named[name], **law} for name in named}, _judge)
    content = _content(recipe, readings, stages, named, members, command)
    for fleet, begin in FLEETS.items():
        own = [profile for name, profile in profiles.items() if name.startswith(f"{begin}-")]
        write_text(folder / f"{fleet}.yaml", _fleet_text(own, command))
    costs = {device_digest(load_profile(profiles[name])): stages[f"device-{name}"]["eq6"] for name in named}
    lines = [f"{json.dumps(digest)}: {json.dumps(own)}" for digest, own in costs.items()]
    write_text(folder / FLEET_COSTS, "{\n" + ",\n".join(lines) + "\n}\n")
    write_json(folder / CONTENT, content)
    return content


def stage_count(recipe: Recipe) -> int:
    """Return the number of a sample's stages."""
    return 2 * len(_starts(recipe)) + len(("draws",)) + sum(recipe.devices)


def _starts(recipe: Recipe) -> dict[str, dict[str, Any]]:
    """Return the stages that search, with their calls by name."""
    size = {"population": recipe.population, "generations": recipe.generations, "loop": False}
    first = {"seed": recipe.seeds[0], **size}
    return {f"start-{seed}": {"seed": seed, **size} for seed in recipe.seeds} | {
        f"start-spring-{ratio:g}": {**first, "fixed": {"length_ratio": ratio}} for ratio in recipe.spring_laws
    }


def ship(folder: str | Path) -> Path:
    """Copy the fleets of a folder, and what eq. 6 costs on their devices, into the package; return the place."""
    with resources.as_file(resources.files("amulett_gym") / "fleets") as place:
        for name in (*(f"{fleet}.yaml" for fleet in FLEETS), FLEET_COSTS):
            write_text(place / name, (Path(folder) / name).read_text("utf-8"))
        return Path(place)


def profile_content(name: str, parameters: Mapping[str, float], readings: Readings) -> dict[str, Any]:
    """Return the profile of a testbed with a set of parameters: its differences from the shipped one, with sources."""
    changes = profile_changes(parameters, readings.spring_end)["testbed"]
    testbed = load_profile("testbed")
    if readings.floor != testbed.sensors.below_floor:
        changes = merge(changes, {"sensors": {"below_floor": readings.floor}})
    content: dict[str, Any] = {"name": name, "base": "testbed", "description": "A plausible device of the sample."}
    for group, values in changes.items():
        own = {key: value for key, value in values.items() if value is not None}
        content[group] = {**own, "sources": {key: _source(key) for key in own}}
    return content


def _source(key: str) -> str:
    if key in ("beyond", "below_floor"):
        return "assumed: a reading of the paper"
    unseen = ("joint_pulley_radius", "encoder_noise_deg", "potentiometer_travel", "command_limit_deg")
    return "assumed: drawn from a range" if key in unseen else "identified: one of the sets that explain the tables"


def _split(drawn: Sequence[Mapping[str, Any]], recipe: Recipe) -> dict[str, Mapping[str, Any]]:
    """Return the devices by their names, fleet by fleet.

    Each fleet, the smallest one first, takes devices at equal distances of those that are left, in the order of the
    springs' free length: by chance, a small fleet may miss a kind of spring.
    """
    left = sorted(drawn, key=lambda device: float(device["parameters"]["length_ratio"]))
    sizes = dict(zip(FLEETS.values(), recipe.devices, strict=True))
    rng = np.random.default_rng(recipe.seeds[0])
    taken: dict[str, list[Mapping[str, Any]]] = {}
    for begin, size in sorted(sizes.items(), key=lambda item: item[1]):
        places = set(((np.arange(size) + 0.5) * len(left) / size).astype(int).tolist())
        own = [device for k, device in enumerate(left) if k in places]
        left = [device for k, device in enumerate(left) if k not in places]
        taken[begin] = [own[k] for k in rng.permutation(size)]
    return {f"{begin}-{k:02}": device for begin in sizes for k, device in enumerate(taken[begin], start=1)}


def _draw(call: Mapping[str, Any], readings: Mapping[str, Any]) -> dict[str, Any]:
    """Return devices, each another of the members, and the number of draws and why some were refused.

    All members without a device get one draw in each pass.
    """
    taken, rng = Readings(**readings), np.random.default_rng(call["seed"])
    refused = dict.fromkeys(("range", "cost", "environment"), 0)
    waiting = [call["members"][k] for k in rng.permutation(len(call["members"]))]
    found: list[dict[str, Any]] = []
    for _ in range(PASSES):
        left = []
        for member in waiting:
            if len(found) == call["count"]:
                break
            own = {free.name: float(f"{free.value(rng.uniform()):.4g}") for free in UNSEEN}
            parameters = resized(member, own["joint_pulley_radius"]) | own
            parameters = {name: float(f"{value:.6g}") for name, value in parameters.items()}
            value, trouble = _value(parameters, taken, call["limit"])
            if trouble:
                refused[trouble] += 1
                left.append(member)
            else:
                found.append({"cost": value, "parameters": parameters})
        waiting = left
    return {"devices": found, "tried": len(found) + sum(refused.values()), "refused": refused}


def _value(parameters: Mapping[str, float], readings: Readings, limit: float) -> tuple[float, str]:
    """Return the cost of a device, and why it is not taken in; empty if it is."""
    free = searched(readings.spring_end, loop=False)
    if any(not item.low <= parameters[item.name] <= item.high for item in free):
        return np.inf, "range"
    rows = reproduced(parameters, readings, 1, SIMULATED)
    value = cost([residual(row) for row in rows], [WEIGHTS[row.cell.metric] for row in rows])
    if value > limit:
        return value, "cost"
    profile = load_profile(profile_content("drawn", parameters, readings))
    return value, "" if _playable(profile) else "environment"


def _playable(profile: Profile) -> bool:
    """Return whether the environments can play a device: in every suite, and in the default tension range."""
    numbers = np.arange(BEGUN, dtype=np.uint64)
    keys = episode_keys(numbers, 0 * numbers, "train")
    try:
        Settings.read({"profile": profile})
        for suite in suite_names():
            Simulation(profile, BEGUN).reset(sample_suite(suite, keys, profile))
        findings = diagnose(profile, TENSION_RANGE)
    except AmulettError:
        return False
    return not any(finding.kind in UNUSABLE for finding in findings)


def _judge(call: Mapping[str, Any], readings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rows that a device explains, how it is for a law, and what eq. 6 costs on it in each suite."""
    profile, taken = load_profile(call["profile"]), Readings(**readings)
    rows = reproduced(call["parameters"], taken, duration=SIMULATED)
    measured = {suite: measure(profile, suite) for suite in suite_names()}
    mixed = measured[SUITE]
    [tension], [constant] = (values.tolist() for values in best_constants([profile], SUITE, scenarios=SCENARIOS))
    tables, radius = build_tables(profile.spring), profile.plant.joint_pulley_radius
    stiffness = [2.0 * radius**2 * tables.stiffness_at(tables.deflection_at(force)) for force in STIFFNESS_AT]
    return {
        "explained": sum(row.explained for row in rows),
        "findings": sorted({finding.kind for finding in diagnose(profile, TENSION_RANGE)}),
        "best_constant": tension,
        "best_constant_cost": float(f"{constant:.4g}"),
        "stiffness": [float(f"{value:.4g}") for value in stiffness],
        "eq6_position": None if mixed is None else mixed.mean.position,
        "eq6_effort": None if mixed is None else mixed.mean.effort,
        "eq6": {suite: None if costs is None else compact(costs) for suite, costs in measured.items()},
    }


def _content(
    recipe: Recipe,
    readings: Readings,
    stages: Mapping[str, Any],
    named: Mapping[str, Mapping[str, Any]],
    members: Sequence[Mapping[str, float]],
    command: Sequence[str],
) -> dict[str, Any]:
    starts = {name.removeprefix("start-"): stages[name] for name in _starts(recipe)}
    free = [item for item in searched(readings.spring_end, loop=False) if not item.name.startswith("simulation.")]
    shown = [*free, *UNSEEN]
    values = {item.name: [device["parameters"][item.name] for device in named.values()] for item in shown}
    judged = {name: dict(stages[f"device-{name}"]) for name in named}
    for each in judged.values():
        del each["eq6"]
    return {
        "command": list(command),
        "recipe": asdict(recipe),
        "readings": asdict(readings),
        "loop": _loop_configuration(readings),
        "of": len(TABLES_2_TO_5),
        "least_cost": min(start["cost"] for start in starts.values()),
        "starts": [
            {
                "name": name,
                **{key: start[key] for key in ("cost", "explained", "parameters")},
                "walked": len(stages[f"walk-start-{name}"]),
            }
            for name, start in starts.items()
        ],
        "members": len(members),
        "tried": stages["draws"]["tried"],
        "refused": stages["draws"]["refused"],
        "parameters": [
            {
                "name": item.name,
                "unit": item.unit,
                "kind": "drawn" if item in UNSEEN else "identified",
                "bounds": [item.low, item.high],
                "range": [min(values[item.name]), max(values[item.name])],
                "median": float(np.median(values[item.name])),
                "shipped": _shipped_value(item.name, readings),
                "source": item.source,
            }
            for item in shown
        ],
        "correlations": _rank_correlations(np.array([values[item.name] for item in shown])).round(2).tolist(),
        "devices": [
            {"name": name, "cost": device["cost"], **judged[name], "parameters": device["parameters"]}
            for name, device in named.items()
        ],
    }


def _loop_configuration(readings: Readings) -> dict[str, Any]:
    """Return the choices of the loop under which the devices explain the paper."""
    testbed = load_profile("testbed")
    sensors = testbed.sensors.model_dump(include={"force_filter", "force_floor"})
    return {"sensors": {**sensors, "below_floor": readings.floor}, "loop": testbed.loop.model_dump(exclude={"sources"})}


def _shipped_value(name: str, readings: Readings) -> float | None:
    """Return the value of a parameter of the shipped testbed; None where it has none."""
    values = {entry["name"]: entry["value"] for entry in shipped()["spread"]}
    testbed = load_profile("testbed")
    values |= {
        "joint_pulley_radius": testbed.plant.joint_pulley_radius,
        "mass_arm": testbed.plant.masses[0].arm,
        "encoder_noise": testbed.sensors.encoder_noise_deg,
        "potentiometer_travel": testbed.sensors.potentiometer_travel,
        "command_limit": testbed.drives.command_limit_deg,
    }
    return values.get(name)


def _rank_correlations(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Spearman's correlations of rows of values; 0 where a row is constant."""
    ranks = rankdata(values, axis=1)
    ranks -= ranks.mean(axis=1, keepdims=True)
    norms = np.maximum(np.sqrt((ranks**2).sum(axis=1)), 1e-12)
    return np.asarray(ranks @ ranks.T / np.outer(norms, norms))


def _fleet_text(profiles: Sequence[Mapping[str, Any]], command: Sequence[str]) -> str:
    words = " ".join(command) or "amulett_gym.studies.paper.sample"
    return f"# Plausible devices, see docs/plausible-devices.md. Written by: {words}\n" + to_yaml(profiles, width=120)
