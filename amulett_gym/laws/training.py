"""What a policy was trained for: devices and control loop, compared with those on which it acts.

A policy is trained over devices whose physics may differ, and belongs to one loop configuration
(`profile.loop_configuration`): what the owner of a device programs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.envs.worn_settings import WornSettings
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import in_words, load_fleet, name_or_contents, outside
from amulett_gym.laws.bundle import TrainingEnv
from amulett_gym.profile import Profile, loop_configuration
from amulett_gym.simulation.layout import CONTROLS, DRIVES

OUTSIDE = "outside their ranges"
"""Words of a sentence about a device, before those on what of it is outside the ranges of the training's devices."""

MOST_NAMED = 3
"""Number of parameters that a sentence names."""


def trained_on(env: TrainingEnv) -> tuple[Profile, ...]:
    """Return the devices that a policy was trained on: one, or those of a fleet.

    Raises
    ------
    AmulettError
        If this version cannot read them.
    """
    fleet = env.keywords.get("fleet")
    return _loaded(json.dumps(fleet or [env.keywords.get("profile", "testbed")]))


@lru_cache(maxsize=16)  # a fleet's content takes half a second
def _loaded(fleet: str) -> tuple[Profile, ...]:
    return load_fleet(json.loads(fleet))


def control_of(env: TrainingEnv) -> str:
    """Return the control loop that a policy was trained in."""
    others = {DRIVES_ID: DRIVES, WORN_ID: WornSettings.model_fields["control"].default}
    return str(env.keywords.get("control", others.get(env.id, CONTROLS[0])))


def devices_in_words(env: TrainingEnv) -> str:
    """Return the devices of a training, such as ``the testbed`` or ``the fleet plausible of 64 devices``.

    Raises
    ------
    AmulettError
        If this version cannot read them.
    """
    profiles = trained_on(env)
    if not env.keywords.get("fleet"):
        return f"the {profiles[0].name}"
    name = name_or_contents(profiles)
    return f"{in_words(name)} of {len(profiles)} devices" if isinstance(name, str) else in_words(name)


def other_device(env: TrainingEnv, device: Profile) -> str:
    """Return how the devices of a training differ from a device, as the end of "was trained"; empty if they do not."""
    try:
        profiles = trained_on(env)
    except AmulettError:
        return "on a device that this version cannot read"
    if not env.keywords.get("fleet"):
        trained = profiles[0]
        if trained == device:
            return ""
        version = "another version of the " if trained.name == device.name else "the "
        return f"on {version}{trained.name}, not the {device.name}"
    there = f"on {devices_in_words(env)}"
    if device in profiles:
        return f"{there} with the {device.name}"
    beyond = [f"{key} {values}" for key, values in outside(device, profiles).items()]
    which = f"{OUTSIDE} in {_listed(beyond)}" if beyond else "within their ranges"
    return f"{there} without the {device.name}, which is {which}"


def other_loop(env: TrainingEnv, devices: Sequence[Profile], control: str) -> list[str]:
    """Return how the loop of a training differs from that of devices, as ends of "was trained"; empty if it does not.

    Compared are the control loop, `control`, and what both configurations have of it.
    """
    there, found = control_of(env), []
    if there != control:
        found.append(f"in the loop {there}, not {control}")
    try:
        trained = [loop_configuration(profile, there) for profile in trained_on(env)]
    except AmulettError:
        return found
    here = [loop_configuration(device, control) for device in devices]
    changes = [f"{key} {_values(trained, key)} (here {_values(here, key)})" for key in _differing(trained, here)]
    return [*found, f"for {_listed(changes)}"] if changes else found


def _differing(trained: Sequence[Mapping[str, Any]], here: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the keys that all configurations have, and of which a device here has a value that no trained one had."""
    shared = [key for key in trained[0] if key in here[0]]
    return [key for key in shared if any(one[key] not in [each[key] for each in trained] for one in here)]


def _values(configurations: Sequence[Mapping[str, Any]], key: str) -> str:
    values = (each[key] for each in configurations)
    return " or ".join(dict.fromkeys(f"{each:.4g}" if isinstance(each, float) else str(each) for each in values))


def _listed(entries: Sequence[str]) -> str:
    """Return entries, the first few by name and the others by their number."""
    named, rest = entries[:MOST_NAMED], len(entries) - MOST_NAMED
    return ", ".join([*named, f"and {rest} more"] if rest > 0 else named)
