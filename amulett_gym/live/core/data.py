"""Devices, scenarios and policies as JSON, for ``core.js``."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.prices import prices
from amulett_gym.envs.reward import TRACKS
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import fleet_names
from amulett_gym.laws.bundle import FILES, MANIFEST, read_bundle
from amulett_gym.laws.contenders import bundle_folder
from amulett_gym.laws.parametric import DEFAULT_SUITE, EQ6_TUNED, PARAMETRIC, Device, tuned_content
from amulett_gym.live.core.hex import FIRMWARE, OTHER_DEVICE, is_of_hex
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import LOOPS, pack_loop, pack_parameters, unfit_loops
from amulett_gym.tasks.scenario import Scenario

FORMAT, VERSION = "amulett-live-device", 1

_SQUARED_DEGREES = math.degrees(1.0) ** 2
_UNITS = (_SQUARED_DEGREES, _SQUARED_DEGREES, 1.0, 1.0)  # of the costs: rad2 to deg2


def device_data(profile: Profile, suite: str = DEFAULT_SUITE) -> dict[str, Any]:
    """Return a device, with all loops that fit it, as JSON types.

    Parameters
    ----------
    profile : Profile
    suite : str
        Suite of the environment by whose divisors costs are divided. On a device that is not shipped, they are measured
        once, which takes seconds (`envs.eq6_costs`).

    Returns
    -------
    dict
        Numbers are those of `layout.PARAMETERS` and `layout.LOOP_PARAMETERS`, infinite ones as text; tables are 64-bit
        numbers in base64; `prices` have a row for each of `layout.FAMILIES`, for costs in rad.
    """
    parameters, position_only = (pack_parameters(profile, control) for control in ("decentralized", "position-only"))
    unfit = unfit_loops(profile)
    loops = {loop: pack_loop(profile, loop) for loop in LOOPS if loop not in unfit}
    tables = _tables(parameters) | next((_loop_tables(record) for record in loops.values()), {})
    if tables.get("loop_force_table") == tables["force_table"]:
        del tables["loop_force_table"]  # the string is the spring
    numbers = _numbers(parameters)
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": profile.name,
        "angleLimitDeg": profile.plant.angle_limit_deg,
        "orientation": profile.plant.orientation,
        "masses": [[item.mass, item.arm] for item in profile.plant.masses],
        "payloadArm": max(item.arm for item in profile.plant.masses),
        "dampingKeeps": profile.damping.keeps,
        "parameters": numbers,
        "positionOnly": {k: v for k, v in _numbers(position_only).items() if v != numbers[k]},
        "loops": {loop: _numbers(record) for loop, record in loops.items()},
        "unfit": unfit if is_of_hex(profile) else {**unfit, FIRMWARE: OTHER_DEVICE},
        "tables": tables,
        "lawConstants": Device.of(profile, 1.0).constants.tolist(),
        "laws": _tuned(profile),
        "prices": {track: (prices(profile, suite, track=track) * _UNITS).tolist() for track in TRACKS},
    }


def scenario_data(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as JSON types; a seed that JavaScript's numbers cannot hold is a text."""
    content = scenario.model_dump(mode="json")
    seed = content["noise_seed"]
    return {**content, "noise_seed": str(seed) if seed is not None and seed >= 2**53 else seed}


def policy_data(name_or_folder: str | Path) -> dict[str, str]:
    """Return the files of a policy bundle, checked, in base64: what ``core.readPolicy`` reads once they are bytes.

    Errors as of `laws.bundle.read_bundle`.
    """
    folder = read_bundle(bundle_folder(str(name_or_folder))).folder
    return {name: base64.b64encode((folder / name).read_bytes()).decode() for name in (MANIFEST, *FILES)}


def _numbers(record: NDArray[np.void]) -> dict[str, float | int | str]:
    """Return the fields of a record of shape (1,) that are single numbers."""
    return {name: _plain(record[name][0]) for name in record.dtype.names or () if record[name].ndim == 1}


def _plain(value: Any) -> float | int | str:
    if isinstance(value, np.integer):
        return int(value)
    return float(value) if math.isfinite(value) else ("Infinity" if value > 0 else "-Infinity")


def _tables(record: NDArray[np.void]) -> dict[str, str]:
    names = (name for name in record.dtype.names or () if record[name].ndim > 1)
    return {name: base64.b64encode(np.ascontiguousarray(record[name][0], "<f8").tobytes()).decode() for name in names}


def _loop_tables(record: NDArray[np.void]) -> dict[str, str]:
    """Return the tables of any loop: they are the same in all."""
    return {("loop_force_table" if name == "force_table" else name): table for name, table in _tables(record).items()}


def _tuned(profile: Profile) -> dict[str, dict[str, float]]:
    """Return the parameters of the tuned laws for a device: its own, or those for all devices."""
    found = {}
    for law in (EQ6_TUNED, PARAMETRIC):
        for suite in (DEFAULT_SUITE, *fleet_names()):
            try:
                content = tuned_content(law.name, profile, suite)
            except AmulettError:
                continue
            found[law.name] = {key: entry["value"] for key, entry in content["parameters"].items()}
            break
    return found
