"""Remarks on the device of results: tuned laws of another one, and the user's own."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence

from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.envs.eq6_costs import eq6_costs, shipped_costs
from amulett_gym.envs.prices import divisors_owner
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.diagnosis import diagnose
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.bundle import read_bundle
from amulett_gym.laws.contenders import Contender, bundle_folder, split_loop
from amulett_gym.laws.parametric import is_tuned_file, tuned_names, tuned_over, tuning_differs
from amulett_gym.laws.training import OUTSIDE, other_loop
from amulett_gym.profile import Profile, is_shipped
from amulett_gym.simulation.layout import LOOPS, Control

PAPERS: Control = "decentralized"


def device_remarks(
    profile: Profile,
    contenders: Iterable[str] = (),
    tension_range: tuple[float, float] = TENSION_RANGE,
    places: Mapping[str, str | None] | None = None,
    loops: Iterable[Control] = (PAPERS,),
    suite: str | None = None,
) -> list[str]:
    """Return remarks on a device and contenders, by name, as sentences without a full stop.

    On any device: laws that were tuned on another one, or in another loop. On the user's own device: failures of eq. 6
    in the `suite` by whose costs those of all laws are divided, and the findings of `diagnose` for this tension range
    [N] in each of the `loops` in use. `places` maps names of files that were moved to where they are.
    """
    contenders = list(contenders)
    files = {name: (places or {}).get(name) or split_loop(name)[1] for name in contenders if is_tuned_file(name)}
    elsewhere = [(name, tuning_differs(file, profile, split_loop(name)[0])) for name, file in files.items()]
    remarks = [f"{name} {difference}" for name, difference in elsewhere if difference]
    moved = [name for name in contenders if split_loop(name)[0] and split_loop(name)[1] in tuned_names()]
    remarks += [f"{name} acts with the parameters tuned in the paper's loop" for name in moved]
    over = {name: tuned_over(split_loop(name)[1]) for name in contenders}
    remarks += [
        f"{name} acts with the parameters tuned over the fleet {fleet}, not on the {profile.name}"
        for name, fleet in over.items()
        if fleet and profile not in load_fleet(fleet)
    ]
    shipped = is_shipped(profile)
    tuned = [name for name in contenders if split_loop(name)[1] in tuned_names() and not over[name]]
    if tuned and not (shipped and profile.root == profile.name):
        act = "act" if len(tuned) > 1 else "acts"
        of = f"tuned on the {profile.root}, not on the {profile.name}"
        remarks.append(f"{', '.join(tuned)} {act} with the parameters {of}")
    if shipped:
        return remarks
    if suite is not None:
        remarks += _remarks_on_costs(profile, suite)
    for loop in dict.fromkeys(loops):
        where = f"on the {profile.name}" + (f" in the loop {loop}" if loop != PAPERS else "")
        remarks += [f"{where}, {finding.text}" for finding in diagnose(profile, tension_range, loop)]
    return remarks


def _remarks_on_costs(profile: Profile, suite: str) -> list[str]:
    if shipped_costs(profile) is not None:
        return []
    costs, scenarios = eq6_costs(profile, suite), f"training scenarios of {suite} on the {profile.name}"
    if costs is None:
        why = "it cannot begin them, or they have too many integration steps"
        borrowed = f"costs are divided by those on the {divisors_owner(profile, suite)}"
        return [f"eq6 could not be measured in {scenarios}: {why}; {borrowed}"]
    if costs.failed > 0.0:
        share = f"{100.0 * costs.failed:.2g} %"
        return [f"eq6 fails in {share} of the {scenarios}: costs are divided by its mean costs until then, as rates"]
    return []


def loop_remarks(contenders: Iterable[Contender]) -> list[str]:
    """Return in which loop contenders act that do so by themselves, and which act late.

    These are bundles and tuned laws of a loop, without `loop/`, and contenders with an `action_delay`. The remarks are
    sentences without a full stop.
    """
    contenders = list(contenders)
    delays = [(each.name, each.env_keywords.get("action_delay")) for each in contenders]
    loops = [(each.name, each.env_keywords.get("control")) for each in contenders if not split_loop(each.name)[0]]
    return [
        *(f"{name} acts in its own loop, {loop}, as {loop}/{name} would" for name, loop in loops if loop in LOOPS),
        *(f"{name} acts late, with an action_delay of {delay} control ticks" for name, delay in delays if delay),
    ]


def start_remarks(start: str, devices: Sequence[Profile], control: str) -> list[str]:
    """Return for which other loop the policy was trained from which a training starts, without a full stop.

    A policy that cannot be read has no remark; the training reports it.
    """
    try:
        differences = other_loop(read_bundle(bundle_folder(start)).env, devices, control)
    except AmulettError:
        return []
    return [f"this training starts from {start}, which was trained {'; '.join(differences)}"] if differences else []


def fleet_remarks(remarks: Mapping[str, Iterable[str]]) -> list[str]:
    """Return the remarks on the devices of a fleet, by their names, as sentences without a full stop.

    Remarks that differ only in numbers, the device's name and what of it is outside the ranges of training are one:
    that on the first device, and the other devices.
    """
    alike: dict[str, dict[str, str]] = {}
    for device, texts in remarks.items():
        for text in texts:
            alike.setdefault(_DETAIL.sub("", text.replace(device, "")), {}).setdefault(device, text)
    found = []
    for texts in alike.values():
        (device, text), *others = texts.items()
        if len(texts) == len(remarks) and len(set(texts.values())) == 1:
            found.append(text)
            continue
        named = text if device in text else f"{device}: {text}"
        names = ", ".join([other for other, _ in others][:_NAMED]) + (", ..." if len(others) > _NAMED else "")
        found.append(f"{named} (and {len(others)} of the other devices: {names})" if others else named)
    return found


_DETAIL = re.compile(rf"(?<={OUTSIDE}) in .*|\d[\d.,]*")
_NAMED = 5
"""Most devices that are named after the first one."""


def print_remarks(remarks: Sequence[str]) -> None:
    """Print remarks on stderr, one a line."""
    for remark in remarks:
        print(f"Note: {remark}.", file=sys.stderr, flush=True)
