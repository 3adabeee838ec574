"""Model cards: what a policy was trained on and for, what it needs, how it scored, where its limits are.

A training writes one into each bundle (``card.md``), from the bundle's own description and provenance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.envs.worn_reward import WORN_TERMS, doffed_cost
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import ranges
from amulett_gym.laws.bundle import Bundle, PolicyDescription, TrainingEnv, read_bundle, write_bundle
from amulett_gym.laws.training import control_of, devices_in_words, trained_on
from amulett_gym.profile import Profile, loop_configuration

_SHOWN = ("cost", "position", "effort", "tension", "contact", *WORN_TERMS[:-1], "failures")
"""Scores on validation that a card shows, where a bundle has them."""


def model_card(
    policy: PolicyDescription, env: TrainingEnv, provenance: Mapping[str, Any], limits: Sequence[str] = ()
) -> str:
    """Return a policy's model card as Markdown; `limits` are sentences on what is known beside its description."""
    try:
        devices, profiles = devices_in_words(env), trained_on(env)
    except AmulettError:
        devices, profiles = "a device that this version cannot read", ()
    algorithm = provenance.get("algorithm", "a policy")
    sections = {
        "Trained on": _training(devices, env, policy, provenance),
        "For which loop": _loop(env, profiles),
        "Inputs and outputs": _interface(policy, env),
        "Scores": _scores(provenance, env),
        "Limits": [*_limits(policy, profiles, env), *limits],
    }
    parts = [f"# Model card: {algorithm}, trained on {devices}"]
    parts += [f"## {title}\n\n" + "\n".join(f"- {line}" for line in lines) for title, lines in sections.items()]
    text = "\n\n".join(parts) + "\n"
    return "".join(each if each == "\n" or each.isprintable() else "?" for each in text)


def card_of(bundle: Bundle) -> str:
    """Return a bundle's model card; one that was written without gets it from its description."""
    return bundle.card if bundle.card is not None else model_card(bundle.policy, bundle.env, bundle.provenance)


def rewrite_card(folder: str | Path, limits: Sequence[str]) -> Path:
    """Write a bundle's model card anew, with sentences on its limits; the other files stay as they are."""
    found = read_bundle(folder)
    card = model_card(found.policy, found.env, found.provenance, limits)
    return write_bundle(folder, found.layers, found.policy, found.env, found.provenance, card, found.critic)


def _training(devices: str, env: TrainingEnv, policy: PolicyDescription, provenance: Mapping[str, Any]) -> list[str]:
    keywords, found = env.keywords, [f"Devices: {devices}."]
    steps = "without a time limit" if env.max_episode_steps < 0 else f"of {env.max_episode_steps} agent steps"
    suite, split = keywords.get("suite", "steps"), keywords.get("split", "train")
    found.append(
        f"Task: scenarios of the suite `{suite}`, split `{split}`; episodes {steps} of {policy.agent_period:g} s."
    )
    amount = [f"{provenance['steps']:,} agent steps"] if isinstance(provenance.get("steps"), int) else []
    amount += [f"seed {provenance['seed']}"] if isinstance(provenance.get("seed"), int) else []
    if isinstance(seconds := _dict(provenance, "validation").get("seconds"), int | float):
        amount.append(f"{seconds / 60.0:.1f} minutes until this policy was reached")
    found += [f"Training: {', '.join(amount)}."] if amount else []
    if start := _dict(_dict(provenance, "config"), "network").get("start"):
        found.append(f"Began as the policy `{start}`.")
    if isinstance(command := provenance.get("command"), list):
        found.append(f"Command: `{' '.join(map(str, command))}`.")
    if versions := _dict(provenance, "versions"):
        found.append(f"Software: {', '.join(f'{name} {number}' for name, number in versions.items())}.")
    return found


