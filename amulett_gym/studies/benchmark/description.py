"""The description of a benchmark as data; the defaults are those of ``configs/benchmark.yaml``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Field, ValidationError, field_validator, model_validator

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.reward import COST_TERMS, FULL_CONTROL, SCHEDULE
from amulett_gym.envs.settings import ControlLoop, CostTrack
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.evaluation.runner import MOST_EPISODES
from amulett_gym.laws.contenders import CONSTANT, contender_names, split_loop
from amulett_gym.laws.parametric import LAWS
from amulett_gym.learning import load_learning
from amulett_gym.profile import Positive, Profile, load_profile
from amulett_gym.settings import Group, configs_folder, describe, find_config
from amulett_gym.simulation.layout import CONTROLS, LOOPS, Control, unfit_loops
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.tasks.names import check_suite

PAPER_STEP = "paper-step"
"""A suite of one scenario and its noise; it has no shifted split of its own."""

Split = Literal["held-out", "shifted"]

Altered = Literal["noise-x2", "wrong-parameters"]
"""Changes of all held-out scenarios of the headline suite; see `altered`."""

AUTO = "auto"
"""As `best_learned`: what is learned in the loop of the best constant."""

PAPERS: Control = CONTROLS[0]
"""The paper's loop; contenders in it are named without a loop."""


class Learned(Group):
    """Training runs of one recipe, which differ by their seeds."""

    recipe: str | None = Field(
        default=None, description="YAML file in the description's folder; null: the default recipe"
    )
    set: list[str] = Field(default=[], description="changes of the recipe, like 'env.suite=mixed'")
    seeds: list[int] = Field(min_length=1, max_length=1000, description="training seeds, one run each")
    loops: Literal["all"] | list[ControlLoop] = Field(
        default=[],
        description="full-control only: loops in which it is learned, one entry each, with the whole range of the "
        "loop's tension; all: those of the benchmark; none: as the recipe says",
    )
    best_loop_seeds: list[int] = Field(
        default=[], max_length=1000, description="further training seeds in the loop of the best constant"
    )
    reference: bool = Field(default=False, description="observes what no device can measure: a reference, no contender")

    @field_validator("seeds", "best_loop_seeds")
    @classmethod
    def _check_seeds(cls, seeds: list[int]) -> list[int]:
        if min(seeds, default=0) < 0 or len({*seeds}) < len(seeds):
            raise ValueError("seeds have to differ and to be at least 0")
        return seeds


class Clairvoyant(Group):
    """The search for each scenario's best schedule with the future known."""

    scenarios: dict[str, int] = Field(
        default={"mixed": 50, "steps": 10, "reach": 10, "track": 10, "contact": 10, "hold-push": 10},
        description="suite -> number of its first held-out scenarios that are searched",
    )
    check: int = Field(
        default=10, ge=0, le=MOST_EPISODES, description="headline scenarios that are searched again, longer [scenarios]"
    )
    draws: int = Field(
        default=8, ge=0, le=64, description="noise draws of the headline suite's foresight reference; 0: none [1]"
    )
    effort: Positive = Field(default=1.0, le=10, description="factor of the number of search rounds [1]")
    starts: list[str] = Field(
        default=["eq6-tuned", "parametric"], description="laws from which the search starts as well"
    )

    @field_validator("scenarios")
    @classmethod
    def _check_scenarios(cls, scenarios: dict[str, int]) -> dict[str, int]:
        for suite, count in scenarios.items():
            check_suite(suite)
            if count < 2:
                raise ValueError(f"{suite} is given {count} scenarios; an interval needs at least 2")
        return scenarios


class Bootstrap(Group):
    """Settings of the bootstrap intervals."""

    resamples: int = Field(default=4000, ge=100, le=100_000, description="number of bootstrap draws [1]")
    seed: int = Field(default=0, ge=0, lt=2**63, description="seed of the bootstrap draws [1]")


