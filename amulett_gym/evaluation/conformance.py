"""Conformance checks of an environment.

A check is a function of a `Subject` that raises an exception if the environment does not meet the requirement.
"""

from __future__ import annotations

import atexit
import copy
import pickle
import re
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import check_env, data_equivalence
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.errors import AmulettError

STEPS = 120


class NotApplicable(Exception):
    """The requirement does not apply to this environment."""


@dataclass(frozen=True)
class Subject:
    """The environment to check: its id and keywords."""

    env_id: str
    keywords: dict[str, Any]

    def make(self, **more: Any) -> gym.Env[Any, Any]:
        """Make the environment as a user would."""
        return gym.make(self.env_id, **self.keywords, **more)

    def make_vec(self, num_envs: int, **more: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
        """Make the vector environment as a user would."""
        return gym.make_vec(self.env_id, num_envs=num_envs, **self.keywords, **more)


@dataclass(frozen=True)
class Outcome:
    """A check's result: `problem` is empty if it passed; `skipped` says why it could not run."""

    requirement: str
    problem: str = ""
    skipped: str = ""


def run_checks(subject: Subject) -> Iterator[Outcome]:
    """Run every check on an environment, with warnings as errors, and yield each outcome at once."""
    for requirement, check in CHECKS.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                check(subject)
        except ModuleNotFoundError as error:
            yield Outcome(requirement, skipped=f"{error.name} is not installed")
        except NotApplicable as error:
            yield Outcome(requirement, skipped=str(error))
        except Exception as error:
            yield Outcome(requirement, problem=f"{type(error).__name__}: {error}")
        else:
            yield Outcome(requirement)


def _gymnasium(subject: Subject) -> None:
    env = subject.make(render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=False)
    env.close()


def _sb3(subject: Subject) -> None:
    from stable_baselines3.common.env_checker import check_env as check_sb3

    check_sb3(subject.make())


def _spec(subject: Subject) -> None:
    spec = subject.make().spec
    assert spec is not None
    again = gym.envs.registration.EnvSpec.from_json(spec.to_json())
    _assert(again == spec, f"{again} is not {spec}")
    _assert(_rollout(gym.make(again), 1) == _rollout(subject.make(), 1), "the environment made from JSON differs")


def _bounds(subject: Subject) -> None:
    env = subject.make()
    for space in (env.observation_space, env.action_space):
        assert isinstance(space, gym.spaces.Box)
        _assert(bool(np.isfinite(space.low).all() and np.isfinite(space.high).all()), f"{space} is not bounded")
    size = 2 if subject.env_id in (DRIVES_ID, WORN_ID) else 1
    expected = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    _assert(env.action_space == expected, f"the action space is {env.action_space}")
    for observation, *_ in _steps(env, 2):
        _assert(env.observation_space.contains(observation), "{} is outside the observation space", observation)


def _documented(subject: Subject) -> None:
    """Compare each space's box and table in the class's docstring with the space; a class may leave one out."""
    env = subject.make()
    sections = (type(env.unwrapped).__doc__ or "").split("\n    ## ")
    spaces = {"Action Space": env.action_space, "Observation Space": env.observation_space}
    found = [(spaces[title], text) for title, _, text in (part.partition("\n") for part in sections) if title in spaces]
    _assert(bool(found), "the docstring describes no space")
    for space, text in found:
        (size,) = space.shape or ()
        _assert(f"`Box(-1, 1, ({size},), float32)`" in text, f"the docstring describes another space than {space}")
        numbers = [int(number) for number in re.findall(r"^ *\| (\d+) +\|", text, re.MULTILINE)]
        _assert(numbers == list(range(size)), f"the docstring's table has the entries {numbers}, not 0 to {size - 1}")


def _infos(subject: Subject) -> None:
    env = subject.make(max_episode_steps=STEPS // 3)
    infos = [env.reset(seed=6)[1]]
    for *_, terminated, truncated, info in _steps(env, 6):
        infos.append(info)
        if terminated or truncated:
            infos.append(env.reset()[1])
    types = {key: type(value) for key, value in infos[0].items()}
    for info in infos:
        _assert({key: type(value) for key, value in info.items()} == types, "keys or types changed: {}", info)
        wrong = [key for key, value in info.items() if not isinstance(value, int | float) or not np.isfinite(value)]
        _assert(not wrong, f"no finite number: {', '.join(wrong)}")


def _vector_infos(subject: Subject) -> None:
    if "fleet" in subject.keywords:
        raise NotApplicable("a fleet gives its devices to blocks of a vector environment")
    count, limit = 2, STEPS // 3
    modes = ("vector_entry_point", "sync")
    native, others = (subject.make_vec(count, max_episode_steps=limit, vectorization_mode=mode) for mode in modes)
    infos = [(native.reset(seed=6)[1], others.reset(seed=6)[1])]
    infos += [(native.step(actions)[4], others.step(actions)[4]) for actions in _random(native.action_space, STEPS)]
    for info, other in infos:
        _assert(info.keys() == other.keys(), f"the keys {info.keys() ^ other.keys()} are only in one of them")
        for key, values in info.items():
            same = values.dtype == other[key].dtype and np.array_equal(values, other[key])
            _assert(same, "'{}' is {!r} and {!r}", key, values, other[key])


def _reward_terms(subject: Subject) -> None:
    for _, reward, _, _, info in _steps(subject.make(), 3):
        total = sum(value for key, value in info.items() if key.startswith("reward_"))
        _assert(abs(total - reward) <= 1e-12 * max(1.0, abs(reward)), f"terms sum to {total}, the reward is {reward}")


def _same_seed(subject: Subject) -> None:
    _assert(_rollout(subject.make(), 4) == _rollout(subject.make(), 4), "two runs with one seed differ")
    _assert(elsewhere(subject, 4) == fingerprint(subject, 4), "another process gives another trajectory")


def _other_seed(subject: Subject) -> None:
    env = subject.make()
    unwrapped: Any = env.unwrapped
    sensors = unwrapped.profile.sensors
    if not (_drawn(unwrapped, 5) != _drawn(unwrapped, 6) or sensors.encoder_noise_deg or sensors.potentiometer_noise):
        raise NotApplicable("this suite draws nothing and the sensors are exact")
    _assert(_rollout(env, 5) != _rollout(env, 6), "seeds 5 and 6 give the same trajectory")
    rolled = _rollout(env, None)
    _assert(rolled != _rollout(env, None), "two unseeded resets give the same trajectory")


def _aliasing(subject: Subject) -> None:
    env = subject.make()
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second = env.step(_held(env, 1.0))[0]
    _assert(np.array_equal(first, kept) and not np.shares_memory(first, second), "an observation changed afterwards")


def _copies(subject: Subject) -> None:
    env = subject.make()
    env.reset(seed=7)
    action = _held(env, 0.3)
    for _ in range(40):
        env.step(action)
    twins = (pickle.loads(pickle.dumps(env)), copy.deepcopy(env))
    for _ in range(40):
        expected = env.step(action)
        for twin in twins:
            _assert(data_equivalence(twin.step(action), expected, exact=True), "a copy's trajectory differs")


def _vector(subject: Subject) -> None:
    count, limit = 3, 50
    vector = subject.make_vec(count, max_episode_steps=limit)
    singles = [subject.make(max_episode_steps=limit) for _ in range(count)]
    observations, _ = vector.reset(seed=20)
    expected = [env.reset(seed=20 + i)[0] for i, env in enumerate(singles)]
    _assert(np.array_equal(observations, expected), "reset differs")
    ended = [False] * count
    for actions in _random(vector.action_space, STEPS):
        observations, rewards, terminated, truncated, _ = vector.step(actions)
        for i, env in enumerate(singles):
            outcome = (env.reset()[0], 0.0, False, False) if ended[i] else env.step(actions[i])[:4]
            ended[i] = bool(outcome[2] or outcome[3])
            got = (observations[i], rewards[i], terminated[i], truncated[i])
            _assert(all(np.array_equal(a, b) for a, b in zip(got, outcome, strict=True)), f"device {i} differs")


def _reset_mask(subject: Subject) -> None:
    vector = subject.make_vec(4)
    vector.reset(seed=0)
    before = vector.step(np.zeros(vector.action_space.shape or (), dtype=np.float32))[0]
    mask = np.array([True, False, True, False])
    after, info = vector.reset(options={"reset_mask": mask})
    _assert(np.array_equal(after[~mask], before[~mask]), "an unmasked device changed")
    _assert(bool((info["time"][mask] == 0).all()), "a masked device was not reset")
    _assert(np.array_equal(info["_time"], mask), "the info is not that of the masked devices")
    times = vector.step(np.zeros(vector.action_space.shape or (), dtype=np.float32))[4]["time"]
    _assert(bool((times[~mask] > times[mask].max()).all()), "an unmasked device was reset")


def _bad_actions(subject: Subject) -> None:
    env = subject.make().unwrapped
    env.reset(seed=0)
    longer = np.append(_held(env, 0.0), np.float32(0.0))
    for action in (_held(env, np.nan), longer, np.float32(0)):
        try:
            env.step(action)
        except AmulettError:
            continue
        raise AssertionError(f"action {action!r} was accepted")


def _closes(subject: Subject) -> None:
    env = subject.make(render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    env.close()
    env.close()


CHECKS: dict[str, Callable[[Subject], None]] = {
    "Gymnasium's check_env, rendering included, without a warning": _gymnasium,
    "Stable-Baselines3's check_env, without a warning": _sb3,
    "EnvSpec survives JSON, keywords included": _spec,
    "Finite bounds, actions in [-1, 1], observations float32 within their space": _bounds,
    "The docstring's boxes and tables are those of the spaces": _documented,
    "Infos have constant keys and types, and finite numbers": _infos,
    "The vector environment's infos are those of Gymnasium's own vector environments": _vector_infos,
    "Reward terms in info sum to the reward": _reward_terms,
    "Same seed, same trajectory, in this process and another one": _same_seed,
    "Another seed, and another reset, give another episode": _other_seed,
    "Returned arrays never alias the environment's state": _aliasing,
    "Pickled and deep copies in the middle of an episode continue alike": _copies,
    "The vector environment equals the single one, bit for bit, over an automatic reset": _vector,
    "reset_mask resets the chosen devices and no others": _reset_mask,
    "NaN and misshapen actions are refused": _bad_actions,
    "close() twice": _closes,
}
"""Requirement -> check."""


def fingerprint(subject: Subject, seed: int) -> str:
    """Return an episode's beginning as text, with exact numbers."""
    return repr(_rollout(subject.make(), seed))


_PLAY_ALONG = """
import pickle, sys
from amulett_gym.evaluation.conformance import fingerprint
for size in sys.stdin.buffer:
    pickle.dump(fingerprint(*pickle.loads(sys.stdin.buffer.read(int(size)))), sys.stdout.buffer)
    sys.stdout.flush()
"""


def elsewhere(subject: Subject, seed: int) -> str:
    """Return the fingerprint of an environment, computed in another process.

    All calls share that process: it takes longer to start than to play.
    """
    process = _other_process()
    assert process.stdin is not None and process.stdout is not None
    given = pickle.dumps((subject, seed))
    try:
        process.stdin.write(b"%d\n%s" % (len(given), given))
        process.stdin.flush()
        found: str = pickle.load(process.stdout)
    except (EOFError, OSError, pickle.UnpicklingError):  # it failed: the next call starts another one
        _other_process.cache_clear()
        process.communicate()
        raise AssertionError("another process cannot play it") from None
    return found


@cache
def _other_process() -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-c", _PLAY_ALONG], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    atexit.register(process.communicate)  # closes its input: it ends
    return process


def _drawn(env: Any, seed: int) -> Any:
    """Return the scenario that a seed draws, without its noise seed."""
    env.reset(seed=seed)
    return env.scenario.model_copy(update={"noise_seed": None})


def _steps(env: gym.Env[Any, Any], seed: int | None) -> Iterator[tuple[Any, ...]]:
    env.reset(seed=seed)
    for action in _random(env.action_space, STEPS):
        yield env.step(action)


def _held(env: gym.Env[Any, Any], value: float) -> NDArray[np.float32]:
    """Return the action whose entries all have a value."""
    return np.full(env.action_space.shape or (), value, dtype=np.float32)


def _random(space: gym.Space[Any], count: int) -> NDArray[np.float32]:
    """Return actions of a space, or of a batch of it, that are always the same."""
    return np.random.default_rng(0).uniform(-1, 1, (count, *(space.shape or ()))).astype(np.float32)


def _rollout(env: gym.Env[Any, Any], seed: int | None) -> list[tuple[Any, ...]]:
    return [(observation.tolist(), reward) for observation, reward, *_ in _steps(env, seed)]


def _assert(holds: bool, problem: str, *values: object) -> None:
    """Raise an error unless something holds; values are put into its text only then, since arrays take long to show."""
    if not holds:
        raise AssertionError(problem.format(*values) if values else problem)
