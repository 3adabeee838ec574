"""The stages of a benchmark; the results of finished ones are kept in its folder, not computed again."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from amulett_gym import DRIVES_ID, __version__
from amulett_gym.envs.reward import FULL_CONTROL
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import COST_OF, capped_cost
from amulett_gym.evaluation.runner import YARDSTICK, Protocol, Run, Schedule, labels
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.laws import result_path, tune
from amulett_gym.evaluation.search.optimal import OptimalCosts, optimal_costs
from amulett_gym.evaluation.search.transcription import load_casadi
from amulett_gym.laws.contenders import Contender, in_loop, parse_contender, split_loop
from amulett_gym.laws.copies import NO_COPIES, Copies
from amulett_gym.profile import Profile, load_profile, profile_names
from amulett_gym.reporting.figure_files import KINDS
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import find_config
from amulett_gym.simulation.layout import LOOPS
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_text, user_path
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.writing import output_folder, write_json
from amulett_gym.studies.benchmark import reference
from amulett_gym.studies.benchmark.ahead import play_ahead, solve_ahead, train_ahead, tune_ahead
from amulett_gym.studies.benchmark.altered import alter, with_gains
from amulett_gym.studies.benchmark.description import (
    PAPER_STEP,
    PAPERS,
    Benchmark,
    Learned,
    load_profile_of,
    loop_of,
    named,
)
from amulett_gym.studies.benchmark.episodes import Play, Played, file_label
from amulett_gym.studies.benchmark.frozen import check_frozen, hashes, seed_overlap
from amulett_gym.studies.benchmark.reference import Searched
from amulett_gym.studies.benchmark.runs import (
    TrainingRun,
    ablation_name,
    check_runs,
    outcome,
    required_runs,
    train_missing,
    trained_loops,
)
from amulett_gym.tasks.hashes import PROFILE
from amulett_gym.workers.call import ALONE, Workers

DESCRIPTION = "description.json"
"""File by which a benchmark's folder is recognised."""

EPISODES, RUNS, TUNED_LAWS, OPTIMAL = "episodes", "runs", "laws", "optimal"

Kind = Literal["law", "constant", "own", "learned", "reference", "ablation"]


@dataclass(frozen=True)
class Entry:
    """One line of the results.

    The kinds ``law``, ``constant`` and ``own`` have one member, and no seeds; ``learned``, ``reference`` (causal: it
    observes what no device can measure) and ``ablation`` have one member for each training seed.
    """

    name: str
    kind: Kind
    members: tuple[Contender, ...]
    seeds: tuple[int, ...] = ()

    @property
    def loop(self) -> str:
        """The control loop that plays."""
        return str(self.members[0].env_keywords.get("control", PAPERS))

    def file_labels(self) -> list[str]:
        """Return the names of the members' files."""
        name = file_label(self.name)
        return [f"{name}-seed-{seed}" for seed in self.seeds] or [name]