class Benchmark(Group):
    """A benchmark."""

    track: CostTrack = Field(
        default=SCHEDULE, description="what is compared: laws in the paper's loop (schedule), or in all (full-control)"
    )
    loops: list[ControlLoop] = Field(
        default=[], description="control loops in which laws are compared; none: all that take a tension, of the track"
    )
    profile: str = Field(default="testbed", description="a shipped profile, or a YAML file in the description's folder")
    suites: list[str] = Field(
        default=["mixed", "steps", "reach", "track", "pick-place", "contact", "hold-push", "payload", PAPER_STEP],
        min_length=1,
        description="suites on which all contenders are evaluated",
    )
    headline: str = Field(default="mixed", description="suite by which constants are chosen and claims are judged")
    splits: list[Split] = Field(default=["held-out", "shifted"], min_length=1, description="splits of each suite")
    altered: list[Altered] = Field(
        default=[],
        description="full-control only: also with the headline's held-out scenarios changed in one way: twice the "
        "sensor noise, or springs, inertia and damping 20 % off",
    )
    episodes: int = Field(
        default=500, ge=2, le=MOST_EPISODES, description="scenarios of each suite and split [scenarios]"
    )
    seed: int = Field(default=20_000, ge=0, lt=2**63, description="seed of the first scenario [1]")
    duration: Positive = Field(default=10.0, le=1000, description="duration of an episode [s]")
    contenders: list[str] = Field(
        default=["position-only", "eq6", "eq6-printed", "eq6-tuned", "parametric"],
        description="laws or policy bundles to compare",
    )
    tuned_budget: dict[str, Annotated[int, Field(ge=1)]] = Field(
        default={}, description="law that is tuned in each loop -> simulated episodes, the same for each loop"
    )
    constants: list[float] = Field(
        default=[4.0, 4.5, 5.0, 5.25, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0],
        min_length=1,
        description="constant tensions, each in the loops whose range holds it; the best are chosen on train [N]",
    )
    learned: dict[str, Learned] = Field(
        default={
            "ppo": Learned(recipe="ppo.yaml", seeds=list(range(10))),
            "sac": Learned(recipe="sac.yaml", seeds=[0, 1, 2]),
            "ppo-history": Learned(recipe="ppo-history.yaml", seeds=[0, 1, 2]),
            "causal": Learned(recipe="causal.yaml", seeds=[0, 1, 2], reference=True),
        },
        description="name of a learned entry -> its training runs",
    )
    best_learned: str | None = Field(
        default="ppo",
        description="the entry that the claims are about; full-control only: auto, in the loop of the best constant, "
        "or null: none",
    )
    ablations: list[str] = Field(
        default=list(COST_TERMS), description="reward terms left out, one at a time, in further trainings of that entry"
    )
    clairvoyant: Clairvoyant = Field(default=Clairvoyant(), description="search for schedules with the future known")
    optimal: int = Field(
        default=0, ge=0, le=MOST_EPISODES, description="first headline scenarios solved by optimal control [scenarios]"
    )
    bootstrap: Bootstrap = Field(default=Bootstrap(), description="bootstrap of the intervals")

    @model_validator(mode="before")
    @classmethod
    def _choose_loops(cls, given: Any) -> Any:
        if not isinstance(given, Mapping) or given.get("track") != FULL_CONTROL:
            return given
        loops = given.get("loops") or [PAPERS, *LOOPS]
        learned = given.get("learned")
        return {**given, "loops": loops, **({"learned": _by_loop(learned, loops)} if learned else {})}

    @model_validator(mode="after")
    def _check_track(self) -> Benchmark:
        if self.track == SCHEDULE:
            for key in ("loops", "tuned_budget", "optimal", "altered"):
                if getattr(self, key):
                    raise ValueError(f"'{key}' is of the track {FULL_CONTROL}; the track is {SCHEDULE}")
            for name, entry in self.learned.items():
                for key in ("loops", "best_loop_seeds"):
                    if getattr(entry, key):
                        raise ValueError(
                            f"learned.{name}.{key} is of the track {FULL_CONTROL}; the track is {SCHEDULE}"
                        )
        elif PAPERS not in self.loops or "position-only" in self.loops:
            raise ValueError(f"'loops' has to hold {PAPERS}, in which the baseline acts, and none without a tension")
        for name, entry in self.learned.items():
            if entry.loops:
                raise ValueError(f"learned.{name}.loops is {entry.loops}; it has to be all, or some of 'loops'")
        for law in self.tuned_budget:
            if law not in LAWS:
                raise unknown("law that can be tuned", law, LAWS)
            if law in self.contenders:
                raise ValueError(f"'{law}' is tuned in each loop (tuned_budget), and named in 'contenders', too")
        if self.optimal > self.episodes or self.optimal == 1:
            raise ValueError(f"optimal is {self.optimal}; it has to be 0, or from 2 to episodes, {self.episodes}")
        return self

    @model_validator(mode="after")
    def _check(self) -> Benchmark:
        for suite in (*self.suites, self.headline):
            check_suite(suite)
        for key in ("loops", "suites", "splits", "altered", "contenders", "constants", "ablations"):
            values = getattr(self, key)
            if len(set(values)) < len(values):
                raise ValueError(f"'{key}' names something twice")
        if "held-out" not in self.splits:
            raise ValueError("'splits' has to hold held-out, on which claims are judged")
        if self.headline not in self.suites:
            raise ValueError(f"headline is '{self.headline}', which is none of the suites")
        for tension in self.constants:
            if not any(_holds(loop, tension) for loop in self.loops or [PAPERS]):
                low, high = map(min, zip(*map(_range, self.loops or [PAPERS]), strict=True))
                raise ValueError(f"'constants' holds {tension} N; the default actions reach from {low:g} to {high:g} N")
        for name in self.learned:
            loop, own = split_loop(name)
            if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", own) or own in contender_names():
                raise ValueError(f"'{name}' cannot be a learned entry's name: use up to 40 letters, digits and dashes")
            if loop and self.track == SCHEDULE:
                raise ValueError(f"learned entry '{name}' is in another loop; the track is {SCHEDULE}")
        if self.best_learned == AUTO:
            if self.learned and (self.track == SCHEDULE or self.ablations):
                raise ValueError("best_learned is 'auto'; this is for the track full-control, without ablations")
        elif self.best_learned is None:
            if self.track == SCHEDULE or self.ablations:
                raise ValueError("best_learned is null; this is for the track full-control, without ablations")
        elif self.learned and self.best_learned not in self.learned:
            raise unknown("learned entry", self.best_learned, self.learned)
        elif self.learned and self.learned[self.best_learned].reference:
            raise ValueError(f"best_learned is '{self.best_learned}', which is a reference and no contender")
        for term in self.ablations:
            if term not in COST_TERMS:
                raise unknown("reward term", term, COST_TERMS)
        for suite, count in self.clairvoyant.scenarios.items():
            if suite not in self.suites or count > self.episodes:
                raise ValueError(
                    f"clairvoyant.scenarios names {count} of {suite}; it has to be one of the suites, and at most "
                    f"episodes, {self.episodes}"
                )
        return self

    def places(self) -> list[tuple[str, str]]:
        """Return the pairs of suite and split that contenders are judged on."""
        pairs: list[tuple[str, str]] = [(suite, split) for split in self.splits for suite in self.suites]
        pairs += [(self.headline, change) for change in self.altered]
        return [pair for pair in pairs if pair != (PAPER_STEP, "shifted")]

    def in_best_loop(self, loop: str, trained: Mapping[str, str]) -> Benchmark:
        """Return the description with what depends on the loop of the best constant, which is known only later.

        These are the further seeds of what is learned there, and `best_learned` if it is auto: what is learned there,
        first of all an entry with such seeds; None if nothing is. `trained` is the loop of each learned entry, by its
        recipe (`runs.trained_loops`): a name without a loop does not show that the entry acts in `Amulett/Drives-v0`.
        """
        there = [name for name in self.learned if trained[name] == loop and not self.learned[name].reference]
        more = [name for name in there if self.learned[name].best_loop_seeds]
        learned = dict(self.learned)
        for name in more:
            seeds = [*dict.fromkeys([*learned[name].seeds, *learned[name].best_loop_seeds])]
            learned[name] = learned[name].model_copy(update={"seeds": seeds})
        learned = {name: entry.model_copy(update={"best_loop_seeds": []}) for name, entry in learned.items()}
        best = self.best_learned
        if best == AUTO and self.learned:
            best = next(iter([*more, *there]), None)
        return self.model_copy(update={"learned": learned, "best_learned": best})

    def constant_names(self) -> list[str]:
        """Return the constants' names as contenders, loop by loop."""
        return [
            named(loop, f"{CONSTANT}{tension:g}")
            for loop in self.loops or [PAPERS]
            for tension in self.constants
            if _holds(loop, tension)
        ]

    def law_names(self) -> list[str]:
        """Return the laws' names as contenders, loop by loop; those that name a loop themselves are in no other."""
        own = [name for name in self.contenders if split_loop(name)[0] or name == "position-only"]
        laws = [named(loop, name) for loop in self.loops or [PAPERS] for name in self.contenders if name not in own]
        return [*own, *laws]


