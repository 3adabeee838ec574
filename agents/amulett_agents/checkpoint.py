"""Checkpoints: the complete state of a training run before a rollout, so that a resumed run gives the same bits.

A checkpoint is a folder ``checkpoints/<steps>`` of the run:

======================  =======================================================================================
``arrays.safetensors``  weights, optimisers, SAC's replay buffer and entropy coefficient, smooth exploration's noise,
                        random states, devices, last observations
``run.json``            versions, recipe, profile, counters, validations, values not yet logged
``best/``, ``last/``    the bundles of that moment
``manifest.json``       the SHA-256 of every other file
======================  =======================================================================================

It is written under a temporary name and renamed; the previous one is kept. Nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import random
import shutil
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.numpy
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError
from safetensors import SafetensorError
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecEnv, VecFrameStack, unwrap_vec_wrapper

from amulett_agents.adapter import SB3VecEnv
from amulett_agents.model import Model
from amulett_agents.wrappers import ActorView
from amulett_gym.errors import AmulettError
from amulett_gym.settings import Group, describe
from amulett_gym.storage.reading import read_json, visible
from amulett_gym.storage.writing import write_json

FOLDER = "checkpoints"
ARRAYS, STATE, MANIFEST = "arrays.safetensors", "run.json", "manifest.json"
BUNDLES = ("best", "last")
FORMAT = 1
_MAX_BYTES = 40_000_000  # of a JSON file; a validation takes about a kilobyte
_KEPT = 2
_NOISE = ("exploration_mat", "exploration_matrices")
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")

Arrays = dict[str, NDArray[Any]]


class ModelState(Group):
    """State of a model, its logger and the random generators, without arrays."""

    steps: int = Field(ge=0)
    updates: int = Field(ge=0)
    progress_remaining: float
    episodes: list[dict[str, float | int]] = Field(description="returns and lengths of the last ones")
    log: dict[str, list[Any]] = Field(description="name -> value in decimal digits, count, excluded formats")
    python_random: list[Any]
    numpy_random: list[Any]
    devices: dict[str, int | str | None] = Field(description="the environment's state, without arrays")
    action_random: dict[str, Any] = Field(default={}, description="SAC: random generator of actions")
    replay_position: int = Field(default=0, ge=0, description="SAC: next position in the replay buffer")
    replay_full: bool = Field(default=False, description="SAC: whether older transitions are overwritten")


class RunState(Group):
    """State of a training run in addition to its model."""

    seconds: float = Field(ge=0)
    rows: list[dict[str, float | int]] = Field(description="rows of evaluations.csv")
    best: int = Field(ge=0)
    validated_steps: int = Field(ge=-1)
    next_validation: int = Field(ge=0)
    episodes: list[dict[str, float | int]] = Field(description="the last ones' reward terms")


class Content(Group):
    """Content of ``run.json``."""

    config: dict[str, Any]
    profile: dict[str, Any] = Field(description="the device, or those of a fleet by name")
    model: ModelState
    run: RunState


class Manifest(Group):
    """Content of ``manifest.json``."""

    format: Literal["amulett-checkpoint"] = "amulett-checkpoint"
    version: int = FORMAT
    amulett_gym: str = Field(description="version that wrote it")
    sha256: dict[str, str] = Field(description="file name -> SHA-256 of its content, in lower-case hexadecimal digits")


@dataclass(frozen=True)
class Checkpoint:
    """A verified checkpoint."""

    folder: Path
    content: Content
    arrays: Arrays


def write_checkpoint(out: Path, model: Model, run: RunState, config: Mapping[str, Any]) -> Path:
    """Write the state of a run before a rollout; return the checkpoint's folder. The last two checkpoints are kept.

    Parameters
    ----------
    out : Path
        Folder of the run. Its bundles become part of the checkpoint.
    model : PPO or SAC
    run : RunState
    config : mapping
        The resolved recipe.

    Raises
    ------
    AmulettError
        If it cannot be written; earlier checkpoints are unchanged.
    """
    folder = out / FOLDER / f"{model.num_timesteps:012d}"
    temporary = folder.with_name(f".{folder.name}")
    state, arrays = capture(model)
    content = Content(config=dict(config), profile=devices_of(_adapter(model)), model=state, run=run)
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        (temporary / ARRAYS).write_bytes(safetensors.numpy.save(arrays))
        write_json(temporary / STATE, content.model_dump())
        for name in BUNDLES:
            if (out / name).is_dir():
                shutil.copytree(out / name, temporary / name)
        digests = {name: _digest(temporary / name) for name in _files(temporary)}
        write_json(temporary / MANIFEST, Manifest(amulett_gym=version("amulett-gym"), sha256=digests).model_dump())
        if folder.exists():  # damaged: otherwise the run would have been resumed from it
            shutil.rmtree(folder)
        temporary.rename(folder)
        found = _found(out)
        newest = found.index(folder)
        for other in [*found[:newest], *found[newest + _KEPT :]]:  # newer ones are damaged, too
            shutil.rmtree(other)
    except OSError as error:
        raise AmulettError(f"cannot write checkpoint '{folder}': {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def devices_of(env: VecEnv) -> dict[str, Any]:
    """Return the content of an environment's profile, or of those of its fleet by name."""
    settings = env.get_attr("settings")[0]
    contents = {device.name: device.model_dump(mode="json") for device in settings.devices}
    return contents if settings.fleet is not None else dict(*contents.values())


