"""The benchmark's work, stage by stage; what is finished stays in its folder, and is never done twice."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import capped_cost
from amulett_gym.evaluation.runner import YARDSTICK, Protocol, Schedule, labels
from amulett_gym.laws.contenders import Contender, parse_contender
from amulett_gym.profile import Profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import find_config
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_text, user_path
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.writing import output_folder, write_json
from amulett_gym.studies.benchmark import reference
from amulett_gym.studies.benchmark.description import Benchmark, load_profile_of
from amulett_gym.studies.benchmark.episodes import Played, file_label, played
from amulett_gym.studies.benchmark.frozen import check_frozen, hashes, seed_overlap
from amulett_gym.studies.benchmark.reference import Searched
from amulett_gym.studies.benchmark.runs import (
    TrainingRun,
    ablation_name,
    check_runs,
    outcome,
    required_runs,
    train_missing,
)

DESCRIPTION = "description.json"
"""File by which a benchmark's folder is recognised."""

EPISODES, RUNS = "episodes", "runs"

Kind = Literal["law", "constant", "own", "learned", "reference", "ablation"]


@dataclass(frozen=True)
class Entry:
    """One line of the results.

    Attributes
    ----------
    name : str
    kind : str
        ``law``, ``constant`` and ``own`` have one member; ``learned``, ``reference`` (causal: it sees what no device
        can) and ``ablation`` one for each training seed.
    members : tuple of Contender
    seeds : tuple of int
        Of the training, one for each member; empty where nothing was trained.
    """

    name: str
    kind: Kind
    members: tuple[Contender, ...]
    seeds: tuple[int, ...] = ()

    def file_labels(self) -> list[str]:
        """Return what the members' files are called."""
        name = file_label(self.name)
        return [f"{name}-seed-{seed}" for seed in self.seeds] or [name]


@dataclass(frozen=True)
class Evidence:
    """Everything that was measured.

    Attributes
    ----------
    description : Benchmark
    profile : Profile
    hashes : dict
        Of suites, prices and profile.
    protocol : Protocol
        Of the headline suite, held-out.
    entries : dict of str to Entry
    played : dict of (suite, split) to dict of str to Played
        By entry.
    tried : dict of str to dict of str to float
        Mean cost of each constant on the split `train`, suite by suite.
    validation : dict of str to float
        Mean capped cost of some laws on the scenarios by which the headline entry's policies were chosen; may be empty.
    schedules : dict of str to list of Schedule
        Of each entry's members on the headline suite, held-out; without those that act inside the loop.
    searched : dict of str to Searched
        The clairvoyant reference, and with it the foresight one, by suite.
    runs : list of TrainingRun
    overlap : dict of str to int
        From `frozen.seed_overlap`.
    """

    description: Benchmark
    profile: Profile
    hashes: dict[str, Any]
    protocol: Protocol
    entries: dict[str, Entry]
    played: dict[tuple[str, str], dict[str, Played]]
    tried: dict[str, dict[str, float]]
    validation: dict[str, float]
    schedules: dict[str, list[Schedule]]
    searched: dict[str, Searched]
    runs: list[TrainingRun]
    overlap: dict[str, int]

    def best_constant(self, suite: str | None = None) -> str:
        """Return the constant of the lowest cost on a suite's split `train`; overall if None: on the headline suite."""
        tried = self.tried[suite or self.description.headline]
        return min(tried, key=lambda name: tried[name])

    def headline(self, split: str = "held-out") -> dict[str, Played]:
        """Return what all did on the headline suite."""
        return self.played[self.description.headline, split]

    def chosen_member(self, name: str) -> int:
        """Return the member of a learned entry with the lowest cost on its validation scenarios: the one to show."""
        costs = [outcome(run)["best_cost"] for run in self.runs if run.entry == name]
        return int(np.argmin(costs)) if costs else 0


Say = Callable[[str], Any]


