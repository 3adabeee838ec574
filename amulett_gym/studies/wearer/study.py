"""The study of worn devices: its stages, each of which is kept, and its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.worn_reward import worn_prices
from amulett_gym.jit.code_cache import PACKAGE, fingerprint
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import Control
from amulett_gym.storage.kept import digest, kept
from amulett_gym.studies.wearer.baselines import BASELINES, BY_INTENTION, Tuned, tune_and_choose
from amulett_gym.studies.wearer.comparison import DOFFED, GUARDS, Learned, play_guard
from amulett_gym.studies.wearer.description import Bend, CableRanges, Description, loops_of
from amulett_gym.studies.wearer.episodes import Devices, Scenarios, draw, one_each
from amulett_gym.studies.wearer.headroom import PARTS, Headroom, measure
from amulett_gym.tasks.hashes import WORN_VERSION

Values = NDArray[np.float64]
Played = dict[str, Values]
T = TypeVar("T")
Cable = Bend | CableRanges | None

FORMAT = 2
"""Version of the stages' content."""

OWN_SOURCES = (
    "envs/episodes.py",
    "envs/worn_episodes.py",
    "simulation/worn_batch.py",
    *(f"studies/wearer/{name}.py" for name in ("baselines", "comparison", "episodes", "headroom", "search")),
)
"""Files on which the stages' numbers depend, besides those of the compiled code (`jit.code_cache.SOURCES`)."""

NO_CABLE = ""


@dataclass(frozen=True)
class Study:
    """What was measured.

    Attributes
    ----------
    description : Description
    device : Profile
    headroom : list of Headroom
    baselines : dict of str to list of Tuned
        Each baseline's searches, the chosen one first.
    played : dict of str to dict
        Cable (`NO_CABLE`, or the name of one of `Description.repetitions`) -> contender -> values of `episodes.play`.
    policies : list of Learned
    """

    description: Description
    device: Profile
    headroom: list[Headroom]
    baselines: dict[str, list[Tuned]]
    played: dict[str, dict[str, Played]]
    policies: list[Learned]

    @property
    def best(self) -> str:
        """The baseline with the least cost on validation scenarios."""
        return min(self.baselines, key=lambda kind: self.baselines[kind][0].validation)


def parts(description: Description, policies: Sequence[Learned]) -> int:
    """Return the number of parts of `run`."""
    tuned = len(BASELINES) * description.tuning.starts
    return PARTS * len(loops_of(description)) + tuned + 1 + len(policies)


def run(
    description: Description,
    policies: Sequence[Learned] = (),
    folder: Path | None = None,
    report: Callable[[str], object] = lambda part: None,
) -> Study:
    """Run the stages that the folder does not hold yet.

    Parameters
    ----------
    description : Description
    policies : sequence of Learned
        Further contenders.
    folder : Path, optional
        Where finished stages are kept; None: nowhere.
    report : callable
        Called with the name of each finished part; there are `parts`.
    """
    device = description.device()
    always = {"format": FORMAT, "suites": WORN_VERSION, "code": code(), "device": device.model_dump(mode="json")}
    stage = partial(_stage, folder, always)
    baselines = _baselines(description, device, stage, report)
    headroom = [_headroom(description, device, suite, loop, stage, report) for suite, loop in loops_of(description)]
    own = {kind: searches[0] for kind, searches in baselines.items()}
    for cell in headroom:
        if (cell.suite, cell.control) == (description.suite, description.control):
            own |= {kind: cell.tuned[kind] for kind in BY_INTENTION}
    played: dict[str, dict[str, Played]] = {}
    prices = _prices(device, description.suite)
    inputs = {"suite": description.suite, "prices": prices, "held_out": description.held_out, "seed": description.seed}
    scenarios = _drawn(description, device, "held-out", description.held_out)
    for cable in (None, *description.repetitions):
        name = NO_CABLE if cable is None else cable.name
        played[name] = stage(
            f"comparison/{'no-cable' if cable is None else _file(name)}",
            inputs | _cable_inputs(description, cable) | {"tuned": _plain_all(own)},
            partial(_compare, description, device, own, scenarios, cable),
            _pack_played,
            _unpack_played,
        )
    report("comparison")
    for learned in policies:
        mine = scenarios
        if learned.device != device:
            mine = _drawn(description, learned.device, "held-out", description.held_out)
        policy = {
            "policy": learned.digest,
            "settings": learned.settings.model_dump(mode="json"),
            "prices": _prices(learned.device, description.suite),
        }
        for cable in (None, *description.repetitions):
            name = NO_CABLE if cable is None else cable.name
            more: dict[str, Played] = stage(
                f"policies/{_file(learned.name)}-{_file(name)}",
                inputs | _cable_inputs(description, cable) | policy,
                partial(_play_learned, description, learned, mine, cable),
                _pack_played,
                _unpack_played,
            )
            played[name].update(more)
        report(learned.name)
    return Study(description, device, headroom, baselines, played, list(policies))


@cache
def code() -> str:
    """Return the digest of the code that stages are computed by, as this process runs it: its files may change."""
    return digest(fingerprint(), *((PACKAGE / name).read_bytes() for name in OWN_SOURCES))


def _stage(
    folder: Path | None,
    always: Mapping[str, Any],
    name: str,
    inputs: Mapping[str, Any],
    make: Callable[[], T],
    pack: Callable[[T], Any],
    unpack: Callable[[Any], T],
) -> T:
    if folder is None:
        return make()
    return kept(folder / "stages" / f"{name}.json", {**always, **inputs}, make, pack, unpack)


