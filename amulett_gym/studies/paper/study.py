"""How the shipped parameters came about: the searches of `identification`, one after the other, and what they give.

Each search is a *stage*. A finished stage is kept in the folder and not done again, so a study that was interrupted
goes on where it was. Stages do not share random numbers: the number of processes changes nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import resources
from multiprocessing import active_children, get_context
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile
from amulett_gym.storage.provenance import write_provenance
from amulett_gym.storage.reading import read_json
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import write_json, write_text
from amulett_gym.studies.paper.identification import (
    CERTAIN,
    EQUAL,
    OUT_OF_REACH,
    PARAMETERS,
    ROBUST,
    SELECTION_KEY,
    SELECTION_REPETITIONS,
    SIMULATED,
    WEIGHTS,
    devices,
    ensemble,
    most_explained,
    pack,
    profile_changes,
    reproduced,
    search,
    unpack,
)
from amulett_gym.studies.paper.reproduction import (
    ALTERNATIVES,
    BOUNDS,
    MEASUREMENT_TIME,
    Readings,
    Row,
    compare,
    measure,
)
from amulett_gym.studies.paper.tables import CONFIGURATIONS, DEVICES, PROTOCOL, TABLES_2_TO_5

SPRING_LAWS = {
    0.0: "linear",
    0.7: "strong pretension",
    0.9: "some pretension",
    0.97: "little pretension",
    1.0: "mounted unstretched",
}
"""Free length of a linear spring over half width -> how the assembly's linear springs are then mounted.

Without a free length the assembly is linear; mounted unstretched its force grows with the cube of a small deflection.
"""

SHIFT = 0.15
"""Standard deviation of the shifted candidates, as a part of the search range."""

STIFFENING = 1.5
"""The chosen set's strings are at least so many times stiffer at 10 N than at 4 N: a device for variable stiffness."""

CHOICES = 400
"""Members of the ensemble, about, among which the chosen set is looked for."""

DETERMINED = 0.2
"""A parameter is determined if the sets as good as the best cover at most this part of its search range, within it."""

AT_BOUND = 0.01
"""Sets that come this near to a bound, as a part of the search range, may go on beyond it."""

STUDY_MARKS = ("recipe.json",)
"""The file by which a study's folder is recognised."""

_ROWS = len(TABLES_2_TO_5)


@dataclass(frozen=True)
class Recipe:
    """What is searched, and for how long; the defaults gave the shipped parameters.

    Attributes
    ----------
    seeds : tuple of int
        Of the independent starts.
    population, generations : int
        Of each start, and of each search that leaves out a configuration.
    refinement : int
        Generations of the search that goes on from all starts, and of those for each spring law and reading.
    steps : int
        Moves of each walker of the ensemble, of which there is one for each seed.
    """

    seeds: tuple[int, ...] = (1, 2, 3)
    population: int = 150
    generations: int = 160
    refinement: int = 45
    steps: int = 150


Report = Callable[[str, Mapping[str, Any]], None]


