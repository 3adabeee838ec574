"""SBX: Stable-Baselines3's PPO in JAX, on the native vector environment."""

from __future__ import annotations

from functools import partial

from judging import run
from sb3 import train
from sbx import PPO

if __name__ == "__main__":
    run(partial(train, PPO), 100_000)