def newest_checkpoint(out: Path) -> Checkpoint | None:
    """Return a run's newest checkpoint that is not damaged, or None if there is no checkpoint.

    A damaged one causes a warning; a run resumed from the previous one ends with the same bits.

    Raises
    ------
    AmulettError
        If another version wrote it, or all of them are damaged. The error names the files.
    """
    damages = []
    for folder in _found(out):
        try:
            checkpoint = read_checkpoint(folder)
        except _OtherVersionError:
            raise
        except AmulettError as error:
            damages.append(str(error))
            continue
        for damage in damages:
            warnings.warn(f"{damage}; resuming from the one before it, '{folder}'", stacklevel=2)
        return checkpoint
    if damages:
        raise AmulettError(f"no checkpoint of '{out}' can be used: {'; '.join(damages)}")
    return None


def steps_of(out: Path) -> int:
    """Return the agent steps of a run's newest checkpoint, which is not read; of a finished run a large number."""
    if (out / "finished.json").is_file():
        return sys.maxsize
    return max((int(folder.name) for folder in _found(out)), default=0)


def read_checkpoint(folder: Path) -> Checkpoint:
    """Read and verify a checkpoint.

    Raises
    ------
    AmulettError
        If another version wrote it, or a file is missing, unlisted, changed or damaged. The error names the file.
    """
    path = folder / MANIFEST
    try:
        manifest = _parse(Manifest, path)
        here = version("amulett-gym")
        if (manifest.version, manifest.amulett_gym) != (FORMAT, here):
            raise _OtherVersionError(
                f"checkpoint '{folder}' was written by amulett-gym {manifest.amulett_gym} (format {manifest.version}); "
                f"this is {here} (format {FORMAT}): resume with the version that began the run, or train anew"
            )
        names = _files(folder) - {MANIFEST}
        for name in sorted(names ^ set(manifest.sha256)):
            missing = "is missing" if name in manifest.sha256 else "is not listed in the manifest"
            raise AmulettError(f"checkpoint '{folder}' is damaged: '{name}' {missing}")
        for name, digest in manifest.sha256.items():
            if _digest(folder / name) != digest:
                raise AmulettError(f"checkpoint '{folder}' is damaged: the SHA-256 of '{name}' is another one")
        arrays = safetensors.numpy.load_file(folder / ARRAYS)
        return Checkpoint(folder, _parse(Content, folder / STATE), arrays)
    except OSError as error:
        raise AmulettError(f"cannot read checkpoint '{folder}': {error.strerror or error}") from error
    except AmulettError:
        raise
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise AmulettError(f"checkpoint '{folder}' is damaged: '{ARRAYS}': {error}") from error


def remove_checkpoints(out: Path) -> None:
    """Remove the checkpoints of a finished run."""
    shutil.rmtree(out / FOLDER, ignore_errors=True)


