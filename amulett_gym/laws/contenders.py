"""Contenders by name: what can be compared, as environment keywords with a policy.

Some contenders act inside the loop (eq. 6 at control rate, position control alone) and are chosen by a keyword of the
environment; the others act from outside, through :func:`amulett_gym.laws.policies.load_policy`. A name ``loop/law`` is
that of a law in another control loop than the paper's, such as ``co-rotation/constant:10``. Without a loop, a law acts
in the paper's; a bundle or a tuned law's file in the loop that it was trained or tuned in.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, WORN_ID
from amulett_gym.errors import AmulettError, nearest, unknown
from amulett_gym.gains import Loops, group_name
from amulett_gym.laws.bundle import MANIFEST, read_bundle
from amulett_gym.laws.parametric import is_tuned_file, read_tuned, tuned_loop, tuned_names
from amulett_gym.simulation.layout import CONTROLS, DRIVES, LOOPS, Control
from amulett_gym.storage.reading import read_text, user_path

CONSTANT = "constant:"

_PRETRAINED = "robust"

PRETRAINED = {
    "pretrained": _PRETRAINED,
    "pretrained:tension": _PRETRAINED,
    "pretrained:testbed": "testbed",
    "pretrained:device": "device",
}
"""Folders in `amulett_gym/policies`, by name; each holds a bundle and its model card. A policy acts in
`Amulett/Scaling-v0` and `Amulett/Tension-v0` alike, so `pretrained:tension` is another name of `pretrained`."""

IN_THE_LOOP: dict[str, dict[str, Any]] = {
    "eq6": {"tension_law": "eq6"},
    "eq6-printed": {"tension_law": "eq6-printed"},
    "position-only": {"control": "position-only"},
}
"""Contenders that act within the loop: the environment's keywords."""

EQ6_HELD = {"eq6-held": False, "eq6-held-printed": True}
"""Eq. 6 from outside the loop, at agent rate: whether as printed, instead of as the text describes it."""

_DESCRIPTIONS = {
    "eq6": "eq. 6 as the text describes it, inside the loop at control rate",
    "eq6-printed": "eq. 6 exactly as printed, inside the loop at control rate",
    "position-only": "position control alone: a fixed co-contraction, no tension loop",
    "eq6-held": "eq. 6 as the text describes it, from outside at agent rate",
    "eq6-held-printed": "eq. 6 exactly as printed, from outside at agent rate",
    "pretrained": "a policy for all plausible devices (PPO on mixed); card: amulett config validate pretrained --show",
    "pretrained:tension": "another name of pretrained",
    "pretrained:testbed": "the best learned policy that was trained on the shipped testbed alone (PPO on mixed)",
    "pretrained:device": "a small policy of the testbed that fits a microcontroller: amulett export pretrained:device",
    "constant:<N>": "a constant tension setpoint in newtons, for example constant:10",
    "<folder>": "a policy bundle, or the folder of a training run (its best policy)",
    "<file.json>": "a tuned law, from `amulett tune-law`",
    "<file.py:function>": "your own function from observations to actions; the file is run",
    "<loop>/<law>": "any of these in another control loop, for example co-rotation/constant:10",
}


@dataclass(frozen=True)
class Contender:
    """One entry of a comparison.

    `env_keywords` are the environment's keywords that it needs; `policy_name` is for `load_policy`, None where the
    environment's loop decides and actions are ignored. `env_id` is the only environment in which it can act; None: any
    in which an action is a tension, or, of your own, the comparison's.
    """

    name: str
    env_keywords: dict[str, Any] = field(default_factory=dict)
    policy_name: str | None = None
    env_id: str | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Own(Contender):
    """A contender of your own, such as ``Own("mine", {"agent_period": 0.1}, act=function)``.

    Attributes
    ----------
    act : callable
        Maps observations, a float32 array of shape (N, 13), see `envs.transition.OBSERVATIONS`, to actions, shape
        (N, 1) or (N,), in `Amulett/Drives-v0` (N, 2), in [-1, 1]. It is called once per agent step for all scenarios;
        its method ``reset``, if there is one, is called with N before the first step.
    """

    act: Callable[[NDArray[np.float32]], Any] | None = None


C = TypeVar("C", bound=Contender)


def contender_names() -> dict[str, str]:
    """Return the contenders' names (five of them patterns), each with a one-line description."""
    entries = list(_DESCRIPTIONS.items())
    return dict([*entries[:-5], *tuned_names().items(), *entries[-5:]])


