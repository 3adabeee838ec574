"""What the page offers: devices, control loops, laws with their parameters, and tasks, as data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from amulett_gym.envs.action import FEED_FORWARD_RANGE, TENSION_RANGE
from amulett_gym.errors import AmulettError, unknown
from amulett_gym.fleet import device_of, load_fleet
from amulett_gym.laws.contenders import (
    CONSTANT,
    EQ6_HELD,
    PRETRAINED,
    Contender,
    constant_tension,
    contender_names,
    loop_names,
    parse_contender,
    split_loop,
)
from amulett_gym.laws.parametric import BEST_CONSTANT, EQ6_TUNED, Parameter, is_tuned, is_tuned_file, tuned_vector
from amulett_gym.live.core.data import device_data, policy_data, scenario_data
from amulett_gym.live.core.hex import DEVICE, FIRMWARE
from amulett_gym.profile import Profile, device_names, load_profile
from amulett_gym.simulation.layout import CONTROLS, LOOPS
from amulett_gym.simulation.random import keys_from_seeds
from amulett_gym.tasks.scenario import Scenario, load_scenario, unpack
from amulett_gym.tasks.suites import SUITES, episode_keys, sample

FLEET = "plausible-held-out"
"""Shipped fleet of which the page shows `SHOWN` devices."""

SHOWN = ("held-out-01", "held-out-05", "held-out-10", "held-out-20")

LIMITS = {"setpoint": math.radians(140.0), "push": 0.8, "payload": 2.0, "obstacle": 50.0}
"""Largest setpoint [rad], push [N m], payload [kg] and stiffness of an obstacle [N m/rad] on the page."""

SHOWN_TUNED = ("eq6-tuned", "parametric", "parametric:plausible")
SHOWN_LEARNED = ("pretrained", "pretrained:testbed", "pretrained:device")

SHOWN_LOOPS = (*CONTROLS, FIRMWARE)

SEED, SPLIT = 0, "held-out"
"""Of the episode that is shown of each suite."""

TOUR = [
    [0.5, "setpoint", math.radians(60.0)],
    [2.5, "push", 0.25],
    [2.8, "push", 0.0],
    [4.0, "setpoint", math.radians(20.0)],
    [5.5, "push", -0.25],
    [5.8, "push", 0.0],
    [7.0, "obstacle", {"angle": math.radians(55.0), "side": 1, "stiffness": 8.0}],
    [7.3, "setpoint", math.radians(62.0)],
    [8.8, "setpoint", math.radians(30.0)],
    [10.5, "obstacle", None],
    [11.5, "payload", 0.3],
    [12.0, "setpoint", math.radians(80.0)],
    [14.0, "setpoint", 0.0],
]
"""Inputs that come by themselves: time [s], what, and its value in the units of `LIMITS`."""

TOUR_SECONDS = 16.0
"""After so many seconds the tour begins anew, until somebody touches something."""


@dataclass(frozen=True)
class Choices:
    """Lists of what can be chosen, as JSON types, and what is chosen first.

    `start` holds the ids of device, loop, law and task. `policies` are the files of the bundles that laws name, in
    base64.
    """

    start: dict[str, Any]
    devices: list[dict[str, Any]]
    loops: list[dict[str, Any]]
    laws: list[dict[str, Any]]
    policies: dict[str, dict[str, str]]
    tasks: list[dict[str, Any]]

    def content(self) -> dict[str, Any]:
        """Return the choices as JSON types."""
        ranges = {loop: list(FEED_FORWARD_RANGE if loop in LOOPS else TENSION_RANGE) for loop in SHOWN_LOOPS}
        return {**vars(self), "limits": LIMITS, "ranges": ranges, "profile": _profiles()}


def choices(profile: Any, policies: Sequence[str], scenario: Any, loop: str | None) -> Choices:
    """Return what the page offers. Parameters and errors as of `page.build_page`."""
    own, task = _named(load_profile(profile)), None if scenario is None else load_scenario(scenario)
    if loop is not None and loop not in SHOWN_LOOPS:
        raise unknown("control loop", loop, SHOWN_LOOPS)
    contenders = [(name, parse_contender(name)) for name in dict.fromkeys(policies)]
    devices = [_device(each, group) for each, group in _devices(own)]
    shipped = {law["id"]: law for law in _laws(own)}
    added = [_own_law(name, contender, own, shipped) for name, contender in contenders]
    laws = list((shipped | {law["id"]: law for law in added}).values())
    first = added[0] if added else shipped["pretrained"]
    loop = loop or first.get("loop", CONTROLS[0])
    if reason := next(each for each in devices if each["id"] == own.name)["unfit"].get(loop):
        raise AmulettError(f"the control loop '{loop}' does not fit the device '{own.name}': {reason}")
    tasks = _tasks(own, task, "own" if isinstance(scenario, Mapping | Scenario) else str(scenario))
    start = {
        "device": own.name,
        "loop": loop,
        "law": {"name": first["id"], "parameters": {each["name"]: each["value"] for each in first["parameters"]}},
        "task": tasks[0]["id"],
        "seed": 0,
        "speed": 1,
    }
    policies_of = {law["content"]["policy"] for law in laws if law["content"]["name"] == "policy"}
    return Choices(start, devices, _loops(), laws, {name: policy_data(name) for name in sorted(policies_of)}, tasks)


def _devices(own: Profile) -> Iterable[tuple[Profile, str]]:
    """Yield the devices with the headings above them; one of the user's own comes first."""
    shipped = [(load_profile(name), "Shipped") for name in reversed(device_names())]
    fleet = load_fleet(FLEET)
    found = [*shipped, *((device_of(fleet, name), "Plausible") for name in SHOWN)]
    if own not in [each for each, _ in found]:
        yield own, "Your own"
    yield from found


