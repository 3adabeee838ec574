"""Identification of the parameters that reproduce Tables 2-5 on both devices; its result is shipped.

One set of mechanics holds for both devices. Each search is a *stage* (`stages`) with its own random numbers, so that an
interrupted study can be resumed, and the number of workers changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.identification.ensemble import spread
from amulett_gym.identification.parameters import CERTAIN, OWN, devices, profile_changes, searched
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile
from amulett_gym.storage.reading import read_json
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import write_json, write_text
from amulett_gym.studies.paper.objective import SELECTION_KEY, SELECTION_REPETITIONS, SIMULATED, reproduced
from amulett_gym.studies.paper.reproduction import ALTERNATIVES, Readings, Row
from amulett_gym.studies.paper.stages import Report, begin_stages
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, TABLES_2_TO_5
from amulett_gym.workers.call import ALONE, Workers

EQUAL = 2.5
"""Sets whose cost exceeds the least one by at most this count as equally good: independent starts differ as much."""

SPRING_LAWS = {
    0.0: "linear",
    0.7: "strong pretension",
    0.9: "some pretension",
    0.97: "little pretension",
    1.0: "mounted unstretched",
}
"""Free length of a linear spring over half width -> mounting of the assembly's linear springs.

Without a free length the assembly is linear; mounted unstretched its force grows with the cube of a small deflection.
"""

SHIFT = 0.15
"""Standard deviation of the shifted candidates, as a part of the search range."""

STIFFENING = 1.5
"""Least ratio of the strings' stiffness at 10 N to that at 4 N of the chosen set: a device for variable stiffness."""

CHOICES = 400
"""Approximate number of members of the ensemble from which the set is chosen."""

STUDY_MARKS = ("recipe.json",)
"""The file by which a study's folder is recognised."""

_ROWS = len(TABLES_2_TO_5)


@dataclass(frozen=True)
class Recipe:
    """Size of the searches; the defaults gave the shipped parameters."""

    seeds: tuple[int, ...] = (1, 2, 3)  # of the independent starts
    population: int = 150  # of each start, and of each search that leaves out a configuration
    generations: int = 160  # of the same
    refinement: int = 45  # generations of the search from all starts, and of those for each spring law and reading
    steps: int = 150  # moves of each walker of the ensemble; one ensemble for each seed