def study(
    folder: str | Path,
    recipe: Recipe,
    readings: Readings,
    processes: int = 2,
    report: Report = lambda name, stage: None,
    overwrite: bool = False,
    command: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Identify the parameters and write what was found.

    Parameters
    ----------
    folder : str or Path
        For ``recipe.json``, ``command.json``, ``stages/*.json``, ``identification.json`` and a profile for each device.
    recipe : Recipe
    readings : Readings
    processes : int
        Searches that run at once.
    report : callable
        Called with a stage's name and result when it is there; `stage_count` tells how many will come.
    overwrite : bool
        Whether a study of another recipe in the folder may be replaced.
    command : sequence of str, optional
        The words of the command, for ``command.json``.

    Returns
    -------
    dict
        The content of ``identification.json``.

    Raises
    ------
    AmulettError
        If a file cannot be read or written, or the folder holds a study of another recipe that may not be replaced.
    """
    folder = Path(folder)
    if not overwrite:
        _refuse_other_recipe(folder / "recipe.json", recipe)
    write_json(folder / "recipe.json", asdict(recipe))
    write_provenance(folder, "identify", asdict(recipe), recipe.seeds, command)
    size = {"population": recipe.population, "generations": recipe.generations}
    stages: dict[str, Any] = {}

    def run(calls: Mapping[str, Mapping[str, Any]]) -> None:
        for name, result in _run_stages(folder / "stages", calls, readings, processes):
            stages[name] = result
            report(name, result)

    run(
        {f"start-{seed}": {"seed": seed, **size} for seed in recipe.seeds}
        | {f"without-{name}": {"seed": recipe.seeds[0], **size, "without": name} for name in CONFIGURATIONS}
    )
    starts = [stages[f"start-{seed}"] for seed in recipe.seeds]
    begin = _mixed([start["population"] for start in starts], recipe.population, recipe.seeds[0])
    again = {"seed": recipe.seeds[0], "generations": recipe.refinement, "population": begin}
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
    changes = profile_changes({name: entry["value"] for name, entry in spread.items()})[device]

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
    groups = {group: {**values, "sources": sources[group]} for group, values in changes.items()}
    profile = {
        "name": f"{device}-identified",
        "base": device,
        "description": f"What `amulett identify` found for the {device}.",
        **groups,
    }
    head = "# Written by `amulett identify`. In parentheses: the range of the sets that explain the tables as well.\n"
    return head + to_yaml(profile, width=120)


def _run_stages(
    folder: Path, calls: Mapping[str, Mapping[str, Any]], readings: Readings, processes: int
) -> Iterable[tuple[str, Any]]:
    """Yield each stage's name and result: at once those that are in the folder, then the others as they get done."""
    inputs = {name: _inputs(call, readings) for name, call in calls.items()}
    missing = []
    for name in calls:
        done = _read_stage(folder / f"{name}.json", inputs[name])
        if done is None:
            missing.append(name)
        else:
            yield name, done
    if not missing:
        return
    workers = min(processes, len(missing))
    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_end_with, initargs=(os.getpid(),)) as pool:
        with _ctrl_c_later():  # the workers inherit that: theirs to end is the parent
            futures = {pool.submit(_do_stage, calls[name], asdict(readings)): name for name in missing}
        try:
            for future in as_completed(futures):
                name = futures[future]
                result = future.result()
                write_json(folder / f"{name}.json", {"inputs": inputs[name], "result": result})
                yield name, result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():  # or they would finish their searches first
                worker.terminate()
            raise


@contextmanager
def _ctrl_c_later() -> Iterator[None]:
    """Let a Ctrl-C wait until the end of the block; processes that start in it never see one."""
    if not hasattr(signal, "pthread_sigmask"):  # not everywhere
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with(parent: int) -> None:
    """Let a worker end when its parent does: one that was killed cannot tell it to."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _do_stage(call: Mapping[str, Any], readings: Mapping[str, Any]) -> Any:
    taken = Readings(**{**readings, **call.get("reading", {})})
    if "members" in call:
        explained, cost, parameters = most_explained(taken, call["members"])
        return {"cost": cost, "explained": explained, "parameters": parameters}
    if "candidates" in call:
        places = np.array(call["candidates"])
        sizes = {key: call[key] for key in ("limit", "walkers", "steps")}
        return ensemble(call["seed"], taken, places, **sizes)
    population = call["population"] if isinstance(call["population"], int) else np.array(call["population"])
    found = search(
        call["seed"],
        taken,
        generations=call["generations"],
        population=population,
        without=call.get("without"),
        fixed=call.get("fixed"),
    )
    rows = reproduced(found.parameters, taken, PROTOCOL.repetitions_testbed)
    return {
        "cost": found.cost,
        "explained": sum(row.explained for row in rows),
        "parameters": found.parameters,
        "population": found.population.tolist(),
    }


def _inputs(call: Mapping[str, Any], readings: Readings) -> dict[str, Any]:
    """Return everything a stage's result hangs on, what is long as its hash."""
    middle = devices(unpack(np.full(len(PARAMETERS), 0.5)))
    long = {
        "call": call,
        "devices": {name: _bare(profile.model_dump()) for name, profile in middle.items()},
        "parameters": [asdict(free) for free in PARAMETERS],
        "cost": [sorted((*key, *bound) for key, bound in BOUNDS.items()), WEIGHTS, ROBUST, OUT_OF_REACH],
        "paper": [asdict(PROTOCOL), [asdict(cell) for cell in TABLES_2_TO_5]],
        "measured": [SIMULATED, MEASUREMENT_TIME],
        "version": __version__,
    }
    digest = hashlib.sha256(json.dumps(long, sort_keys=True).encode()).hexdigest()
    short = {key: value for key, value in call.items() if key not in ("candidates", "members", "population")}
    return {**short, "readings": asdict(readings), "sha256": digest}


def _read_stage(path: Path, inputs: Mapping[str, Any]) -> Any:
    """Return a finished stage's result, None if it is not there or was asked for otherwise."""
    if not path.exists():
        return None
    try:
        content = read_json(path, "stage", limit=40_000_000)
    except AmulettError as error:
        raise AmulettError(f"{error}; delete it to do it again") from error
    of_these = isinstance(content, dict) and content.get("inputs") == json.loads(json.dumps(inputs))
    return content.get("result") if of_these else None


def _refuse_other_recipe(path: Path, recipe: Recipe) -> None:
    if not path.exists():
        return
    other = read_json(path, "recipe")
    asked = json.loads(json.dumps(asdict(recipe)))
    if other != asked:
        names = [name for name in asked if not isinstance(other, dict) or other.get(name) != asked[name]]
        differ = ", ".join(f"{name} {other.get(name) if isinstance(other, dict) else None}" for name in names)
        raise AmulettError(
            f"'{path.parent}' holds a study with {differ}, not {', '.join(str(asked[name]) for name in names)}; "
            "choose another folder, or replace it with --overwrite"
        )


def _fits(recipe: Recipe) -> list[str]:
    """Return the stages that fit all rows under the readings taken."""
    return [*(f"start-{seed}" for seed in recipe.seeds), "together", *(f"spring-{ratio}" for ratio in SPRING_LAWS)]


def _mixed(populations: list[list[list[float]]], count: int, seed: int) -> list[list[float]]:
    """Return candidates to begin with: half of them from the starts' last generations, half of them shifted ones.

    The generations have contracted to where each start ended; what follows has to be able to leave that.
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
    return {
        "recipe": asdict(recipe),
        "readings": asdict(readings),
        "cost": chosen["cost"],
        "explained": sum(
            row.explained for row in reproduced(chosen["parameters"], readings, PROTOCOL.repetitions_testbed)
        ),
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
            for free in PARAMETERS
        ],
        "ensemble": {"members": len(members), "least_cost": least, "equal_cost": EQUAL},
        "starts": [
            {"seed": seed, **{key: stages[f"start-{seed}"][key] for key in ("cost", "explained", "parameters")}}
            for seed in recipe.seeds
        ],
        "springs": [
            {
                "law": law,
                "length_ratio": ratio,
                "cost": stages[f"spring-{ratio}"]["cost"],
                "met": stages[f"spring-{ratio}"]["explained"],
                "of": _ROWS,
                "stiffening": stiffening(devices(stages[f"spring-{ratio}"]["parameters"])["testbed"]),
                "parameters": stages[f"spring-{ratio}"]["parameters"],
            }
            for ratio, law in SPRING_LAWS.items()
        ],
        "readings_refitted": [
            {
                "reading": name,
                "choice": choice,
                **{key: stages[f"reading-{name}-{choice}"][key] for key in ("cost", "explained", "parameters")},
            }
            for name, choice in ALTERNATIVES
        ],
        "without": {name: stages[f"without-{name}"]["parameters"] for name in CONFIGURATIONS},
    }


def progressive(members: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Return the sets whose strings are `STIFFENING` times stiffer at 10 N than at 4 N; all, if none is."""
    found = [member for member in members if stiffening(devices(member)["testbed"]) >= STIFFENING]
    return found or list(members)


def spread(members: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, float, bool]]:
    """Return what the tables say about each parameter, by its name.

    Parameters
    ----------
    members : sequence of mapping
        Parameter sets that are as good as the best.

    Returns
    -------
    dict of str to tuple
        Smallest and largest value, three digits, and whether that determines it: the values cover at most
        `DETERMINED` of the search range, and none is at a bound, beyond which they might go on.
    """
    places = np.array([pack(member) for member in members])
    begin, end = places.min(axis=0), places.max(axis=0)
    low, high = unpack(begin), unpack(end)
    determined = (end - begin <= DETERMINED) & (begin > AT_BOUND) & (end < 1.0 - AT_BOUND)
    return {
        free.name: (float(f"{low[free.name]:.3g}"), float(f"{high[free.name]:.3g}"), bool(known))
        for free, known in zip(PARAMETERS, determined, strict=True)
    }


def stiffening(profile: Profile) -> float:
    """Return how many times stiffer a string is at 10 N than at 4 N: what a change of tension can do."""
    tables = build_tables(profile.spring)
    return tables.stiffness_at(tables.deflection_at(10.0)) / tables.stiffness_at(tables.deflection_at(4.0))


def same_device(profile: Profile, other: Profile) -> bool:
    """Say whether two profiles describe the same device, whatever their names and sources."""
    return bool(_bare(profile.model_dump()) == _bare(other.model_dump()))


def _bare(value: Any) -> Any:
    """Return a profile's content without what only explains it."""
    if isinstance(value, dict):
        words = ("name", "base", "description", "sources")
        return {key: _bare(item) for key, item in value.items() if key not in words}
    return value


def in_words(content: Mapping[str, Any]) -> str:
    """Return a study for the terminal: the parameters and their spread, the spring laws, and the starts."""
    lines = [
        f"Least cost: {content['ensemble']['least_cost']:.3f}. Sets within {content['ensemble']['equal_cost']:g} of "
        f"it count as equally good; a walk found {content['ensemble']['members']} of them.",
        f"Chosen among about {CHOICES} of them, whose strings are at least {STIFFENING:g} times stiffer at 10 N than "
        f"at 4 N if any are: the one that explains most rows, by noise that is not "
        f"reported. In the report it explains {content['explained']} of {content['of']}, at a cost of "
        f"{content['cost']:.3f}.",
        f"{'':28}{'value':>11}  {'as good':>21}  {'searched':>19}",
    ]
    for entry in content["spread"]:
        good = f"{entry['low']:.3g} to {entry['high']:.3g}"
        searched = f"{entry['bounds'][0]:g} to {entry['bounds'][1]:g}"
        note = "" if entry["determined"] else "  not determined"
        unit = f"  {entry['unit']}" if entry["unit"] else ""
        lines.append(f"  {entry['name']:26}{entry['value']:>11.4g}  {good:>21}  {searched:>19}{unit}{note}")
    lines.append("Spring laws, all other parameters searched again:")
    for spring in content["springs"]:
        lines.append(
            f"  {spring['law']:22} free length {spring['length_ratio']:g} of half width: cost {spring['cost']:.3f}, "
            f"{spring['met']} rows, {spring['stiffening']:.2f} times stiffer at 10 N than at 4 N"
        )
    lines.append("Readings, each alone, all parameters searched again:")
    for reading in content["readings_refitted"]:
        name = f"{reading['reading']} {reading['choice']}"
        lines.append(f"  {name:28} cost {reading['cost']:7.3f}, {reading['explained']} rows")
    starts = ", ".join(f"{start['cost']:.3f} (seed {start['seed']})" for start in content["starts"])
    lines.append(f"Cost of the starts: {starts}")
    return "\n".join(lines)


def spring_laws(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return the rows of Tables 2-5 that the best fit with each spring law gives, by the law's name.

    Parameters
    ----------
    content : mapping
        From `study` or `shipped`.
    readings : Readings

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    return {
        spring["law"]: compare(measure(devices(spring["parameters"]), readings), readings)
        for spring in content["springs"]
    }


def cross_check(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return what the fits to three configurations predict for the fourth, by the configuration that was left out.

    Parameters
    ----------
    content : mapping
        From `study` or `shipped`.
    readings : Readings

    Raises
    ------
    AmulettError
        If a device cannot hold a posture at which a configuration starts.
    """
    predicted = {}
    for left_out, parameters in content["without"].items():
        rows = compare(measure(devices(parameters), readings), readings)
        predicted[left_out] = tuple(row for row in rows if row.cell.configuration == left_out)
    return predicted
