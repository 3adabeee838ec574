"""Policies by name: functions from observations to actions, outside the loop."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.control.variable_stiffness import scaling_factor, scaling_factor_printed
from amulett_gym.envs.action import action_to_tension, tension_to_action
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError, OtherLoopWarning
from amulett_gym.jit.compiled import compiled
from amulett_gym.laws.actor import TENSION_SETPOINT, Actor
from amulett_gym.laws.bundle import Bundle, read_bundle
from amulett_gym.laws.contenders import CONSTANT, EQ6_HELD, IN_THE_LOOP, bundle_folder, constant_tension, split_loop
from amulett_gym.laws.parametric import BEST_CONSTANT, Device, is_tuned, is_tuned_file, tuned_loop, tuned_vector
from amulett_gym.laws.training import other_loop
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import LOOPS

Policy = Callable[[ArrayLike], NDArray[np.float32]]
"""Maps an observation, shape (13,), to an action, shape (1,); or a batch (N, 13) to (N, 1). In `Amulett/Drives-v0`
actions have two entries."""

Act = Callable[[NDArray[np.float64]], NDArray[np.float32]]
"""A policy for batches only."""

_POSITION_ERROR = OBSERVATIONS.index("position_error")


def load_policy(name_or_folder: str | Path | Callable[..., Any], env: Any) -> Policy:
    """Return a policy for an environment.

    Parameters
    ----------
    name_or_folder : str, Path or callable
        ``"constant:<N>"``, ``"eq6-held"``, ``"eq6-held-printed"``, a tuned law (`parametric.tuned_names`),
        ``"pretrained"``, or a policy bundle's folder (or a training run's, for its best policy); or a function of your
        own, see `contenders.Own.act`. A name with a loop, ``"cascade/constant:10"``, is for an environment with it.
    env : gymnasium.Env or VectorEnv
        An AMULETT environment, wrapped or not. Its profile has eq. 6's parameters, its action range scales actions. The
        policy is for this environment only: one with a history (`laws.history`) reads its clock.

    Returns
    -------
    callable
        Observation of shape (13,) -> action of shape (1,); a batch (N, 13) -> (N, 1); float32, in [-1, 1]. In
        `Amulett/Drives-v0` and `Amulett/Worn-v0`, where only bundles trained there and your functions act, actions have
        two entries, and observations in the latter have 16. In a
        privileged environment observations are longer; a policy ignores entries that it was not made for.

    Raises
    ------
    AmulettError
        If the name is unknown, the bundle is damaged, or the policy cannot act in this environment.

    Warns
    -----
    OtherLoopWarning
        If a bundle was trained in another control loop, or in one with other settings (`laws.training.other_loop`).
    """
    policy, bundle = _policy_and_bundle(name_or_folder, env)
    if bundle is not None:
        episodes = env.unwrapped.episodes
        if differences := other_loop(bundle.env, episodes.profiles, episodes.settings.control):
            text = f"policy '{name_or_folder}' was trained {'; '.join(differences)}"
            warnings.warn(text, OtherLoopWarning, stacklevel=2)
    return policy


def named_policy(name_or_folder: str | Path | Callable[..., Any], env: Any) -> Policy:
    """Return a policy as `load_policy` does, without a warning."""
    return _policy_and_bundle(name_or_folder, env)[0]


def _policy_and_bundle(name_or_folder: str | Path | Callable[..., Any], env: Any) -> tuple[Policy, Bundle | None]:
    """Return a policy, and the bundle that it was read from, if it was."""
    base, bundle = env.unwrapped, None
    if not hasattr(base, "tension_range"):
        raise AmulettError(f"a policy needs an AMULETT environment (Amulett/Scaling-v0, ...); this is {env}")
    if callable(name_or_folder):
        return own_policy(name_or_folder, env), None
    loop, name = split_loop(str(name_or_folder))
    tension_range, control = base.tension_range, base.episodes.settings.control
    if loop and loop != control:
        raise AmulettError(
            f"'{name_or_folder}' acts in the loop '{loop}', and this environment's is '{control}'; make one with "
            f"control='{loop}', or load '{name}' for this one"
        )
    if name in IN_THE_LOOP:
        (key, value), *_ = IN_THE_LOOP[name].items()
        raise AmulettError(f"'{name}' acts inside the loop: make the environment with {key}='{value}' instead")
    if is_law(name) and base.episodes.action_size > 1:
        raise AmulettError(
            f"'{name}' chooses a tension and cannot act in {base.env_id}, whose action has another entry; use a "
            "policy bundle that was trained there, a function of your own, or another environment"
        )
    if name.startswith(CONSTANT):
        act = _constant(constant_tension(name), tension_range)
    elif is_tuned(name):
        act = _tuned(name, _profile_for(name, base), tension_range, base.episodes.agent_period)
    elif name in EQ6_HELD:
        act = _eq6(_profile_for(name, base), tension_range, EQ6_HELD[name])
    else:
        bundle = read_bundle(bundle_folder(name))
        act = _from_bundle(bundle, base)
    return _for_one_or_many(act, base.episodes.observation_size), bundle


def is_law(name: str) -> bool:
    """Return whether a name is that of a law that was not trained."""
    return name.startswith(CONSTANT) or is_tuned(name) or name in EQ6_HELD


def _profile_for(name: str, env: Any) -> Profile:
    """Return the profile that a law acts by; refuse a fleet whose devices need different ones."""
    first, *others = env.episodes.profiles
    if others and (is_tuned(name) or any(other.variable_stiffness != first.variable_stiffness for other in others)):
        raise AmulettError(
            f"'{name}' acts by the parameters of one device; the {len(others) + 1} devices of this environment's fleet "
            "differ in them. Make one with profile=..., or use a constant, a policy bundle or a function of your own"
        )
    return cast(Profile, first)


def own_policy(act: Callable[..., Any], env: Any, name: str | None = None) -> Policy:
    """Return a user's function (see `contenders.Own.act`) as a policy that checks its actions; `name`: for messages."""
    name = name or getattr(act, "__name__", type(act).__name__)
    size = env.unwrapped.episodes.action_size

    def policy(observation: ArrayLike) -> NDArray[np.float32]:
        observations = np.atleast_2d(np.asarray(observation, dtype=np.float32))
        count, returned = len(observations), act(observations)
        try:
            actions = np.asarray([] if returned is None else returned, dtype=np.float32)
        except (TypeError, ValueError):
            actions = np.empty(0, dtype=np.float32)
        if actions.size == 0:
            raise AmulettError(f"'{name}' returned {returned!r:.80}; it has to return {count} numbers")
        if actions.shape != (count, size) and (size > 1 or actions.shape != (count,)):
            raise AmulettError(
                f"'{name}' returned actions of shape {actions.shape} for observations of shape {observations.shape}; "
                f"it has to be ({count}, {size}){f' or ({count},)' if size == 1 else ''}"
            )
        if np.isnan(actions).any():
            raise AmulettError(f"'{name}' returned NaN as an action; it has to be a number from -1 to 1")
        actions = actions.reshape(-1, size)
        return actions[0] if np.ndim(observation) == 1 else actions

    if callable(reset := getattr(act, "reset", None)):
        policy.reset = partial(reset, getattr(env.unwrapped, "num_envs", 1))  # type: ignore[attr-defined]
    begin_episode(policy)
    return policy