def capture(model: Model) -> tuple[ModelState, Arrays]:
    """Return the state of a model before a rollout, with that of the process's random generators."""
    adapter = _adapter(model)
    devices, arrays = _flatten(adapter.get_state(), "devices")
    for name, tensor in model.policy.state_dict().items():
        arrays[f"policy.{name}"] = _array(tensor)
    for optimizer, torchs in _optimizers(model).items():
        for index, moments in torchs.state_dict()["state"].items():
            for name, tensor in moments.items():
                arrays[f"{optimizer}.{index}.{name}"] = _array(tensor)
    for name in _noise_of(model):
        arrays[f"noise.{name}"] = _array(getattr(model.policy.action_dist, name))
    generator, words, *rest = np.random.get_state()  # noqa: NPY002  (PPO shuffles with it)
    arrays["random.numpy"], arrays["random.torch"] = np.asarray(words), _array(torch.get_rng_state())
    arrays |= {f"memory.{name}": array.copy() for name, array in _memory_of(model).items()}
    arrays["last.observations"] = np.array(model._last_obs)
    arrays["last.episode_starts"] = np.array(model._last_episode_starts)
    python_version, python_words, gauss = random.getstate()
    logger = model.logger
    of_sac: dict[str, Any] = {}
    if isinstance(model, SAC):
        replay = model.replay_buffer
        assert replay is not None
        for name in _REPLAY:
            arrays[f"replay.{name}"] = np.ascontiguousarray(getattr(replay, name)[: replay.size()])
        if model.log_ent_coef is not None:
            arrays["entropy.log_coefficient"] = _array(model.log_ent_coef)
        of_sac = {
            "action_random": model.action_space.np_random.bit_generator.state,
            "replay_position": replay.pos,
            "replay_full": replay.full,
        }
    state = ModelState(
        **of_sac,
        steps=model.num_timesteps,
        updates=model._n_updates,
        progress_remaining=float(model._current_progress_remaining),
        episodes=list(model.ep_info_buffer or ()),
        log={
            name: [repr(float(value)), logger.name_to_count.get(name, 0), list(logger.name_to_excluded[name])]
            for name, value in logger.name_to_value.items()
        },
        python_random=[python_version, list(python_words), gauss],
        numpy_random=[generator, *rest],
        devices=devices,
    )
    return state, arrays