@dataclass(frozen=True)
class Evidence:
    """All measurements of a benchmark."""

    description: Benchmark
    profile: Profile
    hashes: dict[str, Any]  # of suites, prices, profile
    protocol: Protocol  # of the headline suite, held-out
    entries: dict[str, Entry]
    played: dict[tuple[str, str], dict[str, Played]]  # suite, split -> entry -> episodes
    tried: dict[str, dict[str, float]]  # suite -> constant -> mean cost on the split `train`
    validation: dict[str, float]  # mean capped cost of some laws on the headline entry's validation scenarios, or empty
    schedules: dict[str, list[Schedule]]  # of each entry's members on the headline suite; none of laws inside the loop
    searched: dict[str, Searched]  # by suite: the clairvoyant reference, which holds the foresight one
    runs: list[TrainingRun]
    overlap: dict[str, int]  # from `frozen.seed_overlap`
    tuned: dict[str, dict[str, Any]] = field(default_factory=dict)  # law tuned here -> its file's content
    optimal: OptimalCosts | None = None
    paper_gains: dict[str, Run] = field(default_factory=dict)  # suite -> eq. 6 with these, held-out; none: not other

    @property
    def metric(self) -> str:
        """The metric that is the track's cost."""
        return COST_OF[self.description.track]

    def best_constant(self, suite: str | None = None, loop: str | None = None) -> str:
        """Return the constant of the lowest cost on a suite's split `train`, in any loop or in one.

        If the suite is None, it is the headline suite: the constant is the best one overall.
        """
        return best_in(self.tried[suite or self.description.headline], loop)

    def best_constants(self, suite: str | None = None) -> list[str]:
        """Return the best constant of each loop."""
        return [
            self.best_constant(suite, loop) for loop in dict.fromkeys(map(loop_of, self.tried[self.protocol.suite]))
        ]

    def headline(self, split: str = "held-out") -> dict[str, Played]:
        """Return all entries' episodes on the headline suite."""
        return self.played[self.description.headline, split]

    def chosen_member(self, name: str) -> int:
        """Return the index of a learned entry's member with the lowest validation cost: the one to show."""
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
    copies: Copies = NO_COPIES,
    say: Say = lambda message: None,
    progress: bool = False,
    workers: Workers = ALONE,
) -> Evidence:
    """Run the stages that are missing, and return all measurements.

    Parameters
    ----------
    out : str or Path
        Folder; stages finished in it are not repeated. It is locked for other processes.
    recipes : Path
        Folder of the recipes and profiles that the description names.
    runs : str or Path, optional
        Folder of the training runs, ``<entry>/seed-<k>``; missing ones are trained there. ``out/runs`` if None.
    own : sequence of Contender
        Further contenders, such as :class:`amulett_gym.laws.contenders.Own`.
    command : sequence of str, optional
        The words of the command, for ``command.json``.
    copies : Copies
        The content of `own` policies, which is kept in the folder.
    say : callable
        Called with a line after each stage.
    workers : Workers
        For tuning, training, episodes, reference searches and optimal control. They change no result.

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
    recipes_of_laws = _tuning(description, profile)
    if description.optimal:
        load_casadi()
    reference.check_starts(description)
    check_frozen(description.suites, description.track)
    runs_folder = out / RUNS if runs is None else user_path(runs)
    trained = trained_loops(required_runs(description, recipes, runs_folder))
    # Which loop gets the further seeds does not matter to the checks: the same scenarios are drawn in each.
    more = (trained[name] for name, entry in description.learned.items() if entry.best_loop_seeds)
    first = description.in_best_loop(next(more, PAPERS), trained)
    needed = required_runs(first, recipes, runs_folder)
    chosen = {**description.model_dump(mode="json"), "profile": profile.model_dump(mode="json")}
    chosen["runs"] = None if runs is None else str(runs)
    seeds = [description.seed, *(seed for entry in first.learned.values() for seed in entry.seeds)]
    overlap = seed_overlap([run.config for run in needed], description.seed, description.episodes)
    if overlap["overlap"]:
        raise AmulettError(f"{overlap['overlap']} episodes would be trained on or chosen by, and judged on as well")
    found_hashes = hashes(profile, description.suites, description.track)
    with output_folder(out, "benchmark", [[DESCRIPTION]]), locked_folder(out):
        _remember(out / DESCRIPTION, description, recipes, found_hashes)
        copies.write(out)
        write_provenance(out, "benchmark", {**chosen, "kept": copies.record}, seeds, command)
        remove_leftovers(out)
        check_runs(required_runs(description, recipes, runs_folder))
        counts = {kind: f"{overlap[kind]:,}" for kind in ("train", "validation", "judged")}
        say(
            f"Episodes: {counts['train']} trained on, {counts['validation']} chosen by, {counts['judged']} judged on a "
            "suite; none is two of these"
        )
        by_loop: dict[Path, list[Recipe]] = {}
        for recipe in recipes_of_laws.values():
            by_loop.setdefault(out / TUNED_LAWS / recipe.control, []).append(recipe)
        tune_ahead(by_loop, workers, progress)
        tuned = {}
        for name, recipe in recipes_of_laws.items():
            folder = out / TUNED_LAWS / recipe.control
            tuned[name] = tune(folder, recipe, progress=progress)
            say(f"{name}: tuned with {recipe.episodes:,} simulated episodes")
            contender = replace(parse_contender(str(result_path(folder, recipe))), name=split_loop(name)[1])
            laws.append(Entry(name, "law", (in_loop(contender, split_loop(name)[0]),)))
        if description.track == FULL_CONTROL:  # whose return the training minimises
            laws = [_on_track(entry, description) for entry in laws]
        tried = _try_constants(description, out / EPISODES, protocol, laws, workers, progress)
        constant = best_in(tried[description.headline])
        say(f"best constant on train of {description.headline}: {constant}")
        description = description.in_best_loop(loop_of(constant), trained)
        needed = required_runs(description, recipes, runs_folder)
        missing = check_runs(needed)
        say(f"{len(needed) - len(missing)} of {len(needed)} training runs are there")
        evidence = _work(description, out, protocol, laws, tried, needed, found_hashes, overlap, say, progress, workers)
        evidence = replace(evidence, paper_gains=_with_paper_gains(evidence, out / EPISODES))
        if not description.optimal:
            return replace(evidence, tuned=tuned)
        scenarios = range(description.seed, description.seed + description.optimal)
        problem = profile, description.headline, "held-out", scenarios, out / OPTIMAL, description.duration
        solve_ahead(*problem, workers, progress)
        with Progress(description.optimal, "optimal control", "scenarios", progress) as bar:
            solved = optimal_costs(*problem, report=lambda note: bar.update(note=note))
        say(f"optimal control: mean cost {solved.cost.mean():.4f}, solved {solved.success.sum()} of {len(scenarios)}")
        return replace(evidence, tuned=tuned, optimal=solved)


def _try_constants(
    description: Benchmark, folder: Path, protocol: Protocol, laws: Sequence[Entry], workers: Workers, progress: bool
) -> dict[str, dict[str, float]]:
    """Return by suite the mean cost of each constant on the split `train`."""
    constants = [entry for entry in laws if entry.kind == "constant"]
    suites = {suite: replace(protocol, suite=suite, split="train") for suite in description.suites}

    def play(entry: Entry, suite: str) -> Play:
        return Play(folder, entry.file_labels()[0], suites[suite], entry.members[0])

    every = [play(entry, suite) for suite in suites for entry in constants]
    play_ahead(every, workers, "constants on train", progress)
    tried: dict[str, dict[str, float]] = {suite: {} for suite in suites}
    with Progress(len(suites) * len(constants), "constants on train", "runs", progress) as bar:
        for suite in suites:
            for entry in constants:
                tried[suite][entry.name] = float(play(entry, suite).run().values[COST_OF[description.track]].mean())
                bar.update(note=f"{entry.name} on {suite}")
    return tried


def _work(
    description: Benchmark,
    out: Path,
    protocol: Protocol,
    laws: list[Entry],
    tried: dict[str, dict[str, float]],
    needed: list[TrainingRun],
    found_hashes: dict[str, Any],
    overlap: dict[str, int],
    say: Say,
    progress: bool,
    workers: Workers,
) -> Evidence:
    folder, metric = out / EPISODES, COST_OF[description.track]

    def trained(run: TrainingRun) -> None:
        result = outcome(run)
        say(
            f"{run.name}: {result['steps']:,} steps in {result['seconds']:.0f} s, capped cost on validation "
            f"{result['best_cost']:.4f}"
        )

    train_ahead(needed, workers, progress)
    train_missing(needed, trained, progress)
    entries = [*laws, *_learned(description, needed)]
    plays = [
        play for place in description.places() for play in _plays(description, folder, protocol, entries, tried, place)
    ]
    play_ahead([play.episodes for play in plays], workers, "contenders", progress)
    runs: dict[tuple[str, str], dict[str, list[Run]]] = {}
    with Progress(len(plays), "contenders", "runs", progress) as bar:
        for play in plays:
            if play.place not in runs:
                say(f"{', '.join(play.place)}: {play.episodes.protocol.episodes} scenarios")
            runs.setdefault(play.place, {}).setdefault(play.entry, []).append(play.episodes.run())
            bar.update(note=f"{play.episodes.label} on {', '.join(play.place)}")
    shown = runs[protocol.suite, "held-out"]
    results = {place: {name: Played.of(done) for name, done in found.items()} for place, found in runs.items()}
    schedules = {name: [run.schedule for run in done] for name, done in shown.items() if done[0].schedule.error.size}
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
        searched={},
        runs=needed,
        overlap=overlap,
    )
    searched, where = {}, reference.place(evidence)
    with Progress(reference.rounds(description), "reference search", "rounds", progress) as bar:
        for suite, there in reference.protocols(description, protocol).items():
            searched[suite] = reference.search(description, there, out, bar.update, where, workers)
            foreseen = searched[suite].foresight
            for name, found in (("clairvoyant", searched[suite]), ("foresight", foreseen)):
                if found is not None:
                    say(f"{name}, {suite}: mean cost {found.run.values[metric].mean():.4f}")
    return replace(evidence, searched=searched, validation=_on_validation(evidence, folder))


@dataclass(frozen=True)
class _Play:
    """Episodes that a member of an entry has to play."""

    place: tuple[str, str]
    entry: str
    episodes: Play


def _plays(
    description: Benchmark,
    folder: Path,
    protocol: Protocol,
    entries: Sequence[Entry],
    tried: dict[str, dict[str, float]],
    place: tuple[str, str],
) -> list[_Play]:
    """Return what has to be played on a suite's split, or on its altered scenarios.

    On *full control*, with its many constants, only the best of each loop play outside the headline's held-out split.
    """
    suite, split = place
    headline = place == (description.headline, "held-out")
    if split in description.altered:
        there, folder = alter(replace(protocol, suite=suite), split), folder / split
    else:
        there = replace(protocol, suite=suite, split=split)
    if description.track == FULL_CONTROL and not headline:
        kept = {best_in(tried[each], loop) for each in (suite, description.headline) for loop in description.loops}
        entries = [entry for entry in entries if entry.kind != "constant" or entry.name in kept]
    return [
        _Play(place, entry.name, Play(folder, label, there, member, headline and entry.kind != "constant"))
        for entry in entries
        for label, member in zip(entry.file_labels(), entry.members, strict=True)
    ]


def _with_paper_gains(evidence: Evidence, folder: Path) -> dict[str, Run]:
    """Return eq. 6's runs, held-out, in the paper's loop with the gains of the shipped profile, the paper's.

    They are of the headline and of the paper's step, on the track *full control*; none if the profile has these gains.
    """
    profile, description = evidence.profile, evidence.description
    papers = with_gains(profile, load_profile(profile.root if profile.root in profile_names() else PROFILE))
    if description.track != FULL_CONTROL or papers == profile:
        return {}
    suites = [suite for suite in dict.fromkeys((description.headline, PAPER_STEP)) if suite in description.suites]
    contender = evidence.entries[YARDSTICK].members[0]
    there = replace(evidence.protocol, profile=papers, split="held-out")
    return {
        suite: Play(folder / "paper-gains", YARDSTICK, replace(there, suite=suite), contender).run() for suite in suites
    }


def best_in(costs: dict[str, float], loop: str | None = None) -> str:
    """Return the constant of the lowest cost, in any loop or in one."""
    return min((name for name in costs if loop in (None, loop_of(name))), key=lambda name: costs[name])


def _hand_made(description: Benchmark, own: Sequence[Contender]) -> list[Entry]:
    """Return the entries without training: laws, constants, the caller's contenders."""
    names = list(dict.fromkeys([YARDSTICK, *description.law_names()]))
    listed, schedule = [parse_contender(name) for name in description.contenders], description.track != FULL_CONTROL
    for contender in (*listed, *(own if schedule else ())):
        if contender.env_id == DRIVES_ID:
            raise AmulettError(
                f"contender '{contender.name}' was trained in {DRIVES_ID}; a benchmark compares such policies as "
                f"learned entries by their recipe, on the track {FULL_CONTROL}"
            )
    acting = [(contender, split_loop(contender.name)[0]) for contender in listed]
    acting += [(contender, str(contender.env_keywords.get("control", PAPERS))) for contender in own]
    for contender, loop in acting:
        if schedule and loop in LOOPS:
            raise AmulettError(
                f"contender '{contender.name}' is in the loop {loop}; the track is {description.track}. Set track: "
                f"{FULL_CONTROL}"
            )
    contenders = [parse_contender(name) for name in names]
    for contender in contenders:
        if (control := contender.env_keywords.get("control")) in LOOPS and control != loop_of(contender.name):
            raise AmulettError(
                f"contender '{contender.name}' acts in the loop {control}; write {named(control, contender.name)}, on "
                f"the track {FULL_CONTROL}"
            )
    label = labels([contender.name for contender in contenders])
    entries = [Entry(label[contender.name], "law", (contender,)) for contender in contenders]
    entries += [Entry(name, "constant", (parse_contender(name),)) for name in description.constant_names()]
    entries += [Entry(contender.name, "own", (contender,)) for contender in own]
    names = [entry.name for entry in entries] + list(description.learned) + list(_tuned_names(description))
    for name in names:
        if names.count(name) > 1:
            raise AmulettError(f"two contenders would be called '{name}'; give one of them another name")
    return entries