def begin_episode(policy: Callable[..., Any]) -> None:
    """Call a policy's method ``reset``, if it has one."""
    if callable(reset := getattr(policy, "reset", None)):
        reset()


def _constant(tension: float, tension_range: tuple[float, float]) -> Act:
    _check_reach(f"the tension of constant:{tension:g}", tension, tension, tension_range)
    action = tension_to_action(np.array([[tension]]), tension_range).astype(np.float32)
    return lambda batch: np.repeat(action, len(batch), axis=0)


def _eq6(profile: Profile, tension_range: tuple[float, float], printed: bool) -> Act:
    """Return eq. 6 at agent rate, by the observed position error, which is limited to 90 deg."""
    law = profile.variable_stiffness
    _check_reach("eq. 6", law.minimum_tension, law.nominal_tension, tension_range)
    scale, offset = OBSERVATION_SCALES["position_error"], float(np.radians(law.error_offset_deg))
    if offset > scale:
        largest, wanted = np.degrees(scale), law.error_offset_deg
        raise AmulettError(f"eq. 6 has an error_offset_deg of {wanted}; the largest observed error is {largest:g} deg")

    def act(batch: NDArray[np.float64]) -> NDArray[np.float32]:
        factors = _factors(batch[:, _POSITION_ERROR] * scale, law.nominal_tension, law.minimum_tension, offset, printed)
        return tension_to_action(factors * law.nominal_tension, tension_range).astype(np.float32)[:, None]

    return act


def _tuned(name: str, profile: Profile, tension_range: tuple[float, float], agent_period: float) -> Act:
    """Return a law with parameters that were tuned on a suite."""
    law, vector = tuned_vector(name, profile)
    if law.name == BEST_CONSTANT.name:
        return _constant(float(vector[0]), tension_range)
    _check_reach(f"'{name}'", *law.range, tension_range, tuned_loop(name) if is_tuned_file(name) else None)
    device = Device.of(profile, agent_period)

    def act(batch: NDArray[np.float64]) -> NDArray[np.float32]:
        tensions = law.tensions(batch, vector[None], device, tension_range)
        return tension_to_action(tensions, tension_range).astype(np.float32)[:, None]

    return act


