"""The stages of a benchmark over devices; the results of finished ones are kept in its folder, not computed again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.metrics import COST_OF
from amulett_gym.evaluation.runner import YARDSTICK, Protocol
from amulett_gym.evaluation.search.constants import best_constants
from amulett_gym.evaluation.search.law_recipe import Recipe
from amulett_gym.evaluation.search.laws import result_path, tune
from amulett_gym.laws.contenders import CONSTANT, Contender, parse_contender
from amulett_gym.laws.copies import NO_COPIES, Copies
from amulett_gym.learning import load_learning
from amulett_gym.profile import Profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import find_config
from amulett_gym.simulation.layout import FAMILIES
from amulett_gym.storage.kept import digest, kept
from amulett_gym.storage.lock import locked_folder
from amulett_gym.storage.provenance import differences, write_provenance
from amulett_gym.storage.reading import read_json, user_path
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.writing import output_folder, write_json
from amulett_gym.studies.benchmark.ahead import play_ahead, train_ahead, tune_ahead
from amulett_gym.studies.benchmark.altered import with_gains
from amulett_gym.studies.benchmark.description import Learned, named, training_recipe
from amulett_gym.studies.benchmark.devices.description import (
    ADAPTED,
    EQ6_WITH_GAINS,
    LEAST_BUDGET,
    OWN_CONSTANT,
    SPECIALIST,
    DevicesBenchmark,
    as_override,
    entry_name,
    eq6_gains,
    load_fleets,
)
from amulett_gym.studies.benchmark.episodes import Play, Played, file_label
from amulett_gym.studies.benchmark.frozen import check_frozen, seed_overlap
from amulett_gym.studies.benchmark.runs import TrainingRun, check_runs, outcome, train_missing
from amulett_gym.studies.benchmark.stages import DESCRIPTION, EPISODES, RUNS, TUNED_LAWS, Say, remove_leftovers
from amulett_gym.workers.call import ALONE, Workers

OWN_CONSTANTS = "own_constants.json"

Kind = Literal["law", "tuned", "own", "learned", "specialist", "adapted"]

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Entry:
    """One line of the results: its members on each device that it plays on.

    What is ``learned`` has one member for each training seed, the same on all devices. Members of the kinds ``own``
    (constants), ``specialist`` and ``adapted`` are the device's own.
    """

    name: str
    kind: Kind
    members: Mapping[str, tuple[Contender, ...]]  # device -> contenders
    seeds: tuple[int, ...] = ()
    gains: Profile | None = None  # with those of the paper's loop of this profile; None: with each device's own

    @property
    def devices(self) -> tuple[str, ...]:
        """Names of the devices that it plays on."""
        return tuple(self.members)


@dataclass(frozen=True)
class Evidence:
    """All measurements of a benchmark over devices."""

    description: DevicesBenchmark
    fleets: dict[str, tuple[Profile, ...]]
    entries: dict[str, Entry]
    played: dict[str, dict[str, Played]]  # entry -> device -> episodes
    own_constants: dict[str, dict[str, float]]  # device -> tension [N], and its mean cost on the split `train`
    runs: list[TrainingRun]  # of all trained entries
    tuned: dict[str, dict[str, Any]]  # entry -> its file's content
    start: int  # the member of `best_learned` that is adapted
    overlap: dict[str, int]  # from `frozen.seed_overlap`

    @property
    def metric(self) -> str:
        """The metric that is the track's cost."""
        return COST_OF[self.description.track]

    @property
    def families(self) -> NDArray[np.str_]:
        """Family of each scenario."""
        codes = next(iter(self.played[YARDSTICK].values())).families
        return np.array([FAMILIES[code] or self.description.suite for code in codes])

    def values(self, name: str, metric: str | None = None, devices: Sequence[str] | None = None) -> Values:
        """Return an entry's values of a metric (None: the cost), shape (members, devices, scenarios).

        The devices are the entry's own, or those given.
        """
        chosen = self.entries[name].devices if devices is None else devices
        each = [self.played[name][device].values[metric or self.metric] for device in chosen]
        return np.stack(each, axis=1)


