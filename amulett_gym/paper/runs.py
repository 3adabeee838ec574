"""The paper's movements, recorded control tick by control tick."""

from __future__ import annotations

from amulett_gym.config import Profile
from amulett_gym.paper.reproduction import paper_step
from amulett_gym.paper.tables import PROTOCOL, TENSION_SETPOINT
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import Control
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.tasks.scenario import Move, Scenario, pack

MOVES_FROM = 2.0
"""When the first of several setpoint steps comes [s]: Figure 7 takes the mean force until then as its setpoint."""

HOLD = 5.0
"""How long each of several setpoints is held [s]: twice what the slowest step of Table 2 takes."""


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
    targets = (PROTOCOL.target_deg, PROTOCOL.start_deg, PROTOCOL.target_deg)
    moves = [Move(time=MOVES_FROM + k * HOLD, angle_deg=angle) for k, angle in enumerate(targets)]
    return paper_step(profile, configuration, eq6).model_copy(update={"moves": moves, "measure_from": MOVES_FROM})


def start(profile: Profile, configuration: str, scenario: Scenario, eq6: str = "text") -> Simulation:
    """Return one device in one of the paper's configurations, at the start of a scenario.

    Parameters
    ----------
    profile : Profile
        With the readings applied (`reproduction.apply_readings`).
    configuration : str
        One of `tables.CONFIGURATIONS`.
    scenario : Scenario
    eq6 : {"text", "printed"}
        Form of eq. 6, for the configuration ``variable``.

    Raises
    ------
    AmulettError
        If the device cannot hold the scenario's starting posture.
    """
    control: Control = "position-only" if configuration == "position-only" else "decentralized"
    law = {"text": "eq6", "printed": "eq6-printed"}[eq6] if configuration == "variable" else "agent"
    simulation = Simulation(profile, 1, control, law)
    simulation.reset(pack(scenario, profile))
    if configuration in TENSION_SETPOINT:
        simulation.command_tension(TENSION_SETPOINT[configuration])
    return simulation


def follow(simulation: Simulation, duration: float) -> Trajectory:
    """Record what a single device does for `duration` seconds, or until it fails."""
    trajectory = record(simulation, round(duration / simulation.control_period))
    # The clock of a device that failed stands still.
    rows = int(trajectory["tick"][-1] - trajectory["tick"][0]) + 1
    signals = {name: values[:rows] for name, values in trajectory.signals.items()}
    return Trajectory(trajectory.profile, trajectory.control_period, signals)
