"""Stages of a study: a search, a walk or other work on plain data, each kept in the folder when it is finished."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.identification.ensemble import ensemble
from amulett_gym.identification.parameters import OWN, PARAMETERS, Values, bare, devices, searched, unpack
from amulett_gym.identification.search import search
from amulett_gym.storage.kept import digest, read_kept, write_kept
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.paper.objective import (
    OUT_OF_REACH,
    ROBUST,
    SIMULATED,
    WEIGHTS,
    most_explained,
    objective,
    reproduced,
)
from amulett_gym.studies.paper.reproduction import BOUNDS, MEASUREMENT_TIME, Readings
from amulett_gym.studies.paper.tables import PROTOCOL, TABLES_2_TO_5
from amulett_gym.workers.call import Call, Workers
from amulett_gym.workers.run import results

Report = Callable[[str, Mapping[str, Any]], None]
Work = Callable[[Mapping[str, Any], Mapping[str, Any]], Any]


def begin_stages(
    folder: Path,
    file: str,
    recipe: Any,
    readings: Readings,
    workers: Workers,
    report: Report,
    overwrite: bool,
    command: Sequence[str] | None,
) -> tuple[dict[str, Any], Callable[..., None]]:
    """Write down what a study is, and return the dictionary of its stages' results and the function that fills it.

    The function takes `calls` and `work` of `run_stages`, and gives each result to `report`. `recipe` is a dataclass
    with `seeds`, kept in the folder's `file`; one that is there already has to be the same, unless `overwrite` is true.
    """
    if not overwrite:
        _refuse_other_recipe(folder / file, recipe)
    write_json(folder / file, asdict(recipe))
    write_provenance(folder, "identify", asdict(recipe), recipe.seeds, command)
    stages: dict[str, Any] = {}

    def run(calls: Mapping[str, Mapping[str, Any]], work: Work | None = None) -> None:
        for name, result in run_stages(folder / "stages", calls, readings, workers, work):
            stages[name] = result
            report(name, result)

    return stages, run


def run_stages(
    folder: Path, calls: Mapping[str, Mapping[str, Any]], readings: Readings, workers: Workers, work: Work | None = None
) -> Iterable[tuple[str, Any]]:
    """Yield each stage's name and result: first those kept in the folder, then the others as they finish.

    Parameters
    ----------
    folder : Path
        Each result is kept in it, with the digest of its call.
    calls : mapping
        Name -> plain data that says what to do.
    readings : Readings
    workers : Workers
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
    todo = {name: Call(work or _do_stage, (calls[name], asdict(readings))) for name in missing}
    with closing(results(todo, workers)) as finished:
        for name, result in finished:
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


def _refuse_other_recipe(path: Path, recipe: Any) -> None:
    """Raise an AmulettError if the file `path` holds another recipe, a dataclass, than this one."""
    if path.exists():
        found, asked = read_json(path, "recipe"), json.loads(json.dumps(asdict(recipe)))
        if other := differences(asked, found, "" if isinstance(found, dict) else "the recipe"):
            raise AmulettError(
                f"'{path.parent}' holds a study of another recipe ({', '.join(other)}); choose another folder, or "
                "replace it with --overwrite"
            )