def _on_track(entry: Entry, description: Benchmark) -> Entry:
    """Return an entry whose members play on the description's track; it decides the return, and no metric."""
    keywords = {"track": description.track}
    members = (replace(member, env_keywords={**member.env_keywords, **keywords}) for member in entry.members)
    return replace(entry, members=tuple(members))


def _tuned_names(description: Benchmark) -> dict[str, tuple[str, str]]:
    """Return the names of the laws that are tuned here, each with its loop and law."""
    return {named(loop, law): (loop, law) for loop in description.loops for law in description.tuned_budget}


def _tuning(description: Benchmark, profile: Profile) -> dict[str, Recipe]:
    """Return by name how each law is tuned in each loop.

    Raises AmulettError if a budget is too small.
    """
    return {
        name: Recipe(law, description.headline, profile, control=loop, track=description.track).within(
            description.tuned_budget[law]
        )
        for name, (loop, law) in _tuned_names(description).items()
    }


def _learned(description: Benchmark, runs: Sequence[TrainingRun]) -> list[Entry]:
    """Return the entries of the training runs, each seed's best policy a member."""
    kinds: dict[str, Kind] = {
        name: "reference" if entry.reference else "learned" for name, entry in description.learned.items()
    }
    best = description.best_learned
    kinds |= {ablation_name(best, term): "ablation" for term in description.ablations if best is not None}
    entries = []
    for name in dict.fromkeys(run.entry for run in runs):
        own = [run for run in runs if run.entry == name]
        loop = split_loop(name)[0]
        members = tuple(in_loop(parse_contender(str(run.folder / "best")), loop) for run in own)
        entry = Entry(name, kinds[name], members, tuple(run.seed for run in own))
        entries.append(_on_track(entry, description) if description.track == FULL_CONTROL else entry)
    return entries