def named(loop: str, law: str) -> str:
    """Return a contender's name by its loop and law."""
    return law if loop == PAPERS else f"{loop}/{law}"


def loop_of(name: str) -> Control:
    """Return the loop of a contender's name."""
    return cast(Control, split_loop(name)[0] or PAPERS)


def _by_loop(learned: Any, loops: Sequence[Any]) -> Any:
    """Return learned entries, those with `loops` once in each of them; what is wrong stays as it is."""
    if not isinstance(learned, Mapping):
        return learned
    spread: dict[str, Any] = {}
    for name, entry in learned.items():
        own = dict(entry) if isinstance(entry, Mapping) else entry.model_dump() if isinstance(entry, Learned) else {}
        chosen = loops if own.get("loops") == "all" else own.get("loops") or []
        if not chosen or not isinstance(chosen, list) or any(loop not in loops for loop in chosen):
            new = {name: entry}
        else:
            new = {
                named(loop, name): {**own, "loops": [], "set": [*_changes(loop), *(own.get("set") or [])]}
                for loop in chosen
            }
        for each in new:
            if each in spread:
                raise ValueError(f"two learned entries would be called '{each}'; give one of them another name")
        spread |= new
    return spread


def _changes(loop: Control) -> list[str]:
    """Return the changes of a recipe that is learned in a loop."""
    return [f"env.control={loop}", f"env.track={FULL_CONTROL}", f"env.tension_range={[*_range(loop)]}"]