def _loop(env: TrainingEnv, profiles: Sequence[Profile]) -> list[str]:
    control = control_of(env)
    found = [f"Control loop: `{control}`{', the loop of the paper' if control == 'decentralized' else ''}."]
    configurations = [loop_configuration(profile, control) for profile in profiles]
    shared = configurations[0] if configurations else {}
    values = {key: dict.fromkeys(_word(each[key]) for each in configurations) for key in shared}
    lines = [f"`{key}` {' or '.join(each)}" for key, each in values.items()]
    return [*found, *([f"Its configuration: {', '.join(lines)}."] if lines else [])]


def _interface(policy: PolicyDescription, env: TrainingEnv) -> list[str]:
    counts = {"observations of the environment": len(policy.observations), "features of them": len(policy.features)}
    counts["means over the episode"] = len(policy.memory or ())
    inputs = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    stack = f", of the newest {policy.history} agent steps" if policy.history > 1 else ""
    low, high = policy.tension_range
    output = f"Output: every {policy.agent_period:g} s, a tension setpoint from {low:g} to {high:g} N"
    if env.id == DRIVES_ID:
        output += f" and a mean drive angle up to {policy.mean_angle_range:g} deg"
    if policy.is_worn:
        output += " and an assistance from 0 to 1"
    if policy.follow < 1.0:
        output += f"; it moves {100.0 * policy.follow:.0f} % of the way to the output of the network"
    if delay := env.keywords.get("action_delay"):
        output += f"; its ramp begins {delay} control ticks after the observation"
    layers = "-".join(map(str, policy.network.layers))
    return [f"Input: {inputs}{stack}.", f"{output}.", f"Network: {layers}, {policy.network.activation}; numpy runs it."]


def _scores(provenance: Mapping[str, Any], env: TrainingEnv) -> list[str]:
    validation = _dict(provenance, "validation")
    scores = [f"{name} {_word(validation[name])}" for name in _SHOWN if name in validation]
    if not scores:
        return ["None were recorded."]
    where = f"{validation.get('episodes', 'some')} scenarios of the split `{validation.get('split', 'validation')}`"
    fleet = f" on the fleet {validation['fleet']}" if isinstance(validation.get("fleet"), str) else ""
    unit = "1 is the cost of eq. 6"
    if env.id == WORN_ID:
        doffed = doffed_cost(_dict(env.keywords, "reward_weights"))
        unit = f"{_word(doffed)} is that of the same wearers in 10 s without the device"
    return [f"In {where}{fleet}, by which the policy was chosen: {', '.join(scores)} ({unit})."]


def _limits(policy: PolicyDescription, profiles: Sequence[Profile], env: TrainingEnv) -> list[str]:
    found = ["Trained and judged in simulation; it has not acted on a real device."]
    found.append("It belongs to the loop above. On a device with another one, amulett-gym names what differs.")
    if len(profiles) > 1:
        spread = [f"`{key}` {each}" for key, each in ranges(profiles).items() if " to " in each]
        found.append(f"Nothing is known beyond the physics of its devices: {', '.join(spread)}.")
    elif profiles:
        around = " and what its suite draws around it" if env.keywords.get("suite") == "mixed" else ""
        found.append(f"It knows one device, the {profiles[0].name}{around}; nothing is known of other physics.")
    floors = {profile.sensors.force_floor for profile in profiles}
    if floors and policy.tension_range[0] < max(floors) and not policy.is_worn:
        floor = _word(max(floors))
        found.append(
            f"Setpoints below {floor} N, where the force cannot be estimated, command a release of the string, not a "
            'force (docs/environments.md, "Setpoints below the floor").'
        )
    if policy.is_worn:
        found.append(
            "Its wearers are models with parameters from the literature (docs/wearer.md); no person wore the device."
        )
    if policy.is_privileged:
        found.append("It observes hidden state, which no real device measures: a reference, not a controller.")
    return found


def _dict(content: Mapping[str, Any], key: str) -> dict[str, Any]:
    found = content.get(key)
    return found if isinstance(found, dict) else {}


def _word(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
