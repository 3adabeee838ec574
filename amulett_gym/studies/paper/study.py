"""Identification of the parameters that reproduce Tables 2-5 on both devices; its result is shipped.

One set of mechanics holds for both devices. The rows of a parameter set become residuals in units of each row's bound,
and these a cost that rows out of reach cannot dominate. Each search is a *stage*. A finished stage is kept in the
folder, so that an interrupted study can be resumed. Stages do not share random numbers: the number of processes changes
nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.processes import in_processes
from amulett_gym.identification.ensemble import DETERMINED, ensemble, spread
from amulett_gym.identification.parameters import (
    CERTAIN,
    OWN,
    PARAMETERS,
    Values,
    allowed,
    bare,
    devices,
    pack,
    profile_changes,
    same_device,
    searched,
    unpack,
)
from amulett_gym.identification.search import Cost, search
from amulett_gym.model.spring import build_tables
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.table import Table
from amulett_gym.storage.kept import digest, read_kept, write_kept
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json, read_text
from amulett_gym.storage.safe_yaml import to_yaml
from amulett_gym.storage.writing import write_json, write_text
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

SIMULATED = {"simulation": 2.0, "testbed": MEASUREMENT_TIME}
"""T in the search [s]: the simulation is at rest after a second."""

WEIGHTS = {"rise_time": 1.0, "position_ise": 2.0, "tension_ise": 1.0, "isav": 0.5}
"""Weight of a row in the cost. Position ISE depends on no margin, estimate or unit; the unit of ISAV is not printed."""

SELECTION_KEY, SELECTION_REPETITIONS = 1001, 40
"""First key and number of the noise by which a set is chosen; no reported number uses it."""

OUT_OF_REACH = 60.0
"""Residual of a row that does not exist, because the device failed."""

ROBUST = 0.1
"""Weight of the part of the cost that grows without bound, so that it has a slope for rows far off."""

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


def reproduced(
    parameters: Mapping[str, float],
    readings: Readings,
    repetitions: int = PROTOCOL.repetitions_testbed,
    duration: Mapping[str, float] | None = None,
    first_key: int = 1,
) -> tuple[Row, ...]:
    """Return the rows of Tables 2-5 for a set of parameters (see `reproduction.measure`).

    Raises AmulettError if a device cannot hold a posture at which a configuration starts.
    """
    found = devices(parameters, readings.spring_end)
    return compare(measure(found, readings, repetitions, duration, first_key), readings)


def residual(row: Row) -> float:
    """Return log(ours / paper) in units of the row's bound: up to 1 it is explained."""
    bound = math.log(BOUNDS[row.cell.metric, row.cell.profile][1])
    if row.failed:
        return OUT_OF_REACH
    ours = SIMULATED[row.cell.profile] if row.ours is None else max(row.ours, 1e-6)
    return float(np.clip(math.log(ours / row.cell.value) / bound, -OUT_OF_REACH, OUT_OF_REACH))


def cost(residuals: Sequence[float], weights: Sequence[float] | None = None) -> float:
    """Return a smooth, weighted count of the rows that are out of their bounds."""
    squares = np.square(residuals)
    costs = np.log1p(squares**2) + ROBUST * np.log1p(squares)
    return float(np.dot(costs, np.ones_like(squares) if weights is None else weights))


def objective(readings: Readings, without: str | None = None, loop: bool = True) -> Cost:
    """Return the cost as a function of the search vector.

    `without` leaves out one configuration, on both devices; without `loop` the testbed's loop is that of its profile.
    """
    free = searched(readings.spring_end, loop)

    def value(vector: Values) -> float:
        worst = cost([OUT_OF_REACH] * len(TABLES_2_TO_5))
        if not allowed(vector, free):
            return worst
        try:
            rows = reproduced(unpack(vector, free), readings, 1, SIMULATED)
        except AmulettError:  # springs too weak for a starting posture
            return worst
        seen = [row for row in rows if row.cell.configuration != without]
        return cost([residual(row) for row in seen], [WEIGHTS[row.cell.metric] for row in seen])

    return value


def most_explained(readings: Readings, members: Sequence[Mapping[str, float]]) -> tuple[int, float, dict[str, float]]:
    """Return the number of rows explained, the cost, and the parameters of the set that explains most rows.

    Among several it is the one of least cost. The rows are means over more repetitions than the reported ones, and over
    other ones, so that the choice does not bias the report.
    """
    value = objective(readings)
    ranked = []
    for member in members:
        rows = reproduced(member, readings, SELECTION_REPETITIONS, first_key=SELECTION_KEY)
        ranked.append((-sum(row.explained for row in rows), value(pack(member)), dict(member)))
    count, least, parameters = min(ranked, key=lambda entry: entry[:2])
    return -count, least, parameters