def study(
    folder: str | Path,
    recipe: Recipe,
    readings: Readings,
    workers: Workers = ALONE,
    report: Report = lambda name, stage: None,
    overwrite: bool = False,
    command: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Identify the parameters, write the result, and return it as the content of ``identification.json``.

    Parameters
    ----------
    folder : str or Path
        For ``recipe.json``, ``command.json``, ``stages/*.json``, ``identification.json`` and a profile for each device.
    report : callable
        Called with the name and the result of each of the `stage_count` stages, when it is there.
    overwrite : bool
        Whether a study of another recipe in the folder may be replaced.
    command : sequence of str, optional
        The words of the command, for ``command.json``.

    Raises
    ------
    AmulettError
        If a file cannot be read or written, or the folder holds a study of another recipe that may not be replaced.
    """
    folder = Path(folder)
    stages, run = begin_stages(folder, STUDY_MARKS[0], recipe, readings, workers, report, overwrite, command)
    size = {"population": recipe.population, "generations": recipe.generations}
    run(
        {f"start-{seed}": {"seed": seed, **size} for seed in recipe.seeds}
        | {f"without-{name}": {"seed": recipe.seeds[0], **size, "without": name} for name in CONFIGURATIONS}
    )
    starts = [stages[f"start-{seed}"] for seed in recipe.seeds]
    mixed = _mixed([start["population"] for start in starts], recipe.population, recipe.seeds[0])
    again = {"seed": recipe.seeds[0], "generations": recipe.refinement, "population": mixed}
    run(
        {"together": again}
        | {f"spring-{ratio}": {**again, "fixed": {"length_ratio": ratio}} for ratio in SPRING_LAWS}
        | {f"reading-{name}-{choice}": {**again, "reading": {name: choice}} for name, choice in ALTERNATIVES}
    )
    fits = [stages[name] for name in _fits(recipe)]
    limit = min(fit["cost"] for fit in fits) + EQUAL
    candidates = [vector for fit in fits for vector in fit["population"]]
    walk = {"candidates": candidates, "limit": limit, "walkers": recipe.population, "steps": recipe.steps}
    run({f"ensemble-{seed}": {"seed": seed, **walk} for seed in recipe.seeds})
    walked = [member for seed in recipe.seeds for member in stages[f"ensemble-{seed}"]]
    members = walked[:: max(len(walked) // CHOICES, 1)]
    members += [fit["parameters"] for fit in fits if fit["cost"] <= limit]
    members = [{name: float(f"{value:.6g}") for name, value in member.items()} for member in members]
    run({"chosen": {"members": progressive(members), "noise": [SELECTION_KEY, SELECTION_REPETITIONS]}})
    content = _content(recipe, readings, stages)
    for name in DEVICES:
        write_text(folder / f"{name}.yaml", profile_text(name, content))
    write_json(folder / "identification.json", content)
    return content


def stage_count(recipe: Recipe) -> int:
    """Return the number of a study's stages."""
    return len(_fits(recipe)) + len(CONFIGURATIONS) + len(ALTERNATIVES) + len(recipe.seeds) + len(("chosen",))


def shipped() -> dict[str, Any]:
    """Return the study behind the shipped profiles, as `study` returned it."""
    with resources.as_file(resources.files("amulett_gym") / "studies" / "paper" / "identification.json") as path:
        content: dict[str, Any] = read_json(path, "identification")
    return content


def profile_text(device: str, content: Mapping[str, Any]) -> str:
    """Return a profile of one device with the identified values, each with its source, as YAML."""
    spread = {entry["name"]: entry for entry in content["spread"]}
    spring_end = content["readings"]["spring_end"]
    changes = profile_changes({name: entry["value"] for name, entry in spread.items()}, spring_end)[device]

    def source(name: str) -> str:
        entry = spread[name]
        value = f"{entry['value']:.4g} {entry['unit']}".rstrip()
        known = "" if entry["determined"] else ", not determined"
        return f"identified: {name.split('.')[-1]} {value} ({entry['low']:.3g} to {entry['high']:.3g}{known})"

    sources: dict[str, dict[str, str]] = {
        "plant": {
            "masses": source("inertia"),
            "drive_pulley_radius": source("radius_ratio"),
            "joint_pulley_radius": "assumed: no table sees it; the other lengths and the inertia go with it",
        },
        "spring": {
            "stiffness": source("max_force"),
            "half_width": source("width_ratio"),
            "free_length": source("length_ratio"),
            "max_deflection": source("max_deflection"),
        },
        "sensors": {"force_filter": source(f"{device}.force_filter")},
        "loop": {
            key: source(f"{device}.{search}") + "; gains: Table 1"
            for key, search in (
                ("position", "position_filter"),
                ("position_only", "position_filter"),
                ("tension", "tension_filter"),
            )
        },
    }
    if device == "testbed":
        sources["sensors"]["potentiometer_noise"] = source("testbed.slider_noise")
        sources["loop"] |= {
            "control_period": source("testbed.control_period"),
            "switch_filter": "assumed: as the measured velocity's; no table sees it",
            "switch_hysteresis": f"assumed: {CERTAIN:g} standard deviations of the difference's noise",
            "tie_width": "assumed: one standard deviation of the difference's noise",
        }
        sources["drives"] = {"lag": source("testbed.lag"), "rate_limit_deg": source("testbed.rate_limit")}
    if spring_end != "held":
        assumed = f"assumed: the reading {spring_end} of what ends the spring's curve"
        sources["spring"]["beyond"] = assumed
        sources["drives"] = sources.get("drives", {}) | {"stall_torque": assumed}
        if spring_end in OWN:
            group, name = {"hard-stop": ("spring", "stop_stiffness")}.get(spring_end, ("drives", "stall_torque"))
            sources[group][name] = source(name)
    groups = {group: {**values, "sources": sources[group]} for group, values in changes.items()}
    profile = {
        "name": f"{device}-identified",
        "base": device,
        "description": f"What `amulett identify` found for the {device}.",
        **groups,
    }
    head = "# Written by `amulett identify`. In parentheses: the range of the sets that explain the tables as well.\n"
    return head + to_yaml(profile, width=120)


def _fits(recipe: Recipe) -> list[str]:
    """Return the stages that fit all rows under the readings taken."""
    return [*(f"start-{seed}" for seed in recipe.seeds), "together", *(f"spring-{ratio}" for ratio in SPRING_LAWS)]


def _mixed(populations: list[list[list[float]]], count: int, seed: int) -> list[list[float]]:
    """Return initial candidates: half from the starts' last generations, half shifted by chance.

    Those generations have contracted around each start's optimum; the shifts let the next search leave it.
    """
    rng = np.random.default_rng(seed)
    pool = np.concatenate([np.array(population) for population in populations])
    chosen = pool[rng.integers(len(pool), size=count)]
    chosen[count // 2 :] += rng.normal(0.0, SHIFT, size=chosen[count // 2 :].shape)
    mixed: list[list[float]] = np.clip(chosen, 0.0, 1.0).tolist()
    return mixed


def _content(recipe: Recipe, readings: Readings, stages: Mapping[str, Any]) -> dict[str, Any]:
    chosen = stages["chosen"]
    least = min(stages[name]["cost"] for name in _fits(recipe))
    members = [member for seed in recipe.seeds for member in stages[f"ensemble-{seed}"]]
    members += [stages[name]["parameters"] for name in _fits(recipe) if stages[name]["cost"] <= least + EQUAL]
    found = spread(members)

    def numbers(stage: str) -> dict[str, Any]:
        return {key: stages[stage][key] for key in ("cost", "explained", "parameters")}

    return {
        "recipe": asdict(recipe),
        "readings": asdict(readings),
        "cost": chosen["cost"],
        "explained": sum(row.explained for row in reproduced(chosen["parameters"], readings, duration=SIMULATED)),
        "of": _ROWS,
        "selection": {"explained": chosen["explained"], "repetitions": SELECTION_REPETITIONS},
        "spread": [
            {
                "name": free.name,
                "unit": free.unit,
                "value": chosen["parameters"][free.name],
                "low": found[free.name][0],
                "high": found[free.name][1],
                "bounds": [free.low, free.high],
                "determined": found[free.name][2],
                "source": free.source,
            }
            for free in searched(readings.spring_end)
        ],
        "ensemble": {"members": len(members), "least_cost": least, "equal_cost": EQUAL},
        "starts": [{"seed": seed, **numbers(f"start-{seed}")} for seed in recipe.seeds],
        "springs": [
            {
                "law": law,
                "length_ratio": ratio,
                "cost": fit["cost"],
                "met": fit["explained"],
                "of": _ROWS,
                "stiffening": stiffening(devices(fit["parameters"])["testbed"]),
                "parameters": fit["parameters"],
            }
            for ratio, law in SPRING_LAWS.items()
            for fit in [stages[f"spring-{ratio}"]]
        ],
        "readings_refitted": [
            {"reading": name, "choice": choice, **numbers(f"reading-{name}-{choice}")} for name, choice in ALTERNATIVES
        ],
        "without": {name: stages[f"without-{name}"]["parameters"] for name in CONFIGURATIONS},
    }


def progressive(members: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Return the sets whose strings are `STIFFENING` times stiffer at 10 N than at 4 N; all, if none is."""
    found = [member for member in members if stiffening(devices(member)["testbed"]) >= STIFFENING]
    return found or list(members)


def stiffening(profile: Profile) -> float:
    """Return the ratio of a string's stiffness at 10 N to that at 4 N: the effect of a change of tension."""
    tables = build_tables(profile.spring)
    return tables.stiffness_at(tables.deflection_at(10.0)) / tables.stiffness_at(tables.deflection_at(4.0))


def spring_laws(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return the rows of Tables 2-5 for the best fit with each spring law, by the law's name."""
    return {spring["law"]: reproduced(spring["parameters"], readings) for spring in content["springs"]}


def cross_check(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return the rows of each configuration as predicted by the fit to the other three."""
    return {
        left_out: tuple(row for row in reproduced(fitted, readings) if row.cell.configuration == left_out)
        for left_out, fitted in content["without"].items()
    }