def loop_names() -> dict[str, str]:
    """Return the names of the control loops in which a law chooses the co-contraction, each with one line."""
    return {
        "decentralized": "the paper's: PIDs of the joint position and of the antagonist's tension",
        "position-only": "the paper's without tension controller: a fixed co-contraction",
        **{loop: str(Loops.model_fields[group_name(loop)].description) for loop in LOOPS},
    }


def split_loop(name: str) -> tuple[str, str]:
    """Return the control loop, empty if none is named, and the law in a name like ``co-rotation/constant:10``.

    Raises
    ------
    AmulettError
        If a loop is named without a law, or two are.
    """
    loop, slash, law = name.partition("/")
    if not slash or loop not in CONTROLS:
        return "", name
    if not law.strip("/"):
        raise AmulettError(
            f"'{name}' names a loop and no law; write {loop}/<law>, for example {loop}/constant:10; "
            f"a folder of this name is ./{name}"
        )
    second = law.partition("/")[0]
    if second in CONTROLS and law != second:
        raise AmulettError(f"'{name}' names two loops; write {law}, or for a law in a folder {loop}/./{law}")
    return loop, law


def loops_of(contenders: Iterable[Contender]) -> tuple[Control, ...]:
    """Return the loops in which contenders act; those of `Amulett/Drives-v0` act in none."""
    loops = [contender.env_keywords.get("control", CONTROLS[0]) for contender in contenders]
    return tuple(dict.fromkeys(loop for loop in loops if loop != DRIVES))


def in_loop(contender: C, loop: str) -> C:
    """Return a contender in a control loop, under the name ``loop/law``; as it is where it acts in that loop anyway.

    Raises
    ------
    AmulettError
        If the contender needs another loop, or the loop controls no tension.
    """
    own = DRIVES if contender.env_id == DRIVES_ID else contender.env_keywords.get("control", CONTROLS[0])
    if not loop or loop == own == CONTROLS[0]:
        return contender
    name = f"{loop}/{contender.name}"
    if own == DRIVES:
        raise AmulettError(
            f"'{name}' is no contender: '{contender.name}' acts in {DRIVES_ID} alone, on both drives; write it without "
            "a loop"
        )
    if "position-only" in (loop, own):
        other = "" if loop == "position-only" else f", or a law in the loop '{loop}', for example {loop}/constant:10"
        raise AmulettError(
            f"'{name}' is no contender: 'position-only' is a loop with a fixed co-contraction, which no law sets; "
            f"write position-only{other}"
        )
    return replace(contender, name=name, env_keywords={**contender.env_keywords, "control": loop})


def parse_contender(name: str) -> Contender:
    """Return a contender by a name of `contender_names`, in which patterns are filled in.

    Raises
    ------
    AmulettError
        If the name is unknown, a tension is no number of at least 0, or a file or folder is not valid.
    """
    loop, law = split_loop(name)
    if loop:
        return in_loop(parse_contender(law), loop)
    if name in IN_THE_LOOP:
        return Contender(name, dict(IN_THE_LOOP[name]))
    if name.startswith(CONSTANT):
        constant_tension(name)
    elif is_tuned_file(name):
        read_tuned(name)
        return Contender(name, own_loop(tuned_loop(name)), name)
    elif name not in EQ6_HELD and name not in tuned_names():
        folder = bundle_folder(name)
        bundle = read_bundle(folder)
        policy = bundle.policy
        keywords: dict[str, Any] = {"agent_period": policy.agent_period}
        if policy.is_privileged:
            keywords["privileged"] = True
        if delay := bundle.env.keywords.get("action_delay"):
            keywords["action_delay"] = delay
        if bundle.env.id == DRIVES_ID:
            keywords |= {"control": DRIVES, "mean_angle_range": policy.mean_angle_range}
            return Contender(name, keywords, str(folder), env_id=DRIVES_ID)
        keywords |= own_loop(bundle.env.keywords.get("control"))
        return Contender(name, keywords, str(folder), env_id=WORN_ID if policy.is_worn else None)
    return Contender(name, policy_name=name)


def own_loop(control: Any) -> dict[str, Any]:
    """Return the keyword of the loop that a policy was made for; none if that is the paper's."""
    return {"control": control} if control in LOOPS else {}