def _range(loop: Control) -> tuple[float, float]:
    return FEED_FORWARD_RANGE if loop in LOOPS else TENSION_RANGE


def _holds(loop: Control, tension: float) -> bool:
    low, high = _range(loop)
    return low <= tension <= high


QUICK_EPISODES, QUICK_SEEDS, QUICK_STEPS, QUICK_BUDGET = 20, 2, 131_072, 12_000


def quick(description: Benchmark) -> Benchmark:
    """Return a small benchmark of the same parts, minutes of CPU time, as a test of the installation.

    The headline suite, `contact`, `hold-push` and `paper-step`, few scenarios, every fourth constant, two seeds of
    short training of the entry that the claims are about, no ablations, a shallow search. On *full control* the paper's
    loop, that of this entry, and one more, with short tuning, and no optimal control; if the best loop is not known,
    all that is learned in these loops, with one seed, and one more in the best. Claims are not judged by it.
    """
    wanted = (description.headline, "contact", "hold-push", PAPER_STEP)
    best = description.best_learned
    auto = best is None or best == AUTO
    loops = [*([] if best is None or best == AUTO else [loop_of(best)]), *LOOPS]
    loops = [PAPERS, *[loop for loop in dict.fromkeys(loops) if loop in description.loops and loop != PAPERS][:2]]
    learned = {}
    for name, entry in description.learned.items():
        if (loop_of(name) in loops) if auto else (name == best):
            short = [
                f"total_steps={QUICK_STEPS}",
                f"validation.every_steps={QUICK_STEPS // 2}",
                "ppo.critic_steps=null",
            ]
            seeds = entry.seeds[: 1 if auto else QUICK_SEEDS]
            more = {"seeds": seeds, "best_loop_seeds": entry.best_loop_seeds[:2], "set": [*entry.set, *short]}
            learned[name] = entry.model_copy(update=more)
    return Benchmark.model_validate(
        {
            **description.model_dump(),
            "loops": loops if description.loops else [],
            "tuned_budget": {law: min(budget, QUICK_BUDGET) for law, budget in description.tuned_budget.items()},
            "optimal": 0,
            "suites": [suite for suite in description.suites if suite in wanted],
            "episodes": min(description.episodes, QUICK_EPISODES),
            "constants": description.constants[::4],
            "learned": {name: entry.model_dump() for name, entry in learned.items()},
            "ablations": [],
            "clairvoyant": {
                "scenarios": {description.headline: 4},
                "check": 2,
                "draws": min(description.clairvoyant.draws, 2),
                "effort": 0.1,
                "starts": description.clairvoyant.starts,
            },
            "bootstrap": {"resamples": min(description.bootstrap.resamples, 1000)},
        }
    )