@dataclass(frozen=True)
class Recipe:
    """Size of the searches; the defaults gave the shipped parameters."""

    seeds: tuple[int, ...] = (1, 2, 3)  # of the independent starts
    population: int = 150  # of each start, and of each search that leaves out a configuration
    generations: int = 160  # of the same
    refinement: int = 45  # generations of the search from all starts, and of those for each spring law and reading
    steps: int = 150  # moves of each walker of the ensemble; one ensemble for each seed


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
    if not overwrite:
        refuse_other_recipe(folder / "recipe.json", recipe)
    write_json(folder / "recipe.json", asdict(recipe))
    write_provenance(folder, "identify", asdict(recipe), recipe.seeds, command)
    size = {"population": recipe.population, "generations": recipe.generations}
    stages: dict[str, Any] = {}

    def run(calls: Mapping[str, Mapping[str, Any]]) -> None:
        for name, result in run_stages(folder / "stages", calls, readings, processes):
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


def run_stages(
    folder: Path,
    calls: Mapping[str, Mapping[str, Any]],
    readings: Readings,
    processes: int,
    work: Callable[[Mapping[str, Any], Mapping[str, Any]], Any] | None = None,
) -> Iterable[tuple[str, Any]]:
    """Yield each stage's name and result: first those kept in the folder, then the others as they finish.

    Parameters
    ----------
    folder : Path
        Each result is kept in it, with the digest of its call.
    calls : mapping
        Name -> plain data that says what to do.
    readings : Readings
    processes : int
        Most processes at a time.
    work : callable, optional
        A function of a module: call, readings as a mapping -> plain data. By default a search or a walk.
    """
    inputs = {name: _inputs(call, readings) for name, call in calls.items()}
    missing = []
    for name in calls:
        done = read_kept(folder / f"{name}.json", inputs[name])
        if done is None:
            missing.append(name)
        else:
            yield name, done
    arguments = {name: (calls[name], asdict(readings)) for name in missing}
    for name, result in in_processes(work or _do_stage, arguments, processes):
        write_kept(folder / f"{name}.json", inputs[name], result)
        yield name, result


def _do_stage(call: Mapping[str, Any], readings: Mapping[str, Any]) -> Any:
    taken = Readings(**{**readings, **call.get("reading", {})})
    if "members" in call:
        count, least, parameters = most_explained(taken, call["members"])
        return {"cost": least, "explained": count, "parameters": parameters}
    loop = call.get("loop", True)
    value, free = objective(taken, call.get("without"), loop), searched(taken.spring_end, loop)
    if "candidates" in call:
        sizes = {key: call[key] for key in ("limit", "walkers", "steps", "last") if key in call}
        return ensemble(value, call["seed"], np.array(call["candidates"]), **sizes, parameters=free)
    population = call["population"] if isinstance(call["population"], int) else np.array(call["population"])
    if not isinstance(population, int) and population.shape[1] != len(free):
        population = _with_own(population, len(free), call["seed"])
    found = search(
        value,
        call["seed"],
        generations=call["generations"],
        population=population,
        fixed=call.get("fixed"),
        parameters=free,
    )
    return {
        "cost": found.cost,
        "explained": sum(row.explained for row in reproduced(found.parameters, taken, duration=SIMULATED)),
        "parameters": found.parameters,
        "population": found.population.tolist(),
    }


def _with_own(population: Values, size: int, seed: int) -> Values:
    """Return candidates for another end of the spring's curve: without its predecessor's parameter, with its own."""
    shared = population[:, : min(len(PARAMETERS), size)]
    own = np.random.default_rng(seed).uniform(size=(len(shared), size - shared.shape[1]))
    return np.concatenate([shared, own], axis=1)


def _inputs(call: Mapping[str, Any], readings: Readings) -> str:
    """Return the digest of everything that a stage's result depends on."""
    free = searched(loop=call.get("loop", True))
    middle = devices(unpack(np.full(len(free), 0.5), free))
    return digest(
        {
            "call": call,
            "readings": asdict(readings),
            "devices": {name: bare(profile.model_dump()) for name, profile in middle.items()},
            "parameters": [asdict(free) for free in (*PARAMETERS, *OWN.values())],
            "cost": [sorted((*key, *bound) for key, bound in BOUNDS.items()), WEIGHTS, ROBUST, OUT_OF_REACH],
            "paper": [asdict(PROTOCOL), [asdict(cell) for cell in TABLES_2_TO_5]],
            "measured": [SIMULATED, MEASUREMENT_TIME],
            "version": __version__,
        }
    )


def refuse_other_recipe(path: Path, recipe: Any) -> None:
    """Raise an AmulettError if the file `path` holds another recipe, a dataclass, than this one."""
    if path.exists():
        found, asked = read_json(path, "recipe"), json.loads(json.dumps(asdict(recipe)))
        if other := differences(asked, found, "" if isinstance(found, dict) else "the recipe"):
            raise AmulettError(
                f"'{path.parent}' holds a study of another recipe ({', '.join(other)}); choose another folder, or "
                "replace it with --overwrite"
            )


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


