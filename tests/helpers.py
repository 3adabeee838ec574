"""What the tests of the simulation share."""

from __future__ import annotations

import multiprocessing
import multiprocessing.context
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.laws.bundle import Layers, Network, PolicyDescription, TrainingEnv, write_bundle
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import STATE_NAMES
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.tasks.scenario import load_scenario, pack, pack_path

PROFILES = ("simulation", "testbed")

EXACT_SENSORS = {"encoder_bits": 0, "encoder_noise_deg": 0.0, "potentiometer_bits": 0, "potentiometer_noise": 0.0}

SMALL_RECIPE = (
    "num_envs=8",
    "total_steps=2048",
    "network.hidden=[8]",
    "ppo.n_steps=32",
    "ppo.batch_size=128",
    "ppo.n_epochs=1",
    "env.agent_period=0.05",
    "env.max_episode_steps=25",
    "validation.episodes=4",
)
"""Changes of the default recipe that make its training take tenths of a second."""

NO_GAINS = {"kp": 0.0, "ki": 0.0, "kd": 0.0, "derivative_filter": 0.01}
HELD_DRIVES = {"position": NO_GAINS, "tension": NO_GAINS, "position_only": NO_GAINS}
"""A loop that leaves both drives where they are."""

BUSY: dict[str, Any] = {
    "initial_angle_deg": 10.0,
    "initial_tension": 8.0,
    "moves": [{"time": 0.2, "angle_deg": 45.0}, {"time": 1.2, "angle_deg": 20.0, "duration": 0.3}],
    "pushes": [{"time": 0.9, "duration": 0.1, "torque": 0.1}],
    "obstacle": {"angle_deg": 32.0, "stiffness": 2.0, "damping": 0.02},
    "noise_seed": 7,
}
"""A scenario with a step, a reach, a push and an obstacle in the way."""


def forkserver() -> multiprocessing.context.ForkServerContext:
    """Return a context whose processes have what takes seconds to import: all tests of a process share its server."""
    context = multiprocessing.get_context("forkserver")
    learning = ("amulett_agents.training", "amulett_agents.tuning")  # without torch they are left out
    context.set_forkserver_preload(
        [*learning, "amulett_gym.studies.benchmark.stages", "amulett_gym.studies.paper.sample"]
    )
    return context


def fork_processes(patch: pytest.MonkeyPatch) -> None:
    """Let the package's processes begin with what this one's server has imported, where the start is not tested."""
    context = forkserver()
    patch.setattr("amulett_gym.workers.processes.get_context", lambda kind: context)


def wait_until(condition: Callable[[], object]) -> None:
    """Return once a condition holds; fail after two minutes."""
    for _ in range(2400):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it does not happen")


def blank_figures(patch: pytest.MonkeyPatch) -> None:
    """Draw nothing in a comparison's figures, where the test is about its numbers."""
    from amulett_gym.evaluation import page
    from amulett_gym.reporting import style

    blank = style.Figure(figsize=(0.1, 0.1))
    patch.setattr(page, "draw", lambda results, summary: dict.fromkeys(page.FIGURES, blank))


def device(base: str = "simulation", **groups: Mapping[str, Any]) -> Profile:
    """Return a shipped profile with some keys changed."""
    return load_profile(merge({"name": f"{base}-test", "base": base}, groups))


def start(profile: Profile, *scenarios: Mapping[str, Any], **keywords: Any) -> Simulation:
    """Return a simulation with one device for each scenario, at rest."""
    loaded = [load_scenario(scenario) for scenario in scenarios or ({},)]
    rows = np.concatenate([pack(scenario, profile) for scenario in loaded])
    simulation = Simulation(profile, len(rows), **keywords)
    simulation.reset(rows, paths=[pack_path(scenario) for scenario in loaded])
    return simulation


def run(profile: Profile, scenario: Mapping[str, Any], seconds: float, **keywords: Any) -> Trajectory:
    """Return what a device does in a scenario."""
    simulation = start(profile, scenario, **keywords)
    return record(simulation, round(seconds / simulation.control_period))


def mirrored(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario with flexion and extension exchanged."""
    turned = dict(scenario)
    turned["initial_angle_deg"] = -scenario.get("initial_angle_deg", 0.0)
    turned["moves"] = [{**move, "angle_deg": -move["angle_deg"]} for move in scenario.get("moves", [])]
    turned["pushes"] = [{**push, "torque": -push["torque"]} for push in scenario.get("pushes", [])]
    if "obstacle" in scenario:
        wall = scenario["obstacle"]
        turned["obstacle"] = {**wall, "angle_deg": -wall["angle_deg"], "blocks": "extension"}
    return turned


def state_of(simulation: Simulation, index: int) -> dict[str, NDArray[Any]]:
    """Return everything one device remembers."""
    return {name: simulation.read(name)[index] for name in STATE_NAMES}


def keep_network(
    folder: Path,
    layers: Layers,
    activation: str = "tanh",
    output: str = "clip",
    keywords: Mapping[str, Any] | None = None,
    env_id: str = "Amulett/Scaling-v0",
    **about: Any,
) -> Path:
    """Write a bundle of given weights; `about` are fields of its description that differ from the environment's own."""
    sizes = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    description = {
        "network": Network(layers=sizes, activation=activation, output=output),  # type: ignore[arg-type]
        "observations": list(OBSERVATIONS),
        "observation_scales": dict(OBSERVATION_SCALES),
        "tension_range": [4.0, 15.0],
        "agent_period": 0.02,
    }
    env = TrainingEnv(id=env_id, keywords=dict(keywords or {}), max_episode_steps=500)
    return write_bundle(folder, layers, PolicyDescription(**(description | about)), env, {})


def make_bundle(folder: Path, **about: Any) -> Path:
    """Write a bundle of random weights; `about`: see `keep_network`."""
    random = np.random.default_rng(0)
    layers = [
        (random.normal(size=(o, i)).astype("f4"), random.normal(size=o).astype("f4")) for i, o in [(13, 4), (4, 1)]
    ]
    return keep_network(folder, layers, **{"keywords": {"suite": "steps"}, **about})
