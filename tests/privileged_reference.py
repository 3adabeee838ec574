"""What `envs.privileged` tells, written once more in numpy, entry by entry for all devices at once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.envs.privileged import PRIVILEGED, PRIVILEGED_SCALES
from amulett_gym.model.plant import inertia
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import FAMILIES, LANES

_SCALES = np.array(list(PRIVILEGED_SCALES.values()))
_SOON, _SLACK = 2.0, 1e-6  # [s]
_FACTORS = ("spring_biceps", "spring_triceps", "pulley_biceps", "pulley_triceps", "damping", "noise")

Values = NDArray[np.float64]


def observe_privileged(simulation: Simulation, devices: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return what the given devices cannot know, shape (N, len(PRIVILEGED))."""
    block, lane = np.divmod(devices, LANES)

    def scenario(name: str) -> Values:
        return np.ascontiguousarray(simulation.scenarios[name][block, ..., lane])

    def state(name: str) -> Values:
        return np.ascontiguousarray(simulation.states[name][block, lane])

    time = state("tick") * simulation.control_period
    angle = state("angle")
    values: dict[str, Values] = {f"{name}_factor": scenario(f"{name}_factor") - 1.0 for name in _FACTORS}
    masses = simulation.profile.plant.masses
    bare = inertia([item.mass for item in masses], [item.arm for item in masses])
    values["loaded_inertia"] = scenario("inertia") / bare - 1.0
    for name in ("encoder_bias", "slider_bias_biceps", "slider_bias_triceps", "late_probability", "static_torque"):
        values[name] = scenario(name)
    values["weight_torque"] = values["static_torque"] * np.sin(angle)
    values["true_error"] = state("setpoint") - angle
    values["true_velocity"] = state("velocity")
    for name in ("force_biceps", "force_triceps", "position_integral", "tension_integral"):
        values[name] = state(name)
    values["push_torque"], values["contact_torque"] = state("push_torque"), state("contact_torque")
    values |= _obstacle(scenario, angle)
    values |= _pushes(scenario, time)
    values |= _moves(scenario, state, time)
    values |= _wave(scenario, time)
    values["counts_in"] = np.maximum(scenario("measure_from") - time, 0.0)
    family = scenario("family")
    for number, task in enumerate(FAMILIES):
        if task is not None:
            values[f"family_{task.replace('-', '_')}"] = (family == number).astype(np.float64)
    scaled = np.stack([values[name] for name in PRIVILEGED], axis=1) / _SCALES
    return np.clip(scaled, -1.0, 1.0).astype(np.float32)


def _obstacle(scenario: Any, angle: Values) -> dict[str, Values]:
    stiffness, side = scenario("obstacle_stiffness"), scenario("obstacle_side")
    there = stiffness > 0.0
    return {
        "obstacle": there.astype(np.float64),
        "obstacle_distance": np.where(there, side * (scenario("obstacle_angle") - angle), 0.0),
        "obstacle_side": np.where(there, side, 0.0),
        "obstacle_yield": np.where(there, 1.0 / np.where(there, stiffness, 1.0), 0.0),
        "obstacle_damping": scenario("obstacle_damping"),
    }


def _pushes(scenario: Any, time: Values) -> dict[str, Values]:
    begin, duration, slope = scenario("push_time"), scenario("push_duration"), scenario("push_inverse_rise")
    exists = np.arange(begin.shape[1]) < scenario("push_count")[:, None]
    elapsed = time[:, None] - begin
    begun = elapsed >= -_SLACK
    remaining = np.where(exists & begun, np.maximum(duration - elapsed, 0.0), 0.0).max(axis=1)
    wait = np.where(exists & ~begun, -elapsed, np.inf)
    row, following = np.arange(time.size), wait.argmin(axis=1)
    wait = wait[row, following]
    comes = np.isfinite(wait)
    rise = np.where(slope > 0.0, 1.0 / np.where(slope > 0.0, slope, 1.0), 0.0)
    return {
        "push_remaining": remaining,
        "next_push_in": np.minimum(wait, _SOON),
        "next_push_torque": np.where(comes, scenario("push_torque")[row, following], 0.0),
        "next_push_duration": np.where(comes, duration[row, following], 0.0),
        "next_push_rise": np.where(comes, rise[row, following], 0.0),
        "shake_rms": scenario("shake_rms"),
        "shake_bandwidth": scenario("shake_bandwidth"),
    }


def _moves(scenario: Any, state: Any, time: Values) -> dict[str, Values]:
    begin, angle, duration = scenario("move_time"), scenario("move_angle"), scenario("move_duration")
    row, present = np.arange(time.size), state("move")
    moved = present >= 0
    now = np.maximum(present, 0)
    target = np.where(moved, angle[row, now], scenario("initial_angle"))
    left = np.where(moved, np.maximum(begin[row, now] + duration[row, now] - time, 0.0), 0.0)
    following = present + 1
    comes = following < scenario("move_count")
    following = np.minimum(following, begin.shape[1] - 1)
    return {
        "move_remaining": np.where(left > 0.0, target - (state("setpoint") - state("setpoint_wave")), 0.0),
        "move_ends_in": left,
        "next_move_in": np.where(comes, np.minimum(begin[row, following] - time, _SOON), _SOON),
        "next_move_change": np.where(comes, angle[row, following] - target, 0.0),
        "next_move_duration": np.where(comes, duration[row, following], 0.0),
    }


def _wave(scenario: Any, time: Values) -> dict[str, Values]:
    amplitude, elapsed = scenario("wave_amplitude"), time - scenario("wave_time")
    runs = (amplitude > 0.0) & (elapsed >= 0.0) & (elapsed < scenario("wave_duration") - _SLACK)
    first, chirp = scenario("wave_frequency"), scenario("wave_chirp")
    phase = 2.0 * np.pi * elapsed * (first + 0.5 * chirp * elapsed)
    return {
        "wave_amplitude": amplitude,
        "wave_frequency": np.where(runs, first + chirp * elapsed, first),
        "wave_sine": np.where(runs, np.sin(phase), 0.0),
        "wave_cosine": np.where(runs, np.cos(phase), 0.0),
    }
