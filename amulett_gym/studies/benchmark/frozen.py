"""Checks of the separation of training from evaluation: frozen suites, frozen prices, disjoint seeds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from amulett_gym.envs.prices import divisors, prices
from amulett_gym.envs.reward import COST_CAP, FULL_CONTROL, SCHEDULE, Track, default_weights
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.random import keys_from_seeds
from amulett_gym.tasks.hashes import PROFILE, frozen, suite_hash
from amulett_gym.tasks.suites import SPLITS, episode_keys, families_of, suite_names

PRICES_SHA256 = "e5e4393edbb6a45a15900136442047d3e4d33a07c43eb787462b31f6dd4bed46"
"""SHA-256 of the divisors and weights of all suites on the shipped testbed, from `price_hash`."""

PRICES_OF = {SCHEDULE: PRICES_SHA256, FULL_CONTROL: "5b6dd4606f431d4bc8158c9219c0c8aedad27f6069e19c2d3a3bab66ab560904"}
"""The same by track."""


def check_frozen(suites: Sequence[str], track: Track = SCHEDULE) -> None:
    """Raise AmulettError if a suite, a divisor or a weight differs from the frozen one."""
    profile, committed = load_profile(PROFILE), frozen()["hashes"]
    changed = [
        f"{suite} ({split})"
        for suite in suites
        for split in SPLITS
        if suite_hash(suite, split, profile) != committed[suite][split]
    ]
    if changed:
        raise AmulettError(
            f"these suites draw other scenarios than those that were frozen (tasks/hashes.json): {', '.join(changed)}; "
            "a change of a suite goes with a new version"
        )
    if price_hash(profile, track) != PRICES_OF[track]:
        raise AmulettError(
            "the divisors or weights of the cost are not those that were frozen (studies/benchmark/frozen.py); "
            "a change of them goes with a new version"
        )


def price_hash(profile: Profile, track: Track = SCHEDULE) -> str:
    """Return the SHA-256 of all that turns raw metrics into a track's cost on a profile: divisors, weights, cap."""
    content: list[Any] = [COST_CAP]
    for suite in suite_names():
        for family in families_of(suite):
            content.append([suite, family, default_weights(family, track), divisors(profile, suite, family, track)])
        content.append(prices(profile, suite, track=track).tolist())
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def hashes(profile: Profile, suites: Iterable[str], track: Track = SCHEDULE) -> dict[str, Any]:
    """Return the hashes of the suites' splits and prices on a benchmark's own profile: its numbers depend on them."""
    return {
        "suites": {suite: {split: suite_hash(suite, split, profile) for split in SPLITS} for suite in suites},
        "prices": price_hash(profile, track),
        "profile": hashlib.sha256(profile.model_dump_json().encode()).hexdigest(),
    }


def seed_overlap(configs: Sequence[Any], seed: int, episodes: int) -> dict[str, int]:
    """Count the different episodes of training, of validation and of the evaluation, and those in two of these.

    An episode is its 64-bit key: everything that is drawn for it, scenario and noise, is a function of that. `configs`
    are the recipes of all training runs (`amulett_agents.TrainConfig`), `seed` and `episodes` the first seed and the
    number of the scenarios evaluated, in `held-out` and in `shifted`. The keys of the counts are ``train``,
    ``validation``, ``judged`` and ``overlap``.
    """
    train, validation = [], []
    for config in configs:
        devices = config.first_scenario + np.arange(config.num_envs)
        # Twice as many as full episodes would be: an episode may end early.
        count = 2 * (config.total_steps // (config.num_envs * config.env.max_episode_steps) + 2)
        train.append(_keys(devices, count, "train"))
        validation.append(_keys(config.validation.seed + np.arange(config.validation.episodes), 1, "validation"))
    seeds = seed + np.arange(episodes)
    judged = np.unique(np.concatenate([_keys(seeds, 1, split) for split in ("held-out", "shifted")]))
    none = np.zeros(0, dtype=np.uint64)
    trained, chosen = np.unique(np.concatenate([none, *train])), np.unique(np.concatenate([none, *validation]))
    overlap = sum(np.intersect1d(*pair).size for pair in ((trained, judged), (chosen, judged), (trained, chosen)))
    return {"train": trained.size, "validation": chosen.size, "judged": judged.size, "overlap": overlap}


def _keys(seeds: Any, count: int, split: str) -> Any:
    """Return the keys of the first episodes of some devices, shape (devices * count,)."""
    keys = np.repeat(keys_from_seeds(seeds.astype(object)), count)
    return episode_keys(keys, np.tile(np.arange(count, dtype=np.uint64), len(seeds)), split)
