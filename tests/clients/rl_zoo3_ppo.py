"""rl_zoo3's own command with configs/zoo/ppo.yml."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
from judging import ENV_ID, Trained, mean_return, run
from stable_baselines3 import PPO

from amulett_agents import make_sb3_env, recipe_view, save_policy
from amulett_gym import load_policy
from amulett_gym.settings import configs_folder

TENSIONS = {"tension_range": (4.0, 8.0)}
"""Keywords of the recipe's environments."""


def train(steps: int) -> Trained:
    """Train with `rl_zoo3.train`, and once without learning; judge the bundles of both."""
    return Trained(returned("-n", "1", "-params", "learning_rate:0.0"), returned("-n", str(steps)), steps)


def returned(*words: str) -> float:
    """Return the mean return of what `rl_zoo3.train` makes with these options."""
    recipe = configs_folder() / "zoo" / "ppo.yml"
    with tempfile.TemporaryDirectory() as folder:
        command = ["rl_zoo3.train", "--algo", "ppo", "--env", ENV_ID, "--gym-packages", "amulett_gym"]
        options = [
            "-conf",
            recipe,
            "-f",
            folder,
            "--seed",
            "0",
            "--eval-freq",
            "-1",
            "--num-threads",
            "1",
            "--verbose",
            "0",
        ]
        subprocess.run([sys.executable, "-m", *command, *options, *words], check=True, stdout=sys.stderr)
        (saved,) = Path(folder).glob("ppo/*/*.zip")
        model = PPO.load(saved, recipe_view(make_sb3_env(ENV_ID, **TENSIONS)), device="cpu")
        bundle = save_policy(model, Path(folder) / "bundle")
        return mean_return(load_policy(bundle, gym.make(ENV_ID, **TENSIONS)), **TENSIONS)


if __name__ == "__main__":
    run(train, 100_000)