def restore(model: Model, checkpoint: Checkpoint) -> None:
    """Load a checkpoint into a new model of the same recipe before its first rollout; AmulettError if unsuitable."""
    state, arrays, policy = checkpoint.content.model, checkpoint.arrays, model.policy
    adapter, optimizers = _adapter(model), _optimizers(model)
    try:
        devices = _unflatten(adapter.get_state(), "devices", state.devices, arrays)
        weights = {name: _tensor(arrays[f"policy.{name}"]) for name in policy.state_dict()}
        moments: dict[str, dict[int, dict[str, torch.Tensor]]] = {name: {} for name in optimizers}
        for name, array in arrays.items():
            optimizer, *entry = name.split(".")
            if optimizer in optimizers:
                index, moment = entry
                moments[optimizer].setdefault(int(index), {})[moment] = _tensor(array)
        noise = {name: _tensor(arrays[f"noise.{name}"]) for name in _noise_of(model)}
        observations, starts = arrays["last.observations"], arrays["last.episode_starts"]
        python_version, python_words, gauss = state.python_random
        generator, *rest = state.numpy_random

        policy.load_state_dict(weights)
        for name, torchs in optimizers.items():
            torchs.load_state_dict({**torchs.state_dict(), "state": moments[name]})
        for name, tensor in noise.items():
            setattr(policy.action_dist, name, tensor)
        if isinstance(model, SAC):
            _restore_sac(model, state, arrays)
        adapter.set_state(devices)
        for name, array in _memory_of(model).items():
            array[...] = arrays[f"memory.{name}"]
        model._last_obs, model._last_episode_starts = observations, starts
        if (stack := unwrap_vec_wrapper(_env(model), VecFrameStack)) is not None:
            stack.stacked_obs.stacked_obs = observations.copy()
        if (view := unwrap_vec_wrapper(_env(model), ActorView)) is not None:
            view.seen = observations[:, -view.seen.shape[1] :].copy()  # the newest of a stack
        model.num_timesteps = model._num_timesteps_at_start = state.steps
        model._n_updates, model._current_progress_remaining = state.updates, state.progress_remaining
        assert model.ep_info_buffer is not None
        model.ep_info_buffer.clear()
        model.ep_info_buffer.extend(state.episodes)
        logger = model.logger
        for name, (value, count, excluded) in state.log.items():
            logger.name_to_value[name] = float(value)
            logger.name_to_count[name] = count
            logger.name_to_excluded[name] = tuple(excluded)
        random.setstate((python_version, tuple(python_words), gauss))
        np.random.set_state((generator, arrays["random.numpy"], *rest))  # noqa: NPY002
        torch.set_rng_state(_tensor(arrays["random.torch"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise AmulettError(f"checkpoint '{checkpoint.folder}' does not fit this run: {error}") from error


class _OtherVersionError(AmulettError):
    pass


def _restore_sac(model: SAC, state: ModelState, arrays: Arrays) -> None:
    replay = model.replay_buffer
    assert replay is not None
    for name in _REPLAY:
        kept, place = arrays[f"replay.{name}"], getattr(replay, name)
        filled = len(place) if state.replay_full else state.replay_position
        if kept.shape != (filled, *place.shape[1:]):
            raise ValueError(f"'replay.{name}' has shape {kept.shape}; that of the replay buffer differs")
        place[: len(kept)] = kept
    replay.pos, replay.full = state.replay_position, state.replay_full
    model.action_space.np_random.bit_generator.state = state.action_random
    if model.log_ent_coef is not None:
        with torch.no_grad():
            model.log_ent_coef.copy_(_tensor(arrays["entropy.log_coefficient"]))


def _env(model: Model) -> VecEnv:
    env = model.get_env()
    assert env is not None
    return env


def _adapter(model: Model) -> SB3VecEnv:
    adapter = _env(model).unwrapped
    assert isinstance(adapter, SB3VecEnv)
    return adapter


def _optimizers(model: Model) -> dict[str, torch.optim.Optimizer]:
    if isinstance(model, PPO):
        return {"optimizer": model.policy.optimizer}
    optimizers = {"actor_optimizer": model.actor.optimizer, "critic_optimizer": model.critic.optimizer}
    if model.ent_coef_optimizer is not None:
        optimizers["entropy_optimizer"] = model.ent_coef_optimizer
    return optimizers


def _memory_of(model: Model) -> Arrays:
    view = unwrap_vec_wrapper(_env(model), ActorView)
    return {} if view is None or view.memory is None else dict(vars(view.memory))


def _noise_of(model: Model) -> tuple[str, ...]:
    return _NOISE if model.use_sde else ()


def _flatten(tree: Mapping[str, Any], name: str) -> tuple[dict[str, Any], Arrays]:
    """Return a tree's leaves by dotted names: first those that are not arrays, then the arrays, as plain types."""
    plain: dict[str, Any] = {}
    arrays: Arrays = {}
    for key, value in tree.items():
        path = f"{name}.{key}"
        if isinstance(value, Mapping):
            below = _flatten(value, path)
            plain.update(below[0])
            arrays.update(below[1])
        elif not isinstance(value, np.ndarray):
            plain[path] = value
        elif value.dtype.names:
            plain[path] = _layout(value.dtype)
            arrays[path] = np.frombuffer(value.tobytes(), dtype=np.uint8)
        else:
            arrays[path] = np.ascontiguousarray(value)
    return plain, arrays


def _unflatten(template: Mapping[str, Any], name: str, plain: Mapping[str, Any], arrays: Arrays) -> dict[str, Any]:
    """Return a tree like `template` from the results of `_flatten`; ValueError if they do not fit."""
    tree: dict[str, Any] = {}
    for key, value in template.items():
        path = f"{name}.{key}"
        if isinstance(value, Mapping):
            tree[key] = _unflatten(value, path, plain, arrays)
        elif not isinstance(value, np.ndarray):
            tree[key] = plain[path]
        else:
            array = arrays[path]
            if value.dtype.names:
                if plain[path] != _layout(value.dtype):
                    raise ValueError(
                        f"'{path}' has other fields than in this version; resume with the version that began the run, "
                        "or train anew"
                    )
                if array.size == value.nbytes:
                    array = array.view(value.dtype).reshape(value.shape)
            if array.dtype != value.dtype or array.shape != value.shape:
                raise ValueError(f"'{path}' is {array.dtype} of shape {array.shape}; that of the environment differs")
            tree[key] = array
    return tree


def _layout(dtype: np.dtype[Any]) -> str:
    return hashlib.sha256(repr(dtype.descr).encode()).hexdigest()


def _array(tensor: torch.Tensor) -> NDArray[Any]:
    return np.array(tensor.detach().cpu().numpy(), order="C")


def _tensor(array: NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(np.array(array, order="C"))


def _found(out: Path) -> Sequence[Path]:
    """Return the folders of a run's checkpoints, newest first."""
    folder = out / FOLDER
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if path.name.isdecimal()), reverse=True)


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in visible(folder, "**/*") if not path.is_dir()}


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _parse(kind: type[BaseModel], path: Path) -> Any:
    try:
        return kind.model_validate(read_json(path, "checkpoint file", _MAX_BYTES))
    except ValidationError as error:
        raise describe(error, kind, f"'{path}'") from error
