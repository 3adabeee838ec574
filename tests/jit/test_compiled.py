"""The equations without the compiler: Python runs them, and comes to the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np

STEPS = """
import json, gymnasium as gym, numpy as np, amulett_gym
env = gym.make_vec("Amulett/Tension-v0", num_envs=2, suite="mixed", privileged=True)
found = [env.reset(seed=3)[0]]
for action in (0.3, -0.8):
    observations, rewards, *_ = env.step(np.full((2, 1), action, dtype=np.float32))
    found += [observations, rewards]
print(json.dumps([part.tolist() for part in found]))
"""


def played(**variables: str) -> list[list[float]]:
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", STEPS],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_an_environment_steps_without_the_compiler():
    found, expected = played(NUMBA_DISABLE_JIT="1"), played()
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7)