def spread_table(content: Mapping[str, Any]) -> Table:
    """Return the identified parameters, and which of them the tables determine."""
    weight = PROTOCOL.damping_mass * PROTOCOL.damping_arm**2
    return Table(
        "What the tables determine",
        (
            "parameter",
            "value",
            "unit",
            "equally good range",
            "searched range",
            "determined",
            "source of the search range",
        ),
        [
            [
                *(f"`{item['name']}`", f"{item['value']:.4g}", item["unit"], f"{item['low']:g} to {item['high']:g}"),
                *("{:g} to {:g}".format(*item["bounds"]), "yes" if item["determined"] else "no", item["source"]),
            ]
            for item in content["spread"]
        ],
        "`radius_ratio`: radius of the drives' pulleys over that of the joint's pulley. `max_force`: string force at "
        "which the springs saturate, at the string deflection `max_deflection`. Half-width: distance of a spring's "
        "anchor from the string's axis. `width_ratio`: half-width over `max_deflection`. `length_ratio`: free length "
        "of a spring over the half-width. "
        f"Equally good: parameter sets whose cost is within {content['ensemble']['equal_cost']:g} of the lowest one. "
        f"A parameter is determined if the equally good sets cover at most {100.0 * DETERMINED:g} % of its searched "
        "range and do not reach its ends. Shares are measured on a logarithmic scale, except for `length_ratio`. The "
        "control period has five possible values; it is determined if the equally good sets use one value or two "
        "neighbouring ones. For comparison with the inertia: the weight of the damping experiment "
        f"alone, {1000.0 * PROTOCOL.damping_mass:g} g at {1000.0 * PROTOCOL.damping_arm:g} mm, has a moment "
        f"of inertia of {weight:.2g} kg m2.",
        left=(0, 2, 6),
    )


def in_words(content: Mapping[str, Any]) -> str:
    """Return a study for the terminal: the parameters and their spread, the spring laws, and the starts."""
    head = (
        f"Least cost: {content['ensemble']['least_cost']:.3f}. Sets within {content['ensemble']['equal_cost']:g} of "
        f"it count as equally good; a walk found {content['ensemble']['members']} of them.\n"
        f"Chosen among about {CHOICES} of them, whose strings are at least {STIFFENING:g} times stiffer at 10 N than "
        "at 4 N if any are: the one that explains most rows, by noise that is not reported. In the report it explains "
        f"{content['explained']} of {content['of']}, at a cost of {content['cost']:.3f}.\n"
    )
    starts = ", ".join(f"{start['cost']:.3f} (seed {start['seed']})" for start in content["starts"])
    parameters = spread_table(content)
    parameters = replace(parameters, head=parameters.head[:-1], rows=[row[:-1] for row in parameters.rows])
    springs = Table(
        "Spring laws, all other parameters searched again:",
        ("", "free length / half width", "cost", "rows", "stiffness at 10 N / at 4 N"),
        [
            [s["law"], f"{s['length_ratio']:g}", f"{s['cost']:.3f}", str(s["met"]), f"{s['stiffening']:.2f}"]
            for s in content["springs"]
        ],
    )
    readings = Table(
        "Readings, each alone, all parameters searched again:",
        ("", "cost", "rows"),
        [
            [f"{item['reading']} {item['choice']}", f"{item['cost']:.3f}", str(item["explained"])]
            for item in content["readings_refitted"]
        ],
        note=f"Cost of the starts: {starts}",
    )
    return "\n\n".join([head.rstrip(), *(table.text() for table in (parameters, springs, readings))])