def run_benchmark(
    description: Benchmark,
    out: str | Path,
    recipes: Path,
    runs: str | Path | None = None,
    own: Sequence[Contender] = (),
    command: Sequence[str] | None = None,
    say: Say = lambda message: None,
    progress: bool = False,
) -> Evidence:
    """Do what is not done yet, and return all that was measured.

    Parameters
    ----------
    out : str or Path
        Folder; what is finished in it is not done again. It is kept to this process.
    recipes : Path
        Folder of the recipes and profiles that the description names.
    runs : str or Path, optional
        Folder of the training runs, ``<entry>/seed-<k>``; what is missing is trained there. ``out/runs`` if None.
    own : sequence of Contender
        Further contenders, such as :class:`amulett_gym.laws.contenders.Own`.
    command : sequence of str, optional
        The words of the command, for ``command.json``.
    say : callable
        Called with a line when something has happened.
    progress : bool
        Show progress on stderr.

    Raises
    ------
    AmulettError
        If the folder belongs to another description, frozen data has changed, seeds overlap, a run is of another
        recipe, or something cannot be read or written.
    """
    out = user_path(out)
    profile = load_profile_of(description, recipes)
    protocol = Protocol(
        profile,
        description.headline,
        "held-out",
        episodes=description.episodes,
        seed=description.seed,
        duration=description.duration,
    )
    laws = _hand_made(description, own)
    reference.check_starts(description)
    check_frozen(description.suites)
    needed = required_runs(description, recipes, out / RUNS if runs is None else user_path(runs))
    chosen = {**description.model_dump(mode="json"), "profile": profile.model_dump(mode="json")}
    chosen["runs"] = None if runs is None else str(runs)
    seeds = [description.seed, *(seed for entry in description.learned.values() for seed in entry.seeds)]
    overlap = seed_overlap([run.config for run in needed], description.seed, description.episodes)
    if overlap["overlap"]:
        raise AmulettError(f"{overlap['overlap']} episodes would be trained on or chosen by, and judged on as well")
    found_hashes = hashes(profile, description.suites)
    with output_folder(out, "benchmark", [[DESCRIPTION]]), locked_folder(out):
        _remember(out / DESCRIPTION, description, recipes, found_hashes)
        write_provenance(out, "benchmark", chosen, seeds, command)
        _remove_leftovers(out)
        missing = check_runs(needed)
        say(
            f"{len(needed) - len(missing)} of {len(needed)} training runs are there. Episodes: {overlap['train']:,} "
            f"trained on, {overlap['validation']:,} chosen by, {overlap['judged']:,} judged on a suite; none is two of "
            "these"
        )
        return _work(description, out, protocol, laws, needed, found_hashes, overlap, say, progress)


def _work(
    description: Benchmark,
    out: Path,
    protocol: Protocol,
    laws: list[Entry],
    needed: list[TrainingRun],
    found_hashes: dict[str, Any],
    overlap: dict[str, int],
    say: Say,
    progress: bool,
) -> Evidence:
    places, folder = description.places(), out / EPISODES
    constants = [entry for entry in laws if entry.kind == "constant"]
    tried: dict[str, dict[str, float]] = {}
    with Progress(len(description.suites) * len(constants), "constants on train", "runs", progress) as bar:
        for suite in description.suites:
            there = replace(protocol, suite=suite, split="train")
            tried[suite] = {}
            for entry in constants:
                run = played(folder, entry.file_labels()[0], there, entry.members[0])
                tried[suite][entry.name] = float(run.values["cost"].mean())
                bar.update(note=f"{entry.name} on {suite}")

    def trained(run: TrainingRun) -> None:
        result = outcome(run)
        say(
            f"{run.name}: {result['steps']:,} steps in {result['seconds']:.0f} s, capped cost on validation "
            f"{result['best_cost']:.4f}"
        )

    train_missing(needed, trained, progress)
    entries = [*laws, *_learned(description, needed)]
    results: dict[tuple[str, str], dict[str, Played]] = {}
    schedules: dict[str, list[Schedule]] = {}
    total = len(places) * sum(len(entry.members) for entry in entries)
    with Progress(total, "contenders", "runs", progress) as bar:
        for suite, split in places:
            there, kept = replace(protocol, suite=suite, split=split), (suite, split) == (protocol.suite, "held-out")
            results[suite, split] = {}
            for entry in entries:
                done = []
                for label, member in zip(entry.file_labels(), entry.members, strict=True):
                    done.append(played(folder, label, there, member, keep_schedule=kept and entry.kind != "constant"))
                    bar.update(note=f"{label} on {suite}, {split}")
                results[suite, split][entry.name] = Played.of(done)
                if kept and done[0].schedule.error.size:
                    schedules[entry.name] = [run.schedule for run in done]
            say(f"{suite}, {split}: {len(entries)} contenders on {there.episodes} scenarios")
    searched = {}
    with Progress(reference.rounds(description), "reference search", "rounds", progress) as bar:
        for suite, there in reference.protocols(description, protocol).items():
            searched[suite] = reference.search(description, there, out, bar.update)
            foreseen = searched[suite].foresight
            for name, found in (("clairvoyant", searched[suite]), ("foresight", foreseen)):
                if found is not None:
                    say(f"{name}, {suite}: mean cost {found.run.values['cost'].mean():.4f}")
    evidence = Evidence(
        description=description,
        profile=protocol.profile,
        hashes=found_hashes,
        protocol=protocol,
        entries={entry.name: entry for entry in entries},
        played=results,
        tried=tried,
        validation={},
        schedules=schedules,
        searched=searched,
        runs=needed,
        overlap=overlap,
    )
    return replace(evidence, validation=_on_validation(evidence, folder))