def run_devices_benchmark(
    description: DevicesBenchmark,
    out: str | Path,
    folder: Path,
    runs: str | Path | None = None,
    own: Sequence[Contender] = (),
    command: Sequence[str] | None = None,
    copies: Copies = NO_COPIES,
    say: Say = lambda message: None,
    progress: bool = False,
    workers: Workers = ALONE,
) -> Evidence:
    """Run the stages that are missing, and return all measurements.

    Parameters are those of `stages.run_benchmark`; `folder` is that of the recipes and fleets that the description
    names.

    Raises
    ------
    AmulettError
        If the folder belongs to another description, a device is in two fleets, seeds overlap, a run is of another
        recipe, or something cannot be read or written.
    """
    out = user_path(out)
    fleets = load_fleets(description, folder)
    judged, gains = fleets["judge"], eq6_gains(description, folder)
    check_frozen([description.suite], description.track)
    runs_folder = out / RUNS if runs is None else user_path(runs)
    learned = _learned_runs(description, folder, runs_folder)
    specialists = _specialist_runs(description, folder, runs_folder, judged)
    recipes = _tuning(description, fleets, learned[0].config)
    overlap = seed_overlap([run.config for run in (*learned, *specialists)], description.seed, description.episodes)
    if overlap["overlap"]:
        raise AmulettError(f"{overlap['overlap']} episodes would be trained on or chosen by, and judged on as well")
    contents = {key: [profile.model_dump(mode="json") for profile in fleet] for key, fleet in fleets.items()}
    config = {**description.model_dump(mode="json"), "devices": contents, "runs": None if runs is None else str(runs)}
    with output_folder(out, "benchmark", [[DESCRIPTION]]), locked_folder(out):
        _remember(out / DESCRIPTION, description, folder, digest(contents))
        copies.write(out)
        seeds = [description.seed, *(run.seed for run in learned)]
        write_provenance(out, "benchmark", {**config, "kept": copies.record}, seeds, command)
        remove_leftovers(out)
        counts = {kind: f"{overlap[kind]:,}" for kind in ("train", "validation", "judged")}
        say(
            f"{len(fleets['train'])} devices to train on, {len(fleets['choose'])} to choose by, {len(judged)} to judge "
            f"by; episodes: {counts['train']} trained on, {counts['validation']} chosen by, {counts['judged']} judged "
            "on each device; none is two of these"
        )
        tuned = _tune(recipes, out / TUNED_LAWS, say, progress, workers)
        constants = _own_constants(description, judged, out)
        say("best constant of each judged device: " + ", ".join(f"{one['tension']:g}" for one in constants.values()))
        _train(learned + specialists, say, progress, workers)
        start = int(np.argmin([outcome(run)["best_cost"] for run in _of(learned, description.best_learned)]))
        adapted = _adapted_runs(description, runs_folder, judged, _of(learned, description.best_learned)[start])
        _train(adapted, say, progress, ALONE)  # limited by time: one at a time
        entries = [
            *_given(description, judged, own, gains),
            *_tuned_entries(recipes, judged, out / TUNED_LAWS),
            _own_entry(description, constants),
            *_trained_entries(description, judged, learned, specialists, adapted),
        ]
        found = _play(description, entries, judged, out / EPISODES, progress, workers)
        say(f"{len(entries)} entries played on {len(judged)} devices, {description.episodes} scenarios each")
    return Evidence(
        description=description,
        fleets=fleets,
        entries={entry.name: entry for entry in entries},
        played=found,
        own_constants=constants,
        runs=[*learned, *specialists, *adapted],
        tuned=tuned,
        start=start,
        overlap=overlap,
    )


def check_devices_benchmark(description: DevicesBenchmark, folder: Path) -> None:
    """Raise an AmulettError if a fleet or a recipe of a description cannot be read, is wrong, or does not fit."""
    judged = load_fleets(description, folder)["judge"]
    _learned_runs(description, folder, Path(RUNS))
    _specialist_runs(description, folder, Path(RUNS), judged)
    eq6_gains(description, folder)


def _of(runs: Sequence[TrainingRun], entry: str) -> list[TrainingRun]:
    return [run for run in runs if run.entry == entry]


def _learned_runs(description: DevicesBenchmark, folder: Path, place: Path) -> list[TrainingRun]:
    """Return the runs on the training devices, those of the entry that the claims are about first."""
    fleets = [
        f"env.fleet={as_override(description.fleets.train, folder)}",
        f"validation.fleet={as_override(description.fleets.choose, folder)}",
    ]
    names = sorted(description.learned, key=lambda name: name != description.best_learned)
    found = [
        TrainingRun(name, seed, training_recipe(entry, seed, folder, fleets), place / name / f"seed-{seed}")
        for name, entry in ((name, description.learned[name]) for name in names)
        for seed in entry.seeds
    ]
    for run in found:
        env = run.config.env
        for key, value in (("control", description.loop), ("track", description.track), ("suite", description.suite)):
            if getattr(env, key) != value:
                raise AmulettError(
                    f"learned entry '{run.entry}' is trained with {key} '{getattr(env, key)}', the benchmark has "
                    f"'{value}'; set env.{key}={value}"
                )
    return found


