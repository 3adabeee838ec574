"""Which further experiment would tell most about a fitted device: the one that shrinks the posterior most.

Each experiment is simulated with the fitted device in its loop, and its log's information added to the posterior's. The
measure is the volume of the physics' posterior, as a factor for one parameter (its geometric mean).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulett_gym.identification.from_logs.fit import DETERMINED, Fit, information_of
from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.recording import COMMANDS, SLIDERS, Recording
from amulett_gym.profile import Profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import Move, Payload, Scenario, pack, pack_path

Values = NDArray[np.float64]

DURATION = 20.0
"""Of each experiment [s]."""

_EVERY = 2.0  # a step, or a half of a ramp [s]
_ARM = 0.1  # of a weight [m]
_RELEASED = np.radians(15.0)
_TENSIONS = (6.0, 10.0, 14.0)  # [N]


@dataclass(frozen=True)
class Outlook:
    """What an experiment would tell.

    Attributes
    ----------
    name, description : str
    shrinks : float
        Factor of the posterior's width, the geometric mean over the physics' parameters.
    determines : tuple of str
        Parameters that the logs so far leave to the prior, and this one would determine.
    """

    name: str
    description: str
    shrinks: float
    determines: tuple[str, ...]


def outlooks(fit: Fit) -> list[Outlook]:
    """Return what each experiment of a handful would tell, the best first."""
    physics = [k for k, each in enumerate(fit.prior.seen) if not each.nuisance]
    before = np.linalg.inv(fit.prior.covariance)
    old = np.linalg.inv(fit.information + before)
    known = np.sqrt(np.diag(old)) <= DETERMINED * fit.prior.deviation
    found = []
    for name, description, recordings in _experiments(fit):
        new = np.linalg.inv(fit.information + _information(fit, recordings) + before)
        volumes = [np.linalg.slogdet(each[np.ix_(physics, physics)])[1] for each in (new, old)]
        sure = np.sqrt(np.diag(new)) <= DETERMINED * fit.prior.deviation
        gained = tuple(fit.prior.seen[k].name for k in physics if sure[k] and not known[k])
        shrinks = float(np.exp(0.5 * (volumes[0] - volumes[1]) / len(physics)))
        found.append(Outlook(name, description, shrinks, gained))
    return sorted(found, key=lambda each: each.shrinks)


def _information(fit: Fit, recordings: Sequence[Recording]) -> Values:
    model = Model(fit.model.template, recordings)
    model.seen = fit.prior.seen
    return information_of(model, fit)


def _experiments(fit: Fit) -> list[tuple[str, str, list[Recording]]]:
    device = fit.model.profile(fit.values)
    mass = float(f"{fit.values['inertia'] / _ARM**2:.1g}")
    weight = Payload(mass=mass, arm=_ARM)
    known = f"a weight of {mass:g} kg on the arm, {_ARM * 1000:.0f} mm from the joint"
    tensions = ", ".join(f"{each:g}" for each in _TENSIONS)
    return [
        ("large steps", f"steps between -40 and 40 deg, at {tensions} N", [_steps(device, 40.0)]),
        ("small steps", f"steps between -5 and 5 deg, at {tensions} N", [_steps(device, 5.0)]),
        ("co-contraction ramps", "tension up and down between 5 and 15 N, at 20 deg", [_ramps(device)]),
        ("steps with a weight", f"steps between -20 and 20 deg with {known}", [_steps(device, 20.0, weight)]),
        (
            "free oscillation with a weight",
            f"let go from 15 deg with {known}, drives at rest, at {tensions} N (Figure 3)",
            [_release(device, tension, weight) for tension in _TENSIONS],
        ),
    ]


def _steps(device: Profile, angle_deg: float, weight: Payload | None = None) -> Recording:
    signs = np.arange(round(DURATION / _EVERY)) % 2
    moves = [Move(time=_EVERY * k + 0.5, angle_deg=angle_deg * (1 - 2 * sign)) for k, sign in enumerate(signs.tolist())]
    scenario = Scenario(moves=moves, payload=weight, orientation="profile")
    ticks = round(DURATION / device.loop.control_period)
    tension = np.repeat(_TENSIONS, -(-ticks // len(_TENSIONS)))[:ticks]
    return _record(device, scenario, tension, weight)


def _ramps(device: Profile) -> Recording:
    time = np.arange(round(DURATION / device.loop.control_period)) * device.loop.control_period
    tension = np.interp(time % (2.0 * _EVERY), [0.0, _EVERY, 2.0 * _EVERY], [5.0, 15.0, 5.0])
    return _record(device, Scenario(initial_angle_deg=20.0), tension, None)


def _record(device: Profile, scenario: Scenario, tension: Values, weight: Payload | None) -> Recording:
    simulation = Simulation(device)
    scenario = scenario.model_copy(update={"initial_tension": float(tension[0])})
    path = pack_path(scenario)
    simulation.reset(pack(scenario, device), paths=[path] if path.size else None)
    moved = record(simulation, len(tension), before_tick=lambda tick: simulation.command_tension(tension[tick]))
    columns = {"time": moved["time"][:-1], "angle": moved["angle"][:-1]}
    columns |= dict(zip(SLIDERS, (moved["measured_biceps"][:-1], moved["measured_triceps"][:-1]), strict=True))
    columns |= {name: moved[name][1:] for name in COMMANDS}
    return Recording("experiment", columns, weight)


def _release(device: Profile, tension: float, weight: Payload) -> Recording:
    simulation = Simulation(device)
    simulation.reset(pack(Scenario(initial_tension=tension), device))
    rows = round(DURATION / len(_TENSIONS) / device.loop.control_period)
    columns: dict[str, Values] = {
        "time": np.arange(rows, dtype=np.float64) * device.loop.control_period,
        "angle": np.zeros(rows),
    }
    columns["angle"][0] = _RELEASED
    columns |= {name: np.full(rows, float(simulation.read(name)[0])) for name in COMMANDS}
    columns |= {name: np.zeros(rows) for name in SLIDERS}
    return replace(Recording("experiment", columns, weight), released=True)