def spring_laws(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return the rows of Tables 2-5 for the best fit with each spring law, by the law's name."""
    return {spring["law"]: reproduced(spring["parameters"], readings) for spring in content["springs"]}


def cross_check(content: Mapping[str, Any], readings: Readings) -> dict[str, tuple[Row, ...]]:
    """Return the rows of each configuration as predicted by the fit to the other three."""
    return {
        left_out: tuple(row for row in reproduced(fitted, readings) if row.cell.configuration == left_out)
        for left_out, fitted in content["without"].items()
    }


_KINDS: dict[Any, str] = {
    bool: "true or false",
    (int, float): "a number",
    str: "text",
    list: "a list that is not empty",
    dict: "a mapping",
}


@dataclass(frozen=True)
class OwnStudy:
    """A study's folder, its content as `study` returned it, and its devices by `tables.DEVICES`."""

    folder: str
    identification: dict[str, Any]
    profiles: dict[str, Profile]


def read_study(folder: str | Path) -> OwnStudy:
    """Read ``identification.json`` and both profiles from a folder that `amulett identify` wrote.

    Raises AmulettError if there is no study, or one that is not finished, was made under other readings or for other
    parameters, or whose files cannot be read, lack a key or do not belong together.
    """
    path = Path(folder) / "identification.json"
    if not path.is_file():
        if any((Path(folder) / mark).is_file() for mark in STUDY_MARKS):
            raise AmulettError(
                f"the study in '{folder}' is not finished; `amulett identify --out {folder}` continues it"
            )
        raise AmulettError(f"'{folder}' holds no study: '{path}' is missing; `amulett identify` writes one")
    content = read_json(path, "study")
    _check(content, f"study '{path}'")
    profiles = {name: load_profile(Path(folder) / f"{name}.yaml") for name in DEVICES}
    values = {entry["name"]: entry["value"] for entry in content["spread"]}
    expected = devices(values, content["readings"]["spring_end"])
    for name, profile in profiles.items():
        if not same_device(profile, expected[name]):
            raise AmulettError(
                f"'{Path(folder) / f'{name}.yaml'}' does not describe the device of '{path}'; "
                f"`amulett identify --out {folder}` writes both again"
            )
    return OwnStudy(str(folder), content, profiles)


def copy_study(folder: str | Path, place: Path) -> None:
    """Copy the files that `read_study` reads into the folder `place`."""
    place.mkdir(exist_ok=True)
    for name in ("identification.json", *(f"{device}.yaml" for device in DEVICES)):
        write_text(place / name, read_text(Path(folder) / name, "study"))


def _check(found: Any, what: str) -> None:
    """Refuse content that is no study, or one with other readings, parameters or configurations than this version's."""
    _check_kind(found, shipped(), what, "")
    other = [
        f"{name} {found['readings'].get(name)} (not {choice})"
        for name, choice in asdict(Readings()).items()
        if found["readings"].get(name) != choice
    ]
    if other:
        raise AmulettError(f"{what} was made under other readings: {', '.join(other)}; identify again")
    if any(len(entry["bounds"]) != 2 for entry in found["spread"]):
        raise AmulettError(f"{what}: each 'bounds' in 'spread' has to hold two numbers")
    _check_names(f"{what}: 'without'", found["without"], CONFIGURATIONS)
    refitted = [f"{item['reading']} {item['choice']}" for item in found["readings_refitted"]]
    # The shipped study is older than some readings and has no fits under these; its tables leave them empty.
    fitted_there = {f"{item['reading']} {item['choice']}" for item in shipped()["readings_refitted"]}.union(refitted)
    names = [name for name in (f"{name} {choice}" for name, choice in ALTERNATIVES) if name in fitted_there]
    _check_names(f"{what}: 'readings_refitted'", refitted, names)
    fitted = {"spread": {entry["name"]: entry["value"] for entry in found["spread"]}}
    fitted |= {f"without.{name}": parameters for name, parameters in found["without"].items()}
    fitted |= {f"springs.{k}.parameters": spring["parameters"] for k, spring in enumerate(found["springs"])}
    for where, parameters in fitted.items():
        _check_names(f"{what}: '{where}'", parameters, [free.name for free in PARAMETERS])
        for free in PARAMETERS:
            value = parameters[free.name]
            if value < 0.0 or value == 0.0 < free.low:
                raise AmulettError(f"{what}: '{where}.{free.name}' is {value:g}; it has to be greater")


def _check_kind(given: Any, wanted: Any, what: str, where: str) -> None:
    """Refuse content that lacks a key of the shipped study, or has a value of another type there."""
    place = f"{what}: '{where}'" if where else what
    if isinstance(wanted, dict) and isinstance(given, dict):
        if missing := [key for key in wanted if key not in given]:
            raise AmulettError(f"{place} lacks {', '.join(missing)}; identify again with this version")
        for key, item in wanted.items():
            _check_kind(given[key], item, what, f"{where}.{key}".lstrip("."))
    elif isinstance(wanted, list) and isinstance(given, list) and given:
        for k, item in enumerate(given):
            _check_kind(item, wanted[0], what, f"{where}.{k}")
    else:
        kind = next(kind for kind in _KINDS if isinstance(wanted, kind))
        if kind is list or not isinstance(given, kind) or (isinstance(given, bool) and kind is not bool):
            raise AmulettError(f"{place} is {str(given)[:80]!r}; it has to be {_KINDS[kind]}")


def _check_names(where: str, given: Iterable[str], names: Sequence[str]) -> None:
    there = set(given)
    if missing := [name for name in names if name not in there]:
        raise AmulettError(f"{where} lacks {', '.join(missing)}; identify again with this version")
    if unknown := sorted(there.difference(names)):
        raise AmulettError(f"{where} has {', '.join(unknown)}, which this version does not know; identify again")