def _hand_made(description: Benchmark, own: Sequence[Contender]) -> list[Entry]:
    """Return the entries that nobody has to train: laws, constants, and what the caller brings."""
    names = list(dict.fromkeys([YARDSTICK, *description.contenders]))
    contenders = [parse_contender(name) for name in names]
    label = labels([contender.name for contender in contenders])
    entries = [Entry(label[contender.name], "law", (contender,)) for contender in contenders]
    entries += [Entry(name, "constant", (parse_contender(name),)) for name in description.constant_names()]
    entries += [Entry(contender.name, "own", (contender,)) for contender in own]
    names = [entry.name for entry in entries] + list(description.learned)
    for name in names:
        if names.count(name) > 1:
            raise AmulettError(f"two contenders would be called '{name}'; give one of them another name")
    return entries


def _learned(description: Benchmark, runs: Sequence[TrainingRun]) -> list[Entry]:
    """Return the entries of the training runs, each seed's best policy a member."""
    kinds: dict[str, Kind] = {
        name: "reference" if entry.reference else "learned" for name, entry in description.learned.items()
    }
    kinds |= {ablation_name(description.best_learned, term): "ablation" for term in description.ablations}
    entries = []
    for name in dict.fromkeys(run.entry for run in runs):
        own = [run for run in runs if run.entry == name]
        members = tuple(parse_contender(str(run.folder / "best")) for run in own)
        entries.append(Entry(name, kinds[name], members, tuple(run.seed for run in own)))
    return entries


def _on_validation(evidence: Evidence, folder: Path) -> dict[str, float]:
    """Return the mean capped cost of some laws on the validation scenarios of the headline entry."""
    description = evidence.description
    config = next((run.config for run in evidence.runs if run.entry == description.best_learned), None)
    if config is None or config.env.suite != description.headline:
        return {}
    there = replace(
        evidence.protocol, split="validation", episodes=config.validation.episodes, seed=config.validation.seed
    )
    costs = {}
    for name in (YARDSTICK, evidence.best_constant(), "eq6-tuned", "parametric"):
        if name in evidence.entries:
            entry = evidence.entries[name]
            run = played(folder, entry.file_labels()[0], there, entry.members[0])
            costs[name] = float(capped_cost(run.values).mean())
    return costs


def _remove_leftovers(out: Path) -> None:
    """Remove half-written files of a process that was killed; the folder has to be locked."""
    for path in out.rglob(".*-????????.*"):
        if path.suffix in (".npz", ".json", ".csv", ".png", ".html") and RUNS not in path.relative_to(out).parts:
            path.unlink(missing_ok=True)


def _remember(path: Path, description: Benchmark, recipes: Path, found_hashes: dict[str, Any]) -> None:
    """Write down what a folder is about, or check that it is about the same.

    Raises AmulettError if it is about something else: the error names what has changed.
    """
    files = {
        name: {} if entry.recipe is None else read_yaml(find_config(entry.recipe, "recipe", recipes), "recipe")
        for name, entry in description.learned.items()
    }
    content = {
        "format": "amulett-benchmark",
        "version": 1,
        "description": description.model_dump(mode="json"),
        "recipes": files,
        "hashes": found_hashes,
    }
    content = json.loads(json.dumps(content))
    if not path.exists():
        write_json(path, {**content, "amulett-gym": __version__})
        return
    try:
        stored = json.loads(read_text(path, "benchmark"))
        stored.pop("amulett-gym", None)
    except (ValueError, AttributeError) as error:
        if isinstance(error, AmulettError):
            raise
        raise AmulettError(
            f"'{path}' is not valid JSON: {error}; delete it if the folder is of this benchmark"
        ) from error
    changed = differences(stored, content)
    if changed:
        raise AmulettError(
            f"'{path.parent}' holds another benchmark: {'; '.join(changed[:8])}{'; ...' if len(changed) > 8 else ''}; "
            "choose another folder (runs of the same recipes can be used there by --runs)"
        )
