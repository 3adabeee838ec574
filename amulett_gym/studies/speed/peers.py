"""Comparison of speed with other packages' environments, where they are installed (extra ``peers``).

A step is an agent's step in all of them; the number of inner simulation ticks differs: both rates are reported.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import gymnasium as gym

from amulett_gym.errors import install_extra
from amulett_gym.studies.speed.rates import Contestant, Speed, ratios, spread, step_single


@dataclass(frozen=True)
class Peer:
    """Another package's environment."""

    name: str  # in tables
    env_id: str
    modules: tuple[str, ...]  # to be installed, and imported to register the id


PEERS = (
    Peer("Gymnasium Pendulum", "Pendulum-v1", ("gymnasium",)),
    Peer("MuJoCo InvertedPendulum", "InvertedPendulum-v5", ("mujoco",)),
    Peer("MyoSuite elbow exoskeleton", "myoElbowPose1D6MExoRandom-v0", ("myosuite",)),
    Peer("gym-electric-motor DC motor", "Cont-SC-PermExDc-v0", ("gym_electric_motor",)),
)


def enter(peers: Sequence[Peer] = PEERS, seed: int = 0) -> tuple[list[Contestant], dict[str, str]]:
    """Return the peers that can step here, and a one-line reason for each of the others, by name."""
    entrants, absent = [], {}
    for peer in peers:
        try:
            with _hushed():
                env = make(peer)
                step = step_single(env, seed)
                step()
        except ImportError as error:
            absent[peer.name] = f"{error.name or peer.modules[0]} is not installed ({install_extra('peers')})"
        except Exception as error:  # other packages may raise anything
            absent[peer.name] = f"does not run here: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        else:
            entrants.append(Contestant(peer.name, step, 1, inner_ticks(env)))
    return entrants, absent


def make(peer: Peer) -> gym.Env[Any, Any]:
    """Make a peer's environment.

    Raises ImportError if its package is not installed.
    """
    for module in peer.modules:
        import_module(module)
    return gym.make(peer.env_id)


def inner_ticks(env: gym.Env[Any, Any]) -> int:
    """Return how many times an environment advances its physics in a step: MuJoCo's frame skip, else once."""
    return int(getattr(env.unwrapped, "frame_skip", 1))


def compare(ours: Sequence[Speed], theirs: Sequence[Speed], absent: dict[str, str]) -> dict[str, Any]:
    """Return plain data: our speeds, the peers', ratios to each peer turn by turn, and the skipped ones.

    `ours` and `theirs` are from one race, `absent` is from `enter`.
    """
    found: dict[str, Any] = {speed.name: {"ours": True, **speed.numbers()} for speed in ours}
    for peer in theirs:
        found[peer.name] = {
            **peer.numbers(),
            "ratio_steps": {speed.name: spread(ratios(speed, peer)) for speed in ours},
            "ratio_ticks": {
                speed.name: spread([ratio * speed.ticks / peer.ticks for ratio in ratios(speed, peer)])
                for speed in ours
            },
        }
    return {**found, **{name: {"skipped": why} for name, why in absent.items()}}


@contextlib.contextmanager
def _hushed() -> Iterator[None]:
    """Suppress greetings and warnings of other packages."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield
