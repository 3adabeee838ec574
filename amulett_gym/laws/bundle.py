"""Policy bundles: a learned law as data, not code.

A bundle is a folder:

=======================  ==============================================================================
``weights.safetensors``  ``layer_<k>.weight`` (outputs, inputs) and ``layer_<k>.bias``, float32
``policy.json``          the network, the meaning of its observations and of its action
``env.json``             the environment that it was trained in: id, keywords, steps of an episode
``provenance.json``      where it comes from: command, configuration, versions, seed, scores
``card.md``              the model card (`laws.card`); bundles of early versions have none
``critic.npz``           PPO's critic, for another training that starts from the policy; most readers ignore it, and
                         not every bundle has one (`amulett_agents.critic_file`)
``manifest.json``        the SHA-256 of every other file
=======================  ==============================================================================

Nothing is unpickled, no name in a bundle is a path or a module, and no file is used before its hash was checked. The
manifest proves that a bundle is complete, not who made it: a changed file can come with a new manifest. There is no
running normalisation: observations are scaled by constants.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.numpy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationError, model_validator
from safetensors import SafetensorError

from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.envs.privileged import FLEET_PRIVILEGED, FLEET_SCALES, PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.envs.settings import AgentPeriod, MeanAngle, Steps, TensionList
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.envs.worn_transition import OBSERVATIONS as WORN_OBSERVATIONS
from amulett_gym.errors import AmulettError, other_version, unknown
from amulett_gym.fleet import fleet_names
from amulett_gym.laws.features import FEATURES, WORN_FEATURES
from amulett_gym.laws.memory import MEMORY, WORN_MEMORY
from amulett_gym.laws.worn_inputs import WORN_ACTIONS, WORN_SCALES
from amulett_gym.profile import profile_names
from amulett_gym.settings import Group, describe
from amulett_gym.storage.reading import parse_json, read_bytes, to_text, user_path, visible
from amulett_gym.storage.writing import replace_folder, to_json, write_json

MANIFEST = "manifest.json"
WEIGHTS, POLICY, ENV, PROVENANCE = FILES = ("weights.safetensors", "policy.json", "env.json", "provenance.json")
CARD, CRITIC = OPTIONAL = ("card.md", "critic.npz")
MAX_BYTES = 16_000_000
"""Largest file accepted in a bundle; the shipped recipes' networks have 20 kB."""

FORMAT = 1
"""Version of the format, in the manifest and in ``policy.json``."""

MAX_WEIGHT = 1e6
"""Largest magnitude of a weight: no network of the allowed sizes can overflow."""

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class Network(Group):
    """A fully connected network."""

    layers: list[int] = Field(min_length=2, max_length=20, description="sizes, from the observation to the action")
    activation: Literal["tanh", "relu"] = Field(description="activation of every layer but the last")
    output: Literal["clip", "tanh"] = Field(description="how the last layer's output is limited to [-1, 1]")

    @model_validator(mode="after")
    def _check_sizes(self) -> Network:
        if any(not 1 <= size <= 4096 for size in self.layers):
            raise ValueError(f"layers are {self.layers}; every size has to be from 1 to 4096")
        return self


class PolicyDescription(Group):
    """Content of ``policy.json``: the meaning of the network's inputs and output."""

    version: Literal[1] = Field(default=1, description="version of this format")
    network: Network
    observations: list[str] = Field(description="names of the observation's entries, in order; all in [-1, 1]")
    observation_scales: dict[str, float] = Field(
        description="what an entry of 1 stands for [rad, rad/s, s, N, N m, N m/s]"
    )
    features: list[str] = Field(
        default=[], description="names of the features after an observation's first 13 entries: all, or none"
    )
    memory: list[str] | None = Field(
        default=None, description="names of the means over the episode (laws.memory) after the features: all, or none"
    )
    tension_range: TensionList = Field(
        description="tension setpoint at action -1 and +1 [N]; also scales the entry `tension_setpoint`"
    )
    actions: list[str] | None = Field(
        default=None, description="names of the action's entries, in Amulett/Worn-v0 only: tension and assistance"
    )
    mean_angle_range: MeanAngle | None = Field(
        default=None, description="mean drive angle at action +1 [deg], in Amulett/Drives-v0 only"
    )
    setpoint_gain: float | None = Field(
        default=None, description="the setpoint's entry times this is added to the mean drive angle's action [1]"
    )
    agent_period: AgentPeriod = Field(description="time an action is held [s]")
    follow: float = Field(
        default=1.0, gt=0, le=1, description="an action's share of the way from the present setpoint to the output"
    )
    history: int = Field(
        default=1, ge=1, le=100, description="number of the newest observations in the input, newest last; 0: none yet"
    )

    @model_validator(mode="after")
    def _check_sizes(self) -> PolicyDescription:
        inputs, outputs = self.network.layers[0], self.network.layers[-1]
        actions = 1 if self.mean_angle_range is None and not self.is_worn else 2
        if (self.actions is not None) != self.is_worn or (self.is_worn and tuple(self.actions or ()) != WORN_ACTIONS):
            raise ValueError(
                f"actions are {self.actions}; a policy that observes a cuff has {list(WORN_ACTIONS)}, others none"
            )
        if self.is_worn and self.mean_angle_range is not None:
            raise ValueError("a policy that observes a cuff has no mean_angle_range")
        if self.setpoint_gain is not None and self.mean_angle_range is None:
            raise ValueError("setpoint_gain needs mean_angle_range: only a mean drive angle can follow the setpoint")
        if (inputs, outputs) != (self.history * self.size, actions):
            times = f"{self.history} times " if self.history > 1 else ""
            raise ValueError(
                f"the network maps {inputs} numbers to {outputs}; it has to map {times}the {self.size} observations "
                f"and features to {actions} action{'s' if actions > 1 else ''}"
            )
        return self

    @property
    def size(self) -> int:
        """Number of the network's inputs for one agent step."""
        return len(self.observations) + len(self.features) + len(self.memory or ())

    @property
    def is_worn(self) -> bool:
        """Whether the policy observes a cuff, as in Amulett/Worn-v0."""
        return tuple(self.observations[len(OBSERVATIONS) :]) == WORN_OBSERVATIONS[len(OBSERVATIONS) :]

    @property
    def is_privileged(self) -> bool:
        """Whether the policy needs observations that no device can measure (see `envs.privileged`)."""
        return len(self.observations) > len(OBSERVATIONS) and not self.is_worn

    @property
    def knows_device(self) -> bool:
        """Whether the policy needs the observations of the device itself, which only a fleet has."""
        return len(self.observations) > len(OBSERVATIONS + PRIVILEGED)


class TrainingEnv(Group):
    """Content of ``env.json``: the arguments of ``gym.make(id, max_episode_steps=..., **keywords)``."""

    id: str = Field(description="one of `amulett_gym.ENV_IDS`")
    keywords: dict[str, Any] = Field(
        description="JSON-serialisable keywords of the environment; its profile is a shipped name or a whole profile"
    )
    max_episode_steps: Steps = Field(description="length of an episode [agent steps]; -1: no limit")

    @model_validator(mode="after")
    def _check_names(self) -> TrainingEnv:
        """Refuse an id that would make Gymnasium import a module, and a profile that would have a file read."""
        if self.id not in ENV_IDS:
            raise unknown("environment", self.id[:100], ENV_IDS)
        fleet = self.keywords.get("fleet") or []
        if not isinstance(fleet, list):
            if fleet not in fleet_names():
                raise unknown("fleet", str(fleet)[:100], fleet_names())
            fleet = []
        for profile in (self.keywords.get("profile", {}), *fleet):
            if not isinstance(profile, dict) and profile not in profile_names():
                raise unknown("profile", str(profile)[:100], profile_names())
        return self


class Manifest(Group):
    """Content of ``manifest.json``."""

    format: Literal["amulett-policy-bundle"] = "amulett-policy-bundle"
    version: Literal[1] = 1
    sha256: dict[str, str] = Field(description="file name -> SHA-256 of its content, in lower-case hexadecimal digits")


@dataclass(frozen=True)
class Bundle:
    """A verified policy bundle.

    `layers` are pairs (weight, bias) of float32, shapes (outputs, inputs) and (outputs,). `card` is the model card in
    Markdown, `critic` the content of ``critic.npz``, which only training reads; None: the bundle was written without.
    """

    folder: Path
    layers: Layers
    policy: PolicyDescription
    env: TrainingEnv
    provenance: dict[str, Any]
    card: str | None = None
    critic: bytes | None = None

    def act(self, observations: ArrayLike) -> NDArray[np.float32]:
        """Return the network's output, shape (N, outputs): actions in [-1, 1] over the bundle's own ranges.

        What `follow` and `setpoint_gain` add is in `laws.actor`.

        The observations have the shape (N, inputs): the last `history` ones of each device, the newest last (see
        `laws.history`).
        """
        return forward(self.layers, self.policy.network, observations)


def forward(layers: Layers, network: Network, observations: ArrayLike) -> NDArray[np.float32]:
    """Return the network's output, shape (N, outputs).

    It is computed in float64 and then rounded to float32, so that the order of sums in a batch does not matter.
    """
    values = np.asarray(observations, dtype=np.float64)
    for k, (weight, bias) in enumerate(layers):
        values = values @ weight.T.astype(np.float64) + bias
        if k < len(layers) - 1:
            values = np.tanh(values) if network.activation == "tanh" else np.maximum(values, 0.0)
    values = np.tanh(values) if network.output == "tanh" else np.clip(values, -1.0, 1.0)
    return values.astype(np.float32)


def read_bundle(folder: str | Path) -> Bundle:
    """Return the policy bundle in a folder, verified.

    Raises
    ------
    AmulettError
        If a file is missing, unlisted, too large or not what the manifest says; if the format's version is unknown; if
        weights are missing, misshapen or not finite; or if the observations are not those of this version of
        amulett-gym. The error names the file.
    """
    folder = user_path(folder)
    try:
        is_folder = folder.is_dir()
    except OSError as error:
        raise AmulettError(f"cannot read policy bundle '{folder}': {error.strerror or error}") from error
    if not is_folder:
        raise AmulettError(f"cannot read policy bundle '{folder}': it is not a folder")
    listed = _read(folder / MANIFEST)
    manifest = _parse(Manifest, listed, folder / MANIFEST)
    contents = _verified(folder, manifest)
    if listed.replace(b"\r\n", b"\n") != to_json(_json(listed, folder / MANIFEST)).encode():  # has no hash itself
        raise AmulettError(f"'{folder / MANIFEST}' was changed or damaged: amulett-gym writes it in another form")
    policy = _parse(PolicyDescription, contents[POLICY], folder / POLICY)
    _check_observations(policy, folder / POLICY)
    env = _parse(TrainingEnv, contents[ENV], folder / ENV)
    if (env.id == DRIVES_ID) != (policy.mean_angle_range is not None):
        raise AmulettError(
            f"'{folder / POLICY}': mean_angle_range is {policy.mean_angle_range}; a policy has one exactly if it was "
            f"trained in {DRIVES_ID}, and '{folder / ENV}' names {env.id}"
        )
    if (env.id == WORN_ID) != policy.is_worn:
        raise AmulettError(
            f"'{folder / POLICY}': a policy observes a cuff exactly if it was trained in {WORN_ID}, and "
            f"'{folder / ENV}' names {env.id}"
        )
    return Bundle(
        folder=folder,
        layers=_read_layers(contents[WEIGHTS], policy.network, folder / WEIGHTS),
        policy=policy,
        env=env,
        provenance=_json(contents[PROVENANCE], folder / PROVENANCE),
        card=_read_card(contents[CARD], folder / CARD) if CARD in contents else None,
        critic=contents.get(CRITIC),
    )


