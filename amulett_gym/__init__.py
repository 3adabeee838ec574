"""Learn how stiff an antagonistic joint should be: a Gymnasium environment around the AMULETT elbow exoskeleton."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

from amulett_gym.notebook import register as _show_in_notebooks

if TYPE_CHECKING:
    from amulett_gym.laws.policies import load_policy as load_policy

__version__ = "0.1.0"
__all__ = ["ENV_IDS", "FAILURES", "__version__", "load_policy"]

ENV_IDS = ("Amulett/Scaling-v0", "Amulett/Tension-v0", "Amulett/Drives-v0", "Amulett/Worn-v0")
"""Ids registered with Gymnasium when this package is imported."""

DRIVES_ID = ENV_IDS[2]
"""The environment whose action has a mean drive angle, too."""

WORN_ID = ENV_IDS[3]
"""The environment in which the device is worn, whose action has an assistance, too."""

FAILURES = ("", "joint angle limit", "joint velocity limit", "state is not finite")
"""Why an episode was terminated, by the number ``info["failure"]``; 0: it was not."""

_ENTRY_POINTS = (
    ("single:ScalingEnv", "vector:ScalingVectorEnv"),
    ("single:TensionEnv", "vector:TensionVectorEnv"),
    ("single:DrivesEnv", "vector:DrivesVectorEnv"),
    ("worn:WornEnv", "worn:WornVectorEnv"),
)

for _id, (_single, _vector) in zip(ENV_IDS, _ENTRY_POINTS, strict=True):
    if _id not in _gymnasium.registry:
        _gymnasium.register(
            _id,
            entry_point=f"amulett_gym.envs.{_single}",
            vector_entry_point=f"amulett_gym.envs.{_vector}",
            max_episode_steps=500,
            disable_env_checker=True,  # it checks the environment, as the tests do, not its user
        )

_show_in_notebooks()


def __getattr__(name: str) -> Any:
    """Import `load_policy` at its first use: it needs the compiled kernel, which takes long to import."""
    if name == "load_policy":
        from amulett_gym.laws.policies import load_policy

        return load_policy
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