@compiled
def _factors(errors, nominal, minimum, offset, printed):  # type: ignore[no-untyped-def]
    factors = np.empty(errors.size)
    for k in range(errors.size):
        if printed:
            factors[k] = scaling_factor_printed(errors[k], nominal, minimum, offset)
        else:
            factors[k] = scaling_factor(errors[k], nominal, minimum, offset)
    return factors


def _from_bundle(bundle: Bundle, env: Any) -> Act:
    """Return a bundle's policy; if its action range is not the environment's, actions are converted by tensions."""
    tension_range, agent_period = env.tension_range, env.episodes.agent_period
    trained, size = bundle.policy.agent_period, len(bundle.policy.observations)
    if bundle.policy.is_privileged and not env.episodes.privileged:
        raise AmulettError(
            f"policy bundle '{bundle.folder}' needs privileged observations; make the environment with privileged=True"
        )
    if bundle.policy.knows_device and env.episodes.names is None:
        raise AmulettError(
            f"policy bundle '{bundle.folder}' needs privileged observations of the device; make the environment with "
            "fleet=[...]"
        )
    if (env.env_id == WORN_ID) != bundle.policy.is_worn:
        needed = f"{WORN_ID}, whose cuff it observes" if bundle.policy.is_worn else "an environment without a wearer"
        raise AmulettError(f"policy bundle '{bundle.folder}' needs {needed}; this is {env.env_id}")
    mine, theirs = bundle.policy.mean_angle_range, getattr(env, "mean_angle_range", None)
    if (mine is None and theirs is not None) or (mine is not None and theirs is None):
        needed = DRIVES_ID if theirs is None else "an environment in which an action is a tension"
        raise AmulettError(f"policy bundle '{bundle.folder}' needs {needed}; this is {env.env_id}")
    if mine != theirs:
        raise AmulettError(
            f"policy bundle '{bundle.folder}' means {mine} deg by an action of 1, this environment {theirs} deg; "
            f"make it with mean_angle_range={mine}"
        )
    if not np.isclose(trained, agent_period, rtol=1e-9):
        raise AmulettError(
            f"policy bundle '{bundle.folder}' acts every {trained} s, this environment every {agent_period} s; "
            f"make it with agent_period={trained}"
        )
    low, high = bundle.policy.tension_range
    own_range = (low, high)
    actor = Actor(bundle.layers, bundle.policy, env)
    if own_range == tuple(tension_range):
        return actor
    _check_reach(f"policy bundle '{bundle.folder}'", low, high, tension_range, bundle.env.keywords.get("control"))

    def act(batch: NDArray[np.float64]) -> NDArray[np.float32]:
        converted = batch[:, :size].copy()
        setpoint = action_to_tension(batch[:, TENSION_SETPOINT], tension_range)
        converted[:, TENSION_SETPOINT] = np.clip(tension_to_action(setpoint, own_range), -1.0, 1.0)
        actions = actor(converted)
        entry = 0 if bundle.policy.is_worn else -1
        tension = action_to_tension(actions[:, entry], own_range)
        actions[:, entry] = tension_to_action(tension, tension_range)
        return actions

    return act


def _check_reach(
    what: str, lowest: float, highest: float, tension_range: tuple[float, float], loop: str | None = None
) -> None:
    """Raise an AmulettError if an environment's actions do not reach a policy's tensions; `loop`: that it is made for.

    All in N.
    """
    low, high = tension_range
    if lowest < low - 1e-9 or highest > high + 1e-9:
        needed = f"{lowest:g} N" if lowest == highest else f"{lowest:g} to {highest:g} N"
        made = f"; it was made for the loop '{loop}': make one with control='{loop}'" if loop in LOOPS else ""
        raise AmulettError(
            f"{what} needs {needed}; the actions of this environment reach from {low:g} to {high:g} N{made}"
        )


def _for_one_or_many(act: Act, size: int) -> Policy:
    """Return a policy that takes a single observation, too."""

    def policy(observation: ArrayLike) -> NDArray[np.float32]:
        observations = np.asarray(observation, dtype=np.float64)
        if observations.ndim not in (1, 2) or observations.shape[-1] != size:
            raise AmulettError(f"the observation has shape {observations.shape}; it has to be ({size},) or (N, {size})")
        actions = act(np.atleast_2d(observations))
        return actions[0] if observations.ndim == 1 else actions

    return policy
