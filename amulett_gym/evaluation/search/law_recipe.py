"""The settings of a tuning: what is tuned, on which devices and scenarios, and in which stages."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.envs.reward import FULL_CONTROL, SCHEDULE, TRACKS, Track
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.evaluation.search.gains import GAINS, Gains, gains_of, shapes_of
from amulett_gym.evaluation.search.trials import Trials
from amulett_gym.fleet import load_fleet, name_or_contents, names_or_contents
from amulett_gym.laws.parametric import LAWS, Law
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import CONTROLS, LANES, LOOPS

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


def file_name(recipe: Recipe) -> str:
    """Return the name of the files of a tuning, without a suffix."""
    loop = f"{recipe.control}-" if recipe.control in LOOPS or recipe.law == GAINS else ""
    return f"{loop}{recipe.law}-{recipe.suite}"
