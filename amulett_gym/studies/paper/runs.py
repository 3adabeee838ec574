"""The paper's movements, recorded control tick by control tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amulett_gym.control.agonist import BICEPS
from amulett_gym.errors import unknown
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import Control
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.studies.paper.tables import CONFIGURATIONS, PROTOCOL, TENSION_SETPOINT
from amulett_gym.tasks.scenario import Move, Scenario, pack
from amulett_gym.tasks.suites import START

Values = NDArray[np.float64]

MOVES_FROM = 2.0
"""When the first of several setpoint steps comes [s]: Figure 7 takes the mean force until then as its setpoint."""

STEPS = (PROTOCOL.target_deg, PROTOCOL.start_deg, PROTOCOL.target_deg)
"""Setpoints of several steps in a row [deg]: Figures 7 and 9 show the first three."""

HOLD = 5.0
"""How long each of several setpoints is held [s]: twice what the slowest step of Table 2 takes."""


def paper_step(profile: Profile, configuration: str, eq6: str = "text", noise_seed: int = 1) -> Scenario:
    """Return the paper's step from 0 to 45 deg, from rest at the configuration's own tension setpoint.

    Raises
    ------
    AmulettError
        If the configuration is none of `tables.CONFIGURATIONS`.
    """
    if configuration not in CONFIGURATIONS:
        raise unknown("configuration", configuration, CONFIGURATIONS)
    law = profile.variable_stiffness
    at_rest = law.nominal_tension if eq6 == "text" else law.minimum_tension  # eq. 6 at an error of zero
    return Scenario(
        initial_angle_deg=PROTOCOL.start_deg,
        initial_tension=TENSION_SETPOINT.get(configuration, at_rest),
        moves=[Move(time=START, angle_deg=PROTOCOL.target_deg)],
        measure_from=START,
        noise_seed=noise_seed,
    )


def there_and_back(profile: Profile, configuration: str, eq6: str = "text") -> Scenario:
    """Return three of the paper's steps in a row, to 45 deg, back, and to 45 deg again, each held for `HOLD`.

    Parameters
    ----------
    profile : Profile
    configuration : str
        One of `tables.CONFIGURATIONS`; its tension is that of the start.
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.
    """
    moves = [Move(time=MOVES_FROM + k * HOLD, angle_deg=angle) for k, angle in enumerate(STEPS)]
    return paper_step(profile, configuration, eq6).model_copy(update={"moves": moves, "measure_from": MOVES_FROM})


def start(profile: Profile, configuration: str, scenarios: Sequence[Scenario], eq6: str = "text") -> Simulation:
    """Return devices in one of the paper's configurations, each at the start of a scenario.

    Parameters
    ----------
    profile : Profile
        With the readings applied (`reproduction.apply_readings`).
    configuration : str
        One of `tables.CONFIGURATIONS`.
    scenarios : sequence of Scenario
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.

    Raises
    ------
    AmulettError
        If the device cannot hold a scenario's starting posture.
    """
    control: Control = "position-only" if configuration == "position-only" else "decentralized"
    law = {"text": "eq6", "printed": "eq6-printed"}[eq6] if configuration == "variable" else "agent"
    simulation = Simulation(profile, len(scenarios), control, law)
    simulation.reset(np.concatenate([pack(scenario, profile) for scenario in scenarios]))
    if configuration in TENSION_SETPOINT:
        simulation.command_tension(TENSION_SETPOINT[configuration])
    return simulation


def with_agonist(profile: Profile, agonist: str) -> Profile:
    """Return a profile whose agonist is another one: ``"switching"``, ``"biceps"`` or ``"triceps"``."""
    return load_profile(merge(profile.model_dump(), {"loop": {"agonist": agonist}}))


def follow(simulation: Simulation, duration: float) -> Trajectory:
    """Record what a single device does for `duration` seconds, or until it fails."""
    trajectory = record(simulation, round(duration / simulation.control_period))
    # The clock of a device that failed stands still.
    rows = int(trajectory["tick"][-1] - trajectory["tick"][0]) + 1
    signals = {name: values[:rows] for name, values in trajectory.signals.items()}
    return Trajectory(trajectory.profile, trajectory.control_period, signals)


def antagonist_force(simulation: Simulation, duration: float, estimated: bool) -> tuple[Values, Values]:
    """Record the force of each device's antagonist string, and its setpoint, for `duration` seconds.

    Returns
    -------
    force, setpoint : ndarray, shape (ticks, devices)
        As they are when each control tick begins, with the roles and the setpoint of that tick [N].
    """
    kind = "estimate" if estimated else "force"
    names = ("agonist", f"{kind}_biceps", f"{kind}_triceps", "tension_setpoint")
    ticks = round(duration / simulation.control_period)
    rows = {name: np.empty((ticks + 1, simulation.num_devices)) for name in names}
    for tick in range(ticks + 1):
        if tick:
            simulation.advance(1)
        for name, values in rows.items():
            values[tick] = simulation.read(name)
    agonist, biceps, triceps, setpoint = rows.values()
    return np.where(agonist[1:] == BICEPS, triceps[:-1], biceps[:-1]), setpoint[1:]