def _on_device(profile: Profile) -> list[str]:
    return ["env.fleet=null", "validation.fleet=null", f"env.profile={json.dumps(profile.model_dump(mode='json'))}"]


def _specialist_runs(
    description: DevicesBenchmark, folder: Path, place: Path, judged: Sequence[Profile]
) -> list[TrainingRun]:
    """Return the runs of the same recipe on single devices."""
    entry, given = description.learned[description.best_learned], description.specialists
    found = []
    for profile in judged[: given.devices]:
        for seed in given.seeds:
            config = training_recipe(entry, seed, folder, [*_on_device(profile), *given.set])
            found.append(
                TrainingRun(f"{SPECIALIST}/{profile.name}", seed, config, _place(place, SPECIALIST, profile, seed))
            )
    return found


def _adapted_runs(
    description: DevicesBenchmark, place: Path, judged: Sequence[Profile], start: TrainingRun
) -> list[TrainingRun]:
    """Return the further trainings of a learned policy on single devices."""
    given, found = description.adaptation, []
    for profile in judged[: given.devices]:
        config = adaptation_recipe(description, start.folder / "best", profile, start.seed)
        found.append(
            TrainingRun(f"{ADAPTED}/{profile.name}", start.seed, config, _place(place, ADAPTED, profile, start.seed))
        )
    return found


def adaptation_recipe(description: DevicesBenchmark, start: Path, profile: Profile, seed: int) -> Any:
    """Return the checked recipe by which `amulett train --start` trains a policy further on a device."""
    device = f"env.profile={json.dumps(profile.model_dump(mode='json'))}"
    changes = [device, *description.adaptation.set, f"seed={seed}"]
    return load_learning("recipes").load_train_config(None, changes, str(start))


def _place(folder: Path, entry: str, profile: Profile, seed: int) -> Path:
    return folder / entry / file_label(profile.name) / f"seed-{seed}"


def _train(runs: Sequence[TrainingRun], say: Say, progress: bool, workers: Workers) -> None:
    """Train the runs that are missing."""
    missing = check_runs(runs)

    def report(run: TrainingRun) -> None:
        if run in missing:
            result = outcome(run)
            say(
                f"{run.name}: {result['steps']:,} steps in {result['seconds']:.0f} s, capped cost on validation "
                f"{result['best_cost']:.4f}"
            )

    train_ahead(missing, workers, progress)
    train_missing(runs, report, progress)