def _profiles() -> dict[str, Any]:
    """Return what a profile that is dropped on the page is checked with: its schema, and the shipped ones as bases."""
    bases = {name: load_profile(name).model_dump(mode="json") for name in reversed(device_names())}
    return {"schema": _plain_schema(Profile.model_json_schema()), "bases": bases}


def _plain_schema(schema: Any) -> Any:
    """Return a JSON schema without descriptions, and with references as the present pydantic writes them."""
    if isinstance(schema, list):
        return [_plain_schema(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    (inner,) = schema.get("allOf", [{}])  # of pydantic before 2.9
    kept = {key: value for key, value in {**schema, **inner}.items() if key not in ("allOf", "title")}
    if isinstance(kept.get("description"), str):
        del kept["description"]
    return {key: _plain_schema(value) for key, value in kept.items()}


def _named(own: Profile) -> Profile:
    """Return a profile under another name if it has that of a shipped one and is not that one."""
    shipped = [load_profile(name) for name in device_names()]
    is_other = own.name in [each.name for each in shipped] and own not in shipped
    return own.model_copy(update={"name": f"{own.name} (own)"}) if is_other else own


def _device(profile: Profile, group: str) -> dict[str, Any]:
    content = device_data(profile)
    parameters = content["parameters"]
    geometry = {
        "jointRadius": parameters["joint_radius"],
        "driveRadius": parameters["drive_radius"],
        "maxForce": parameters["max_force"],
    }
    return {
        "id": profile.name,
        "title": profile.name,
        "group": group,
        "description": profile.description,
        "unfit": content["unfit"],
        "geometry": geometry,
        "content": content,
    }


def _loops() -> list[dict[str, Any]]:
    chip = f"the paper's loop and eq. 6 for the {DEVICE} as the firmware's hex file, on a simulated ATmega2560"
    return [
        {"id": name, "title": name.replace("-", " "), "description": description}
        for name, description in (loop_names() | {FIRMWARE: chip}).items()
    ]


def _laws(own: Profile) -> list[dict[str, Any]]:
    """Return the shipped laws: constant, eq. 6, tuned and learned ones."""
    names = contender_names()
    nominal, minimum, offset = (parameter for parameter in EQ6_TUNED.parameters[:3])
    of_paper = own.variable_stiffness
    eq6 = [
        _parameter(nominal, of_paper.nominal_tension),
        _parameter(minimum, of_paper.minimum_tension),
        {**_parameter(offset, of_paper.error_offset_deg), "name": "error_offset_deg"},
    ]
    tension = {**_parameter(BEST_CONSTANT.parameters[0], 8.0), "low": FEED_FORWARD_RANGE[0]}
    laws = [
        _law("constant", "constant tension", "Hand-made", "the same tension all the time", [tension]),
        _law("eq6", "eq. 6", "Hand-made", names["eq6"], eq6),
        _law("eq6-held", "eq. 6, every 20 ms", "Hand-made", names["eq6-held"], eq6),
    ]
    laws += [_tuned(name, own) for name in SHOWN_TUNED]
    return [*laws, *(_learned(name, names[name].partition(";")[0]) for name in SHOWN_LEARNED)]


def _own_law(name: str, contender: Contender, own: Profile, shipped: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the entry of a law that was asked for, with the loop that it was made for."""
    law_name = split_loop(name)[1]
    shown = {"group": "Your own", "loop": contender.env_keywords.get("control", CONTROLS[0])}
    if contender.env_id is not None:
        raise AmulettError(f"'{name}' acts in {contender.env_id} alone; the page shows laws that choose a tension")
    if law_name in shipped:
        return {**shipped[law_name], "loop": shown["loop"]}
    if law_name.startswith(CONSTANT):
        law = shipped["constant"]
        parameters = [{**law["parameters"][0], "value": constant_tension(law_name)}]
        return {**law, **shown, "id": law_name, "title": law_name, "parameters": parameters}
    if is_tuned(law_name):
        return {**_tuned(law_name, own), **shown}
    if law_name == "position-only":
        raise AmulettError("'position-only' is a control loop in which no law acts; give --loop position-only")
    if contender.policy_name is None or law_name in EQ6_HELD:
        raise AmulettError(f"the page does not show '{law_name}'; it shows {', '.join(shipped)} and your own")
    return {**_learned(law_name, "a policy of your own"), **shown}


def _law(name: str, title: str, group: str, description: str, parameters: list[dict[str, Any]]) -> dict[str, Any]:
    about = {"id": name, "title": title, "group": group, "description": description}
    return {**about, "parameters": parameters, "content": {"name": name}}


def _tuned(name: str, own: Profile) -> dict[str, Any]:
    """Return a law with tuned parameters, by its name or file; those of the testbed where it was not tuned on `own`."""
    try:
        law, vector = tuned_vector(name, own)
    except AmulettError:
        if is_tuned_file(name):
            raise
        law, vector = tuned_vector(name, load_profile("testbed"))
    parameters = [_parameter(each, value) for each, value in zip(law.parameters, vector.tolist(), strict=True)]
    title = Path(name).stem if is_tuned_file(name) else name
    content = {"name": law.name, "range": list(law.range)}
    return {**_law(name, title, "Tuned", law.description, parameters), "content": content}


def _learned(name: str, description: str) -> dict[str, Any]:
    title = name if name in PRETRAINED else Path(name).name
    return {**_law(name, title, "Learned", description, []), "content": {"name": "policy", "policy": name}}


def _parameter(parameter: Parameter, value: float) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "title": parameter.name.replace("_", " "),
        "unit": parameter.unit,
        "low": parameter.low,
        "high": parameter.high,
        "value": min(max(value, parameter.low), parameter.high),
        "meaning": parameter.meaning,
        "logarithmic": parameter.logarithmic,
    }


def _tasks(own: Profile, task: Scenario | None, name: str) -> list[dict[str, Any]]:
    """Return the tasks: one of the user's own, a tour, a free one, and a held-out episode of each suite."""
    tour = "setpoints, pushes, an obstacle and a payload; again and again until you touch something"
    tasks = [
        {**_task("tour", "a tour", "", tour, Scenario()), "script": TOUR, "repeat": TOUR_SECONDS},
        _task("free", "free", "", "nothing happens but what you do", Scenario()),
    ]
    if task is not None:  # the first one is shown first
        tasks.insert(0, _task("own", Path(name).stem[:40], "Your own", "a scenario of your own", task))
    keys = episode_keys(keys_from_seeds(np.array([SEED], dtype=object)), np.zeros(1, dtype=np.uint64), SPLIT)
    for suite, description in SUITES.items():
        row = sample(suite, keys, own, split=SPLIT)
        tasks.append(_task(suite, suite.replace("-", " "), "An episode of a suite", description, unpack(row[0])))
    return tasks


def _task(name: str, title: str, group: str, description: str, scenario: Scenario) -> dict[str, Any]:
    about = {"id": name, "title": title, "group": group, "description": description}
    return {**about, "scenario": scenario_data(scenario), "script": []}
