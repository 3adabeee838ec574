"""rl_zoo3's PPO with the shipped hyper-parameters, `configs/zoo/ppo.yml`, which are for the suite `mixed`."""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
from judging import ENV_ID, Trained, mean_return, run
from rl_zoo3.exp_manager import ExperimentManager
from stable_baselines3 import PPO

from amulett_agents import save_policy
from amulett_gym import load_policy
from amulett_gym.settings import configs_folder


def train(steps: int) -> Trained:
    """Train as `python -m rl_zoo3.train` does, and judge bundles of the policy before and after it."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        config = str(configs_folder() / "zoo" / "ppo.yml")
        about = {"n_timesteps": steps, "eval_freq": -1, "log_interval": -1, "seed": 0, "config": config}
        manager = ExperimentManager(argparse.Namespace(), "ppo", ENV_ID, folder, **about)
        model, _ = manager.setup_experiment()
        before = judged(model, Path(folder) / "before")
        manager.learn(model)
        return Trained(before, judged(model, Path(folder) / "after"), model.num_timesteps)


def judged(model: PPO, folder: Path) -> float:
    """Return the mean return of a model's policy."""
    policy = load_policy(save_policy(model, folder), gym.make_vec(ENV_ID, num_envs=1, suite="mixed"))
    return mean_return(policy, suite="mixed")


if __name__ == "__main__":
    run(train, 250_000)