def _tuning(description: DevicesBenchmark, fleets: Mapping[str, Any], config: Any) -> dict[str, Recipe]:
    """Return by entry how each law is tuned; AmulettError if the budget is too small.

    Without a budget it is the number of episodes of one training run, `config`, and at least `LEAST_BUDGET`.
    """
    budget = description.budget or max(config.total_steps // config.env.max_episode_steps, LEAST_BUDGET)
    return {
        entry_name(law): Recipe(
            law,
            description.suite,
            control=description.loop,
            track=description.track,
            fleet=fleets["train"],
            choose_fleet=fleets["choose"],
        ).within(budget)
        for law in description.laws
    }


def _tune(
    recipes: Mapping[str, Recipe], folder: Path, say: Say, progress: bool, workers: Workers
) -> dict[str, dict[str, Any]]:
    tune_ahead({folder: [*recipes.values()]}, workers, progress)
    tuned = {}
    for name, recipe in recipes.items():
        tuned[name] = tune(folder, recipe, progress=progress)
        say(f"{name}: tuned with {recipe.episodes:,} simulated episodes")
    return tuned


def _own_constants(description: DevicesBenchmark, judged: Sequence[Profile], out: Path) -> dict[str, dict[str, float]]:
    """Return the best constant of each device on the split `train`."""
    loop, track, scenarios = description.loop, description.track, description.constant_scenarios
    names = [profile.name for profile in judged]

    def search() -> dict[str, dict[str, float]]:
        found = best_constants(judged, description.suite, loop, track, scenarios)
        pairs = zip(*(each.tolist() for each in found), strict=True)
        return {name: {"tension": t, "train_cost": cost} for name, (t, cost) in zip(names, pairs, strict=True)}

    inputs = [description.suite, loop, track, scenarios, __version__, *(each.model_dump_json() for each in judged)]
    return kept(out / OWN_CONSTANTS, digest(inputs), search)


def _everywhere(judged: Sequence[Profile], *members: Contender) -> dict[str, tuple[Contender, ...]]:
    return {profile.name: members for profile in judged}


def _given(
    description: DevicesBenchmark, judged: Sequence[Profile], own: Sequence[Contender], gains: Profile | None
) -> list[Entry]:
    names = [YARDSTICK, *description.contenders]
    contenders = {**{name: parse_contender(name) for name in names}, **{each.name: each for each in own}}
    entries = [Entry(name, "law", _everywhere(judged, contender)) for name, contender in contenders.items()]
    if gains is not None:
        entries.append(Entry(EQ6_WITH_GAINS, "law", _everywhere(judged, contenders[YARDSTICK]), gains=gains))
    return entries


def _tuned_entries(recipes: Mapping[str, Recipe], judged: Sequence[Profile], folder: Path) -> list[Entry]:
    return [
        Entry(name, "tuned", _everywhere(judged, parse_contender(str(result_path(folder, recipe)))))
        for name, recipe in recipes.items()
    ]


def _own_entry(description: DevicesBenchmark, constants: Mapping[str, Mapping[str, float]]) -> Entry:
    members = {
        name: (parse_contender(named(description.loop, f"{CONSTANT}{one['tension']:g}")),)
        for name, one in constants.items()
    }
    return Entry(OWN_CONSTANT, "own", members)


def _trained_entries(
    description: DevicesBenchmark,
    judged: Sequence[Profile],
    learned: Sequence[TrainingRun],
    specialists: Sequence[TrainingRun],
    adapted: Sequence[TrainingRun],
) -> list[Entry]:
    def best(runs: Sequence[TrainingRun]) -> tuple[Contender, ...]:
        return tuple(parse_contender(str(run.folder / "best")) for run in runs)

    entries = []
    for name in description.learned:
        runs = _of(learned, name)
        entries.append(Entry(name, "learned", _everywhere(judged, *best(runs)), tuple(run.seed for run in runs)))
    kinds: list[tuple[Kind, Sequence[TrainingRun]]] = [("specialist", specialists), ("adapted", adapted)]
    for kind, all_runs in kinds:
        of = {profile.name: _of(all_runs, f"{kind}/{profile.name}") for profile in judged}
        members = {name: best(runs) for name, runs in of.items() if runs}
        if members:
            seeds = tuple(run.seed for run in next(runs for runs in of.values() if runs))
            entries.append(Entry(kind, kind, members, seeds))
    return entries


def _play(
    description: DevicesBenchmark,
    entries: Sequence[Entry],
    judged: Sequence[Profile],
    folder: Path,
    progress: bool,
    workers: Workers,
) -> dict[str, dict[str, Played]]:
    """Return the held-out episodes of each entry on each of its devices."""

    def plays(entry: Entry, profile: Profile) -> list[Play]:
        shared: dict[str, Any] = {
            "episodes": description.episodes,
            "seed": description.seed,
            "duration": description.duration,
        }
        acting = profile if entry.gains is None else with_gains(profile, entry.gains)
        protocol = Protocol(acting, description.suite, "held-out", **shared, unit=profile)
        members = entry.members[profile.name]
        labels = [f"{entry.name}-seed-{seed}" for seed in entry.seeds] or [entry.name]
        place = folder / file_label(profile.name)
        pairs = zip(labels, members, strict=True)
        return [Play(place, file_label(label), protocol, member) for label, member in pairs]

    pairs = [(entry, profile) for profile in judged for entry in entries if profile.name in entry.members]
    play_ahead([play for pair in pairs for play in plays(*pair)], workers, "contenders", progress)
    found: dict[str, dict[str, Played]] = {entry.name: {} for entry in entries}
    with Progress(len(pairs), "contenders", "runs", progress) as bar:
        for entry, profile in pairs:
            found[entry.name][profile.name] = Played.of([play.run() for play in plays(entry, profile)])
            bar.update(note=f"{entry.name} on {profile.name}")
    return found


def _remember(path: Path, description: DevicesBenchmark, folder: Path, devices: str) -> None:
    """Store the description in its folder, or refuse a folder of another one, naming the differences."""
    files = {name: _recipe_file(entry, folder) for name, entry in description.learned.items()}
    content = json.loads(
        json.dumps({"format": "amulett-devices-benchmark", "version": 1, "recipes": files, "devices_sha256": devices})
    )
    content["description"] = description.model_dump(mode="json")
    if not path.exists():
        write_json(path, {**content, "amulett-gym": __version__})
        return
    stored = read_json(path, "benchmark")
    stored = {key: value for key, value in stored.items() if key != "amulett-gym"} if isinstance(stored, dict) else {}
    if changed := differences(stored, content):
        raise AmulettError(
            f"'{path.parent}' holds another benchmark: {'; '.join(changed[:8])}{'; ...' if len(changed) > 8 else ''}; "
            "choose another folder (runs of the same recipes can be used there by --runs)"
        )


def _recipe_file(entry: Learned, folder: Path) -> dict[str, Any]:
    return {} if entry.recipe is None else read_yaml(find_config(entry.recipe, "recipe", folder), "recipe")
