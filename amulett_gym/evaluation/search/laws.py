"""Tune laws and gains by differential evolution: searched on `train`, chosen on `validation`, never on `held-out`.

On the track *schedule* the cost of an episode is minus its return, on *full control* the full-control cost
(`metrics.control_prices`). Gains are tuned with a constant co-contraction.

A law can be tuned over a fleet of devices. Then the scenarios are dealt to its devices in turn, and all candidates of a
generation play the same pairs of device and scenario. The best start is chosen on the same fleet or another one.

`tune` searches from several independent starts, each with random candidates. What is finished in the folder is not
repeated: starts, and generations of a start. ``amulett tune-law`` is the command.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, differential_evolution

from amulett_gym import __version__
from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE, tension_to_action
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE, TRACKS, Track
from amulett_gym.errors import AmulettError, unknown, warn_deprecated
from amulett_gym.evaluation.metrics import COST_OF
from amulett_gym.evaluation.processes import advance, in_processes
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.gains import GAINS, SHAPE, Gains, gains_of, profile_text, shapes_of, shipped_text
from amulett_gym.evaluation.search.trials import Choose, Trials, held
from amulett_gym.fleet import in_words, load_fleet, name_or_contents, names_or_contents
from amulett_gym.gains import Following
from amulett_gym.laws.parametric import BEST_CONSTANT, DEFAULT_SUITE, FORMAT, LAWS, TUNED, Device, Law
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.progress import Progress
from amulett_gym.settings import merge, to_plain
from amulett_gym.simulation.layout import CONTROLS, LANES, LOOPS
from amulett_gym.storage.kept import digest, read_kept, write_kept
from amulett_gym.storage.writing import write_json, write_text

STAGES = ((14, 40), (42, 20))
"""Stages of a start, as in `Recipe`. The first, with few scenarios, finds the region; the second refines it."""

FLEET_STAGES = ((16, 40), (64, 20))
"""The same for a fleet, by its first 16 devices and by all: with other fleets, each device has as many scenarios."""

GAIN_STAGES = ((14, 120), (42, 60))
"""The same for gains: as many simulated episodes for each loop."""

GAIN_POPULATION = 24
"""Candidates in a generation of gains, in each loop."""

SPREAD = 4
"""Scenarios that are drawn for each training scenario of gains: enough for as many of each family."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """The settings of a tuning; the defaults gave the shipped parameters.

    Attributes
    ----------
    law, suite : str
        One of `parametric.LAWS`, or `gains.GAINS`.
    profile : str or dict, optional
        Anything that `load_profile` takes; kept as the name of a shipped profile, or else as the content. None: the
        testbed, or a fleet.
    seeds : tuple of int
        One for each independent start.
    population : int
        Candidates in a generation; 0: four, and two for each of the law's parameters, of a fleet as a multiple of
        `LANES`; `GAIN_POPULATION` of gains.
    generations : tuple of (int, int)
        Stages of a start: the number of training scenarios, and of generations on them; empty: `STAGES`,
        `FLEET_STAGES`, `GAIN_STAGES`.
    validation : int
        Validation scenarios, which choose among the starts.
    control : str
        The loop that plays.
    track : str, optional
        One of `envs.reward.TRACKS`, whose cost is minimised. None: *schedule* for a law in the paper's loop, else *full
        control*; this choice is kept as None.
    fleet : str or list, optional
        Devices instead of the profile, anything that `load_fleet` takes; kept as the name of a shipped fleet, or else
        as the content.
    choose_fleet : str or list, optional
        Devices whose validation scenarios choose among the starts. None: those of the fleet.

    Raises
    ------
    AmulettError
        If a name is unknown or a number out of its range.
    """

    law: str = "parametric"
    suite: str = "steps"
    profile: Any = None
    seeds: tuple[int, ...] = (1, 2)
    population: int = 0
    generations: tuple[tuple[int, int], ...] = ()
    validation: int = 200
    control: Any = "decentralized"
    track: Track | None = None
    fleet: Any = None
    choose_fleet: Any = None

    def __post_init__(self) -> None:
        if self.law not in (*LAWS, GAINS):
            raise unknown("law", self.law, (*LAWS, GAINS))
        if self.control not in (known := [name for name in CONTROLS if name != "position-only"]):
            raise unknown("control loop that takes a tension", self.control, known)
        if self.track is not None and self.track not in TRACKS:
            raise unknown("track", self.track, TRACKS)
        object.__setattr__(self, "track", None if self.track == self._usual_track() else self.track)
        self._read_devices()
        object.__setattr__(self, "seeds", tuple(self.seeds))
        stages = self.generations or self._usual_stages()
        object.__setattr__(self, "generations", tuple((count, number) for count, number in stages))
        own = GAIN_POPULATION if self.law == GAINS else 4 + 2 * len(self.space().parameters)
        if self.fleet is not None:
            own = -(-own // LANES) * LANES  # a block of devices has one profile
        object.__setattr__(self, "population", self.population or own)
        self.space()
        if self.population < 5:
            raise AmulettError(f"population is {self.population}; differential evolution needs at least 5")
        if not self.seeds or min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise AmulettError(f"seeds are {list(self.seeds)}; they have to differ and to be at least 0")
        counts = [self.validation, *(number for stage in self.generations for number in stage)]
        if not self.generations or min(counts) < 1:
            raise AmulettError("generations and validation have to be at least 1 each")
        if (count := len(self.stages()[0])) > 1 + self.generations[0][1]:
            raise AmulettError(
                f"the first stage has {self.generations[0][1]} generations; it needs at least {count - 1}, to try the "
                f"{count} shapes of the reference motion"
            )
        for split, episodes in (("train", self.scenarios), ("validation", self.validation)):
            self.protocol(split, episodes)  # names and numbers are checked there

    def _read_devices(self) -> None:
        """Replace names, files and profiles by what is kept."""
        if self.fleet is None and self.choose_fleet is not None:
            raise AmulettError("choose_fleet is for laws that are tuned over a fleet; give fleet, too")
        if self.fleet is None:
            profile = load_profile("testbed" if self.profile is None else self.profile)
            object.__setattr__(self, "profile", names_or_contents([profile])[0])
            return
        if self.profile is not None:
            raise AmulettError("profile and fleet are both given; give one of them")
        if self.law == GAINS:
            raise AmulettError("gains are tuned for one device; give profile instead of fleet, or tune a law")
        for key in ("fleet", "choose_fleet"):
            if (fleet := getattr(self, key)) is not None:
                object.__setattr__(self, key, name_or_contents(load_fleet(fleet)))

    def _usual_stages(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the default stages."""
        if self.fleet is None:
            return GAIN_STAGES if self.law == GAINS else STAGES
        (few, more), (many, fewer) = FLEET_STAGES
        devices = len(load_fleet(self.fleet))
        every = -(-many // devices) * devices
        return (min(few, devices) * max(few // devices, 1), more), (every, fewer)

    @property
    def cost_track(self) -> Track:
        """The track whose cost is minimised."""
        return self.track or self._usual_track()

    def _usual_track(self) -> Track:
        return FULL_CONTROL if self.law == GAINS or self.control in LOOPS else SCHEDULE

    @property
    def scenarios(self) -> int:
        """Number of training scenarios."""
        return max(scenarios for scenarios, _ in self.generations)

    @property
    def episodes(self) -> int:
        """Simulated training episodes of all starts."""
        return len(self.seeds) * sum(self.calls())

    @property
    def judging(self) -> int:
        """Simulated episodes that judge what each start found, on all its training and validation scenarios."""
        return len(self.seeds) * (self.scenarios + self.validation)

    def calls(self) -> list[int]:
        """Return the simulated episodes of a start's generations, one after the other."""
        stages = [[self.population * scenarios] * (1 + number) for scenarios, number in self.generations]
        return [episodes for stage in stages for episodes in stage]

    def stages(self) -> tuple[tuple[str, ...], tuple[int, int] | tuple[()], list[tuple[int, int]]]:
        """Return how a start divides its generations where the loop's reference motion has a shape.

        Returns
        -------
        shapes : tuple of str
            The shapes; none where there is nothing to choose.
        tries : (int, int) or empty
            Scenarios and generations of a search in each shape, as in `generations`: together half of the first stage.
        stages : list of (int, int)
            Stages that follow, in the shape with the least cost.
        """
        shapes = shapes_of(self.control) if self.law == GAINS else ()
        (scenarios, number), *others = self.generations
        if not shapes:
            return shapes, (), [*self.generations]
        each = max(1, (1 + number) // (2 * len(shapes)))  # the first population counts as a generation
        rest = 1 + number - len(shapes) * each
        return shapes, (scenarios, each - 1), [*([(scenarios, rest - 1)] if rest else []), *others]

    def within(self, budget: int) -> Recipe:
        """Return this recipe with as many generations of the usual stages, about in proportion, as `budget` allows.

        Raises
        ------
        AmulettError
            If the budget is too small for one generation of each.
        """
        (few, more), (many, fewer) = STAGES if self.fleet is None else self._usual_stages()
        ratio, once = more // fewer, len(self.seeds) * self.population
        each = budget // once - few - many
        number, rest = divmod(each, ratio * few + many)
        if number < 1:
            raise AmulettError(
                f"a budget of {budget} simulated episodes is too small: {len(self.seeds)} times {self.population} "
                f"candidates need at least {once * ((1 + ratio) * few + 2 * many)}"
            )
        return replace(self, generations=((few, ratio * number + rest // few), (many, number)))

    def space(self) -> Law | Gains:
        """Return what is tuned."""
        if self.law == GAINS:
            return gains_of(self.control, self.device())
        return LAWS[self.law].over(FEED_FORWARD_RANGE if self.control in LOOPS else TENSION_RANGE)

    def trials(self) -> tuple[Trials, Trials]:
        """Return the training and the validation scenarios; for gains, each family has as many training scenarios."""
        drawn = SPREAD * self.scenarios if self.law == GAINS else self.scenarios
        own = () if self.fleet is None else load_fleet(self.fleet)
        other = own if self.choose_fleet is None else load_fleet(self.choose_fleet)
        train, validation = (
            Trials(self.protocol(split, count), self.control, track=self.cost_track, fleet=fleet)
            for split, count, fleet in (("train", drawn, own), ("validation", self.validation, other))
        )
        return train.balanced(self.scenarios) if self.law == GAINS else train, validation

    def protocol(self, split: str, episodes: int) -> Protocol:
        """Return the scenarios of a split."""
        return Protocol(self.device(), self.suite, split, episodes=episodes)

    def device(self) -> Profile:
        """Return the profile, or the first one of the fleet."""
        return load_profile(self.profile) if self.fleet is None else load_fleet(self.fleet)[0]


Report = Callable[[int, Mapping[str, Any]], None]


def result_path(folder: str | Path, recipe: Recipe) -> Path:
    """Return the file of the result in a folder."""
    return Path(folder) / f"{_name(recipe)}.json"


def _name(recipe: Recipe) -> str:
    loop = f"{recipe.control}-" if recipe.control in LOOPS or recipe.law == GAINS else ""
    return f"{loop}{recipe.law}-{recipe.suite}"


def tune(
    folder: str | Path,
    recipe: Recipe,
    report: Report = lambda seed, start: None,
    begin: Callable[[int], object] = lambda done: None,
    progress: bool = False,
) -> dict[str, Any]:
    """Tune a law or gains, write `result_path` and ``stages/``, and return the file's content.

    The file of a law is a contender; for gains there is `profile_path`, too. The parameters are those of the start with
    the lowest cost on `validation`.

    Parameters
    ----------
    folder : str or Path
    recipe : Recipe
    report : callable
        Called with the seed and result of each finished start.
    begin : callable
        Called first, with the number of episodes that an earlier run in the folder has simulated.
    progress : bool
        Whether to show progress on stderr.

    Raises
    ------
    AmulettError
        If a file cannot be read or written.
    """
    (content,) = tune_all(folder, [recipe], lambda recipe, seed, start: report(seed, start), begin, progress)
    return content


def tune_all(
    folder: str | Path,
    recipes: Sequence[Recipe],
    report: Callable[[Recipe, int, Mapping[str, Any]], None] = lambda recipe, seed, start: None,
    begin: Callable[[int], object] = lambda done: None,
    progress: bool = False,
    processes: int = 1,
) -> list[dict[str, Any]]:
    """Tune by several recipes of different loops, as in `tune`; `profile_path` then holds the gains of all loops.

    `report` is also called with the recipe. Starts are searched in parallel in `processes`; this changes no result.
    """
    starts = [start for recipe in recipes for start in _starts(folder, recipe)]
    done = sum(start.done for start in starts)
    total = sum(recipe.episodes + recipe.judging for recipe in recipes)
    begin(done)
    with Progress(total, "tune-law", "episodes", progress, done) as bar:
        missing = {index: start for index, start in enumerate(starts) if not start.result}
        searched: Iterable[tuple[int, dict[str, Any]]]
        if processes == 1 or len(missing) < 2:
            searched = ((index, start.finish(bar.update)) for index, start in missing.items())
        else:
            calls = {index: (folder, start.recipe, start.seed) for index, start in missing.items()}
            searched = in_processes(_finish, calls, processes, bar.update)
        for start in starts:
            if start.result:
                report(start.recipe, start.seed, start.result)
        for index, result in searched:
            starts[index].result = result
            report(starts[index].recipe, starts[index].seed, result)
    contents, changes = [], dict[str, Any]()
    for recipe in recipes:
        content = _content(recipe, [start for start in starts if start.recipe is recipe])
        write_json(result_path(folder, recipe), content)
        contents.append(content)
        if recipe.law == GAINS:
            changes = merge(changes, _changes(recipe, content))
            write_text(profile_path(folder), profile_text(recipe.device(), changes))
    return contents


def _starts(folder: str | Path, recipe: Recipe) -> list[_Start]:
    trials = recipe.trials()
    return [_Start(folder, recipe, seed, *trials) for seed in recipe.seeds]


def _finish(folder: str | Path, recipe: Recipe, seed: int) -> dict[str, Any]:
    """Finish a start in a process of its own."""
    return _Start(folder, recipe, seed, *recipe.trials()).finish(advance)


def profile_path(folder: str | Path) -> Path:
    """Return the file of the profile with tuned gains in a folder."""
    return Path(folder) / "profile.yaml"


def _changes(recipe: Recipe, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a profile's groups with tuned gains and their source."""
    found, profile = content["parameters"], recipe.device()
    space = gains_of(recipe.control, profile, found[SHAPE]["value"] if shapes_of(recipe.control) else "")
    vector = np.array([float(f"{found[gain.name]['value']:.6g}") for gain in space.parameters])
    source = (
        f"identified: tuned on train of {recipe.suite}, {recipe.episodes} simulated episodes, with a constant of "
        f"{vector[-1]:.3g} N: amulett tune-law {GAINS} --control {recipe.control} --suite {recipe.suite}"
        + (f" --track {recipe.track}" if recipe.track else "")
    )
    return space.changes(profile, vector, source)


def at_ends(recipe: Recipe, content: Mapping[str, Any]) -> list[str]:
    """Return the parameters of a result that are within 2 % of an end of their range in the search."""
    space = recipe.space()
    vector = np.array([content["parameters"][parameter.name]["value"] for parameter in space.parameters])
    near = np.abs(space.to_unit(vector) - 0.5) > 0.48
    return [parameter.name for parameter, end in zip(space.parameters, near, strict=True) if end]


def check_shippable(recipe: Recipe) -> None:
    """Refuse a recipe whose result cannot be one of the package's tuned laws."""
    if not isinstance(recipe.profile or recipe.fleet, str):
        other = f"on {recipe.device().name}" if recipe.fleet is None else f"over {in_words(recipe.fleet)} of your own"
        raise AmulettError(f"only laws tuned on a shipped device or fleet can be put into the package, not {other}")
    if recipe.fleet is not None and recipe.suite != DEFAULT_SUITE:
        raise AmulettError(f"laws tuned over a fleet can be put into the package for the suite {DEFAULT_SUITE} only")
    if recipe.law == BEST_CONSTANT.name:
        raise AmulettError("the package has no tuned constant: name it, for example constant:6")
    if recipe.law == GAINS and recipe.control not in LOOPS:
        raise AmulettError("the gains of the paper's loop stay as they are in the package")
    if recipe.track:
        raise AmulettError(f"the package has nothing that is tuned for the track '{recipe.track}' in this way")
    if recipe.law != GAINS and recipe.control in LOOPS:
        raise AmulettError(f"the package has tuned laws of the paper's loop only, not of '{recipe.control}'")


def ship(recipe: Recipe, content: Mapping[str, Any]) -> Path:
    """Put a law, or gains into their profile, into the package instead of the present ones; return the file."""
    check_shippable(recipe)
    with resources.as_file(resources.files("amulett_gym")) as package:
        if recipe.law == GAINS:
            path = package / "profiles" / f"{recipe.profile}.yaml"
            text = shipped_text(path.read_text("utf-8"), _changes(recipe, content)["loops"])
            write_text(path, text)
        else:
            path = result_path(package.joinpath(*TUNED, recipe.profile or recipe.fleet), recipe)
            write_json(path, content)
    return path


@dataclass
class _Start:
    """One independent search, kept in a file: its result, or the costs of its generations until then."""

    folder: str | Path
    recipe: Recipe
    seed: int
    train: Trials
    validation: Trials
    known: list[list[float]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.path = Path(self.folder) / "stages" / f"{_name(self.recipe)}-{self.seed}.json"
        self.inputs = _inputs(self.recipe, self.seed, self.train, self.validation)
        found = read_kept(self.path, self.inputs)
        if isinstance(found, dict) and "parameters" in found:
            self.result = found
        elif isinstance(found, dict) and _fits(found.get("costs"), self.recipe):
            self.known = found["costs"]

    @property
    def done(self) -> int:
        """Episodes that were simulated until now."""
        if self.result:
            return (self.recipe.episodes + self.recipe.judging) // len(self.recipe.seeds)
        return sum(self.recipe.calls()[: len(self.known)])

    def finish(self, advance: Callable[[int], object]) -> dict[str, Any]:
        """Search on, keep every generation, and return the result; `advance` is called with simulated episodes."""

        def keep(costs: Values) -> None:
            advance(self.recipe.calls()[len(self.known)])
            self.known.append(costs.tolist())
            write_kept(self.path, self.inputs, {"costs": self.known})

        self.result = search(self.recipe, self.seed, self.train, self.validation, tuple(self.known), keep)
        advance(self.recipe.judging // len(self.recipe.seeds))
        write_kept(self.path, self.inputs, self.result)
        return self.result


def _fits(costs: Any, recipe: Recipe) -> bool:
    """Return whether kept costs are those of generations."""
    try:
        return np.shape(costs)[1:] == (recipe.population,) and bool(np.isfinite(costs).all())
    except (TypeError, ValueError):
        return False


def search(
    recipe: Recipe,
    seed: int,
    train: Trials,
    validation: Trials,
    known: Sequence[Sequence[float]] = (),
    keep: Callable[[Values], object] = lambda costs: None,
) -> dict[str, Any]:
    """Return the result of a search from one start.

    Parameters
    ----------
    known : sequence
        Costs of the first generations from an earlier run of the same search; they are not simulated again.
    keep : callable
        Called with the costs of each generation that was simulated.

    Returns
    -------
    dict
        ``parameters`` (a list), the mean cost on ``train`` (all its scenarios) and ``validation``, and ``history``:
        pairs of the number of simulated episodes and the least cost found so far on the stage's own scenarios. For
        gains with a reference motion also ``reference``, its shape, and ``reached``: the least cost in each shape when
        it was chosen, on the first stage's scenarios.
    """
    law = recipe.space()
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(recipe.population, len(law.parameters)))
    points[0] = law.to_unit(law.start())
    history: list[list[float]] = []
    episodes = 0

    def evolve(law: Law | Gains, points: Values, scenarios: int, generations: int) -> OptimizeResult:
        least = np.inf

        def value(columns: Values) -> Values:
            nonlocal episodes, least
            if len(history) < len(known):
                costs = np.array(known[len(history)])
            else:
                costs = mean_costs(law, law.from_unit(columns.T), train, np.arange(scenarios), recipe.cost_track)
                keep(costs)
            episodes += costs.size * scenarios
            least = min(least, float(costs.min()))
            history.append([episodes, least])
            return costs

        bounds, batch = [(0.0, 1.0)] * len(law.parameters), {"vectorized": True, "updating": "deferred"}
        evolution = {"mutation": (0.4, 0.9), "recombination": 0.9, "tol": 0.0, "atol": 0.0, "polish": False}
        how = {**batch, **evolution, "maxiter": generations}
        return differential_evolution(value, bounds, init=points, seed=rng, **how)

    shapes, tries, stages = recipe.stages()
    reached: dict[str, float] = {}
    if isinstance(law, Gains) and tries:
        spaces = [replace(law, reference=shape) for shape in shapes]
        found = [evolve(space, points, *tries) for space in spaces]
        reached = {shape: float(one.fun) for shape, one in zip(shapes, found, strict=True)}
        chosen = int(np.argmin(list(reached.values())))
        law, points, best = spaces[chosen], found[chosen].population, found[chosen].x
    for scenarios, generations in stages:
        last = evolve(law, points, scenarios, generations)
        points, best = last.population, last.x
    vector = law.from_unit(best)

    def cost(trials: Trials) -> float:
        return float(mean_costs(law, vector[None], trials, np.arange(len(trials.rows)), recipe.cost_track)[0])

    result = {"parameters": vector.tolist(), "train": cost(train), "validation": cost(validation), "history": history}
    return {**result, **({SHAPE: law.reference, "reached": reached} if isinstance(law, Gains) and reached else {})}


def mean_costs(
    space: Law | Gains, vectors: Values, trials: Trials, scenarios: NDArray[np.int64], track: Track = SCHEDULE
) -> Values:
    """Return the mean cost on a track of each parameter vector, shape (candidates, parameters), over the scenarios."""
    if isinstance(space, Gains):  # all devices of a batch share their gains
        tensions = [held(np.full(scenarios.size, vector[-1]), trials.tension_range) for vector in vectors]
        devices = [space.profile(trials.protocol.profile, vector) for vector in vectors]
        pairs = zip(tensions, devices, strict=True)
        return np.array([trials.costs(scenarios, *each, track).mean() for each in pairs])
    candidates = len(vectors)
    each, rows = np.repeat(vectors, scenarios.size, axis=0), np.tile(scenarios, candidates)
    found = trials.costs(rows, following(space, each, trials, rows), track=track)
    return found.reshape(candidates, scenarios.size).mean(axis=1)


def following(law: Law, vectors: Values, trials: Trials, scenarios: NDArray[np.int64] | None = None) -> Choose:
    """Return a law with parameters for each episode, shape (N, parameters); one row is for all.

    `scenarios` are those that are played, shape (N,); only a fleet needs them.
    """
    which = np.zeros(1, dtype=np.int64) if scenarios is None else trials.which[scenarios]
    device = Device.of_each(trials.profiles, which, trials.protocol.agent_period)

    def choose(step: int, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        tensions = law.tensions(observations, vectors, device, trials.tension_range)
        return tension_to_action(tensions, trials.tension_range).astype(np.float32)

    return choose


def _content(recipe: Recipe, searched: Sequence[_Start]) -> dict[str, Any]:
    starts = {start.seed: start.result for start in searched}
    train = searched[0].train
    validation = searched[0].validation
    law, loop = recipe.space(), recipe.control in LOOPS or recipe.law == GAINS
    chosen = min(starts, key=lambda seed: starts[seed]["validation"])
    described = {}
    for parameter, value in zip(law.parameters, starts[chosen]["parameters"], strict=True):
        described[parameter.name] = {"value": value, "unit": parameter.unit, "meaning": parameter.meaning}
    if shape := starts[chosen].get(SHAPE):
        meaning = Following.model_fields[SHAPE].description
        described = {SHAPE: {"value": shape, "unit": "1", "meaning": meaning}, **described}
    shown = ("train", "validation", SHAPE, "reached")
    return {
        "format": FORMAT,
        "version": 1,
        "parameters": described,
        "recipe": {key: value for key, value in _described(recipe).items() if loop or key != "control"},
        **({"cost": COST_OF[recipe.cost_track]} if loop or recipe.track else {}),
        "chosen_seed": chosen,
        "training_episodes": recipe.episodes,
        "starts": {str(seed): {key: start[key] for key in shown if key in start} for seed, start in starts.items()},
        "sha256": {"train": train.digest(), "validation": validation.digest()},
        "versions": {"amulett-gym": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
    }


def _described(recipe: Recipe) -> dict[str, Any]:
    """Return a recipe as plain data without what is None, as in older files."""
    return {key: value for key, value in to_plain(asdict(recipe)).items() if value is not None}


def _inputs(recipe: Recipe, seed: int, train: Trials, validation: Trials) -> dict[str, Any]:
    """Return all that a start's result depends on."""
    this = _described(replace(recipe, seeds=(seed,)))
    for key in {"profile", "fleet", "choose_fleet"} & this.keys():  # their content is part of the scenarios' digests
        this[key] = recipe.device().name if key == "profile" else _fleet_name(this[key])
    law = [asdict(parameter) for parameter in recipe.space().parameters]
    scenarios = [train.digest(), validation.digest()]
    long = {"recipe": this, "law": law, "scenarios": scenarios, "scipy": scipy.__version__}
    if shapes := recipe.stages()[0]:
        long["shapes"] = shapes
    return {"recipe": this, "sha256": digest(long)}


def _fleet_name(fleet: str | list[Any]) -> str | list[str]:
    return fleet if isinstance(fleet, str) else [profile.name for profile in load_fleet(fleet)]


def main(argv: Sequence[str] | None = None) -> None:
    """Run the deprecated command."""
    parser = argparse.ArgumentParser(description="Deprecated: use amulett tune-law.")
    parser.add_argument("--law", nargs="+", default=["eq6-tuned", "parametric"], choices=list(LAWS))
    parser.add_argument("--suite", nargs="+", default=["steps"])
    parser.add_argument("--profile", default="testbed")
    parser.add_argument("--out", required=True, metavar="DIR")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(Recipe.seeds))
    arguments = parser.parse_args(argv)
    warn_deprecated("python -m amulett_gym.evaluation.search.laws is deprecated: use amulett tune-law")
    for suite in arguments.suite:
        for law in arguments.law:
            recipe = Recipe(law, suite, arguments.profile, tuple(arguments.seeds))
            folder = Path(arguments.out) / recipe.device().name
            tune(folder, recipe, progress=True)
            print(f"Written: {result_path(folder, recipe)}")


if __name__ == "__main__":
    main()