def load_benchmark(path: str | Path | None = None) -> Benchmark:
    """Read a description from a YAML file with the keys that differ from the defaults; None: the defaults alone.

    Raises AmulettError if the file cannot be read, a key is unknown, or a value is wrong.
    """
    if path is None:
        return Benchmark()
    return parse_benchmark(read_yaml(find_config(path, "benchmark"), "benchmark"), path)


def parse_benchmark(content: Mapping[str, Any], path: str | Path) -> Benchmark:
    """Return the description that a file at `path` holds; errors as of `load_benchmark`."""
    try:
        return Benchmark.model_validate(content)
    except ValidationError as error:
        raise describe(error, Benchmark, f"benchmark '{path}'") from error


def recipe_folder(path: str | Path | None) -> Path:
    """Return the folder of a description's files: its own, or that of the package for the defaults."""
    return configs_folder() if path is None else find_config(path, "benchmark").parent


def load_profile_of(description: Benchmark, folder: Path) -> Profile:
    """Return the device that a description names; a file's path is relative to the description's `folder`.

    Raises AmulettError if it cannot be read, or does not fit a loop of the description.
    """
    profile = load_profile(profile_of(description, folder))
    unfit = {loop: why for loop, why in unfit_loops(profile).items() if loop in description.loops}
    if unfit:
        others = ", ".join(loop for loop in description.loops if loop not in unfit)
        raise AmulettError(
            f"loops of the benchmark do not fit the device '{profile.name}'; write loops: [{others}]. "
            f"{'. '.join(f'{loop}: {why}' for loop, why in unfit.items())}"
        )
    return profile


def profile_of(description: Benchmark, folder: Path) -> str | Path:
    """Return the name or the file of that device."""
    name = description.profile
    is_file = Path(name).suffix.lower() in (".yaml", ".yml")
    return find_config(name, "profile", folder) if is_file else name


def training_recipe(entry: Learned, seed: int, folder: Path, more: Sequence[str] = ()) -> Any:
    """Return the checked recipe, `amulett_agents.TrainConfig`, of one training run; torch is not imported.

    Raises AmulettError if the recipe cannot be read or is wrong.
    """
    path = None if entry.recipe is None else find_config(entry.recipe, "recipe", folder)
    return load_learning("recipes").load_train_config(path, [*entry.set, *more, f"seed={seed}"])