def write_bundle(
    folder: str | Path,
    layers: Layers,
    policy: PolicyDescription,
    env: TrainingEnv,
    provenance: Mapping[str, Any],
    card: str | None = None,
    critic: bytes | None = None,
) -> Path:
    """Write a policy bundle, completely or not at all, and return its folder; an existing bundle is replaced.

    `card` is its model card (`laws.card.model_card`), `critic` the content of its ``critic.npz``.

    The files are written into a temporary folder next to it and read back; then that folder is renamed.

    Raises
    ------
    AmulettError
        If the bundle would not be valid, `folder` holds other files than a bundle's, or cannot be written.
    """
    folder = user_path(folder)
    check_replaceable(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            _write_files(new, layers, policy, env, provenance, card, critic)
            read_bundle(new)
            replace_folder(new, folder, Path(temporary) / "old")
    except OSError as error:
        raise AmulettError(f"cannot write policy bundle '{folder}': {error.strerror or error}") from error
    return folder


def check_replaceable(folder: str | Path) -> None:
    """Raise an AmulettError if a folder holds something else than a bundle, which no bundle replaces."""
    folder = user_path(folder)
    if folder.exists() and not (folder / MANIFEST).is_file() and (not folder.is_dir() or visible(folder)):
        raise AmulettError(f"'{folder}' is not a policy bundle and not empty; it is not replaced")


def _write_files(
    folder: Path,
    layers: Layers,
    policy: PolicyDescription,
    env: TrainingEnv,
    provenance: Mapping[str, Any],
    card: str | None,
    critic: bytes | None,
) -> None:
    tensors = {}
    for k, (weight, bias) in enumerate(layers):
        tensors[f"layer_{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
        tensors[f"layer_{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    (folder / WEIGHTS).write_bytes(safetensors.numpy.save(tensors))
    write_json(folder / POLICY, policy.model_dump(exclude_none=True))
    write_json(folder / ENV, env.model_dump())
    write_json(folder / PROVENANCE, dict(provenance))
    if card is not None:
        (folder / CARD).write_bytes(card.encode())
    if critic is not None:
        (folder / CRITIC).write_bytes(critic)
    names = [name for name in (*FILES, *OPTIONAL) if (folder / name).is_file()]
    manifest = Manifest(sha256={name: _digest((folder / name).read_bytes()) for name in names})
    write_json(folder / MANIFEST, manifest.model_dump())


def _verified(folder: Path, manifest: Manifest) -> dict[str, bytes]:
    """Return the content of every file of the manifest; refuse changed, missing and unlisted files."""
    for name in sorted((set(manifest.sha256) ^ set(FILES)) - {*OPTIONAL}):
        lists = "lists" if name in manifest.sha256 else "does not list"
        held = ", ".join((*FILES, *OPTIONAL))
        raise AmulettError(f"'{folder / MANIFEST}' {lists} {name[:100]!r}; a bundle holds {held}")
    try:
        for path in visible(folder):
            if path.name not in manifest.sha256 and path.name != MANIFEST:
                raise AmulettError(f"'{path}' is not listed in the bundle's manifest")
    except OSError as error:
        raise AmulettError(f"cannot read policy bundle '{folder}': {error.strerror or error}") from error
    contents = {}
    for name, digest in manifest.sha256.items():
        contents[name] = _read(folder / name)
        if _digest(contents[name]) != digest:
            raise AmulettError(f"'{folder / name}' was changed or damaged: its SHA-256 differs from the manifest's")
    return contents


def _read_layers(content: bytes, network: Network, path: Path) -> Layers:
    try:
        tensors = safetensors.numpy.load(content)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise AmulettError(f"'{path}' is not a valid safetensors file: {error}") from error
    shapes: dict[str, tuple[int, ...]] = {}
    for k, (inputs, outputs) in enumerate(zip(network.layers, network.layers[1:], strict=False)):
        shapes[f"layer_{k}.weight"], shapes[f"layer_{k}.bias"] = (outputs, inputs), (outputs,)
    if set(tensors) != set(shapes):
        wrong = ", ".join(sorted(set(tensors) ^ set(shapes)))[:200]
        raise AmulettError(f"'{path}' does not hold the weights that {POLICY} describes: {wrong} missing or unexpected")
    for name, shape in shapes.items():
        tensor = tensors[name]
        if tensor.shape != shape or tensor.dtype != np.float32:
            raise AmulettError(
                f"'{path}': '{name}' is {tensor.dtype} of shape {tensor.shape}; it has to be float32 of shape {shape}"
            )
        if not np.isfinite(tensor).all():
            raise AmulettError(f"'{path}': '{name}' holds a number that is not finite")
        if np.abs(tensor).max() > MAX_WEIGHT:
            raise AmulettError(f"'{path}': '{name}' holds a number beyond +-{MAX_WEIGHT:g}")
    return [(tensors[f"layer_{k}.weight"], tensors[f"layer_{k}.bias"]) for k in range(len(network.layers) - 1)]


def _check_observations(policy: PolicyDescription, path: Path) -> None:
    """Refuse a policy whose observations are not, name by name and scale by scale, those of this version."""
    for what, theirs, ours in (
        (
            "observations",
            policy.observations,
            (
                (WORN_OBSERVATIONS,)
                if policy.is_worn
                else (OBSERVATIONS, OBSERVATIONS + PRIVILEGED, OBSERVATIONS + PRIVILEGED + FLEET_PRIVILEGED)
            ),
        ),
        ("features", policy.features, (WORN_FEATURES if policy.is_worn else FEATURES, ())),
        ("memory", policy.memory or (), (WORN_MEMORY if policy.is_worn else MEMORY, ())),
    ):
        if tuple(theirs) not in ours:
            different = ", ".join(sorted(set(theirs) ^ set(ours[0]))) or "their order"
            raise AmulettError(f"'{path}': the {what} are not those of this amulett-gym; different: {different}")
    of_device = FLEET_SCALES if policy.knows_device else {}
    own = WORN_SCALES if policy.is_worn else OBSERVATION_SCALES
    scales = {**own, **(PRIVILEGED_SCALES if policy.is_privileged else {}), **of_device}
    for name, scale in scales.items():
        found = policy.observation_scales.get(name, math.nan)
        if not math.isclose(found, scale, rel_tol=1e-12):
            raise AmulettError(f"'{path}': the scale of observation '{name}' is {found}; here it has to be {scale}")


def _read_card(content: bytes, path: Path) -> str:
    """Return the text; refuse control characters, which could change a terminal."""
    text = to_text(content, f"'{path}'")
    if not text.replace("\n", "").isprintable():
        raise AmulettError(f"'{path}' holds characters that cannot be printed")
    return text


def _parse(model: type[Any], content: bytes, path: Path) -> Any:
    value = _json(content, path)
    found = value.get("version", FORMAT)
    if "version" in model.model_fields and isinstance(found, int) and found != FORMAT:
        raise other_version(f"'{path}'", found, FORMAT, "train again, or write the bundle anew with this amulett-gym")
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise describe(error, model, f"'{path}'") from error


def _json(content: bytes, path: Path) -> dict[str, Any]:
    value = parse_json(to_text(content, f"'{path}'"), f"'{path}'")
    if not isinstance(value, dict):
        raise AmulettError(f"'{path}' has to hold a JSON object, not {type(value).__name__}")
    return value


def _read(path: Path) -> bytes:
    return read_bytes(path, "bundle file", MAX_BYTES, follow=False)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