def _on_validation(evidence: Evidence, folder: Path) -> dict[str, float]:
    """Return the mean capped cost of some laws on the validation scenarios of the headline entry."""
    description = evidence.description
    config = next((run.config for run in evidence.runs if run.entry == description.best_learned), None)
    if description.best_learned is None or config is None or config.env.suite != description.headline:
        return {}
    there = replace(
        evidence.protocol, split="validation", episodes=config.validation.episodes, seed=config.validation.seed
    )
    costs = {}
    loop = loop_of(description.best_learned)
    for name in (YARDSTICK, evidence.best_constant(loop=loop), named(loop, "eq6-tuned"), named(loop, "parametric")):
        if name in evidence.entries:
            entry = evidence.entries[name]
            run = Play(folder, entry.file_labels()[0], there, entry.members[0]).run()
            costs[name] = float(capped_cost(run.values).mean())
    return costs


def remove_leftovers(out: Path) -> None:
    """Remove half-written files of a process that was killed; the folder has to be locked."""
    for path in out.rglob(".*-????????.*"):
        if path.suffix[1:] in ("npz", "json", "csv", "html", *KINDS) and RUNS not in path.relative_to(out).parts:
            path.unlink(missing_ok=True)


def _remember(path: Path, description: Benchmark, recipes: Path, found_hashes: dict[str, Any]) -> None:
    """Store the benchmark's description in its folder, or refuse a folder of another one, naming the differences."""
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
        # Keys that are newer than the folder had their defaults then.
        stored["description"] = {**Benchmark().model_dump(mode="json"), **stored["description"]}
        newer = Learned(seeds=[0]).model_dump(mode="json")
        learned = stored["description"]["learned"]
        stored["description"]["learned"] = {name: {**newer, **entry} for name, entry in learned.items()}
    except (ValueError, AttributeError, KeyError, TypeError) as error:
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