def _headroom(
    description: Description, device: Profile, suite: str, loop: Control, stage: Any, report: Callable[[str], object]
) -> Headroom:
    plan, done = description.headroom, [0]

    def finished() -> None:
        done[0] += 1
        report(f"headroom of {suite} in {loop}")

    def make() -> Headroom:
        train, held_out = (
            _drawn(description, device, split, count, suite)
            for split, count in (("train", plan.episodes), ("held-out", plan.held_out))
        )
        foreseen = min(plan.clairvoyant.scenarios, plan.held_out)
        return measure(device, loop, train, held_out, plan.budget, plan.clairvoyant.budget, foreseen, finished)

    sizes = plan.model_dump(exclude={"loops", "least"})
    inputs = {
        "suite": suite,
        "control": loop,
        "prices": _prices(device, suite),
        "seed": description.seed,
        "headroom": sizes,
    }
    found: Headroom = stage(f"headroom/{suite}-{loop}", inputs, make, _pack_headroom, _unpack_headroom)
    for _ in range(done[0], PARTS):
        finished()
    return found


def _baselines(
    description: Description, device: Profile, stage: Any, report: Callable[[str], object]
) -> dict[str, list[Tuned]]:
    plan, found = description.tuning, {}
    control: Control = description.control  # type: ignore[assignment]
    for kind in BASELINES:
        done = [0]

        def finished(kind: str = kind, done: list[int] = done) -> None:
            done[0] += 1
            report(f"tuning of {kind}")

        def make(kind: str = kind, finished: Callable[[], None] = finished) -> list[Tuned]:
            train = _drawn(description, device, "train", plan.episodes)
            validation = _drawn(description, device, "validation", plan.validation)
            return tune_and_choose(kind, device, control, train, validation, plan.budget, plan.starts, finished)

        inputs = {
            "kind": kind,
            "suite": description.suite,
            "prices": _prices(device, description.suite),
            "control": control,
            "seed": description.seed,
            "tuning": plan.model_dump(),
        }
        found[kind] = stage(f"tuning/{kind}", inputs, make, lambda every: [asdict(each) for each in every], _tuned_list)
        for _ in range(done[0], plan.starts):
            finished()
    return found


def _compare(
    description: Description, device: Profile, own: Mapping[str, Tuned], scenarios: Scenarios, cable: Cable
) -> dict[str, Played]:
    played = {DOFFED: scenarios.doffed}
    for kind, tuned in own.items():
        played[kind] = _repeat(description, device, scenarios, cable, tuned.play)
    if cable is None:
        played |= {name: play_guard(name, own["constant"], device, scenarios) for name in GUARDS}
    return played


def _play_learned(description: Description, learned: Learned, scenarios: Scenarios, cable: Cable) -> dict[str, Played]:
    return {learned.name: _repeat(description, learned.device, scenarios, cable, learned.play)}


def _repeat(
    description: Description,
    device: Profile,
    scenarios: Scenarios,
    cable: Cable,
    play: Callable[[Devices, Scenarios], Played],
) -> Played:
    """Play scenarios on a device without cables, with the same ones, or with cables drawn for each scenario."""
    if isinstance(cable, CableRanges):
        return one_each(partial(play, description.with_drawn_cables(device, cable)), scenarios)
    return play(device if cable is None else description.with_cable(device, cable), scenarios)


def _cable_inputs(description: Description, cable: Cable) -> dict[str, Any]:
    drawn = {"ranges": cable.model_dump(mode="json")} if isinstance(cable, CableRanges) else {}
    return {"cable": NO_CABLE if cable is None else cable.name, "side": description.side, **drawn}


def _drawn(description: Description, device: Profile, split: str, count: int, suite: str | None = None) -> Scenarios:
    return draw(device, description.suite if suite is None else suite, split, count, description.seed)


def _prices(device: Profile, suite: str) -> list[float]:
    return [float(f"{price:.6g}") for price in worn_prices(device, suite)]


def _file(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name).strip("-") or "no-cable"


def _plain_all(tuned: Mapping[str, Tuned]) -> dict[str, Any]:
    return {kind: {"control": each.control, "values": each.values} for kind, each in tuned.items()}


def _pack_played(played: dict[str, Played]) -> Any:
    return {name: {key: column.tolist() for key, column in values.items()} for name, values in played.items()}


def _unpack_played(content: Any) -> dict[str, Played]:
    return {name: {key: np.array(column) for key, column in values.items()} for name, values in content.items()}


def _tuned_list(content: Any) -> list[Tuned]:
    return [Tuned(**each) for each in content]


def _pack_headroom(cell: Headroom) -> Any:
    costs = {name: values.tolist() for name, values in cell.costs.items()}
    tuned = {kind: asdict(each) | {"validation": None} for kind, each in cell.tuned.items()}
    return {"suite": cell.suite, "control": cell.control, "costs": costs, "tuned": tuned}


def _unpack_headroom(content: Any) -> Headroom:
    costs = {name: np.array(values) for name, values in content["costs"].items()}
    tuned = {kind: Tuned(**each | {"validation": np.nan}) for kind, each in content["tuned"].items()}
    return Headroom(content["suite"], content["control"], tuned, costs)