def python_file(name: str) -> Path | None:
    """Return the file in a name like ``mylaw.py:function``; None if the name is not of that form."""
    path, _, _ = name.rpartition(":")
    return Path(path) if path.endswith(".py") else None


def no_function(name: str) -> AmulettError:
    """Return the error for a Python file without a function; it names the file's functions of one argument."""
    path = name.rstrip(":")
    found = _functions(Path(path))
    choices = f", {' or '.join(f'{path}:{each}' for each in found)}" if len(found) > 1 else ""
    only = f"; did you mean '{path}:{found[0]}'?" if len(found) == 1 else ""
    return AmulettError(f"'{name}' names no function of a Python file; write {path}:function{choices}{only}")


def _functions(path: Path) -> list[str]:
    """Return the names of a Python file's public functions that can be called with one argument; it is not run."""
    try:
        tree = ast.parse(read_text(path, "Python file"))
    except (AmulettError, SyntaxError, ValueError, RecursionError):
        return []
    found = []
    for each in tree.body:
        if isinstance(each, ast.FunctionDef) and not each.name.startswith("_"):
            given, most = each.args, len(each.args.posonlyargs) + len(each.args.args)
            fewest = most - len(given.defaults)
            needs_keyword = None in given.kw_defaults
            if fewest <= 1 and (most >= 1 or given.vararg) and not needs_keyword:
                found.append(each.name)
    return found


def constant_tension(name: str) -> float:
    """Return the tension setpoint [N] in a name like ``constant:10``; refuse negative and infinite ones."""
    text = name.removeprefix(CONSTANT)
    try:
        tension = float(text)
    except ValueError:
        tension = math.nan
    if not 0 <= tension < math.inf:
        raise AmulettError(
            f"'{name}' has to name a tension in N of at least 0, for example constant:10; it has '{text}'"
        )
    return tension


def bundle_folder(name: str) -> Path:
    """Return the folder of a policy bundle: a shipped one, `name` itself, or its ``best`` if it is a training run's.

    Raises
    ------
    AmulettError
        If `name` is neither a shipped policy nor such a folder.
    """
    if not name:
        raise unknown("policy", name, contender_names())
    if name in PRETRAINED:
        return Path(str(resources.files("amulett_gym") / "policies" / PRETRAINED[name]))
    folder = user_path(name)
    try:
        for candidate in (folder, folder / "best"):
            if (candidate / MANIFEST).is_file():
                return candidate
    except OSError as error:
        raise AmulettError(f"cannot read policy bundle '{name[:100]}': {error.strerror or error}") from error
    if python_file(name) is not None:
        raise AmulettError(f"'{name}' is code; evaluate, simulate and play run it, or amulett_gym.laws.own.load_own")
    if name.endswith(".py"):
        raise no_function(name)
    if folder.is_dir():
        raise AmulettError(f"'{name}' holds no policy bundle: it has neither manifest.json nor best/manifest.json")
    if folder.exists():
        hint = "; a zip of Stable-Baselines3 is loaded by amulett_agents.load_sb3_zip" if name.endswith(".zip") else ""
        raise AmulettError(f"'{name}' is a file; a policy bundle is a folder that holds manifest.json{hint}")
    loop, slash, law = name.partition("/")
    if slash and _is_law(law):
        if loop == DRIVES:
            raise AmulettError(
                f"'{name}': no law of a tension acts in '{DRIVES}', the loop of {DRIVES_ID}, where a policy trained "
                f"there acts, written without a loop; other loops are {', '.join(sorted(CONTROLS))}"
            )
        raise unknown("control loop", loop, CONTROLS)
    if loop == DRIVES and any((user_path(law) / place / MANIFEST).is_file() for place in ("", "best")):
        raise AmulettError(f"'{name}' is no contender: write '{law}'; a policy trained in {DRIVES_ID} acts there")
    if slash:
        hint = nearest(loop, LOOPS) if len(folder.parts) == 2 else ""
        raise AmulettError(f"there is no policy bundle '{name}': the folder does not exist{hint}")
    if name in LOOPS:
        raise AmulettError(f"'{name}' is a control loop, not a law; write {name}/<law>, for example {name}/constant:10")
    raise unknown("policy", name, contender_names())


def _is_law(name: str) -> bool:
    return name in contender_names() or name.startswith(CONSTANT) or is_tuned_file(name)
