"""Reinforcement learning on the environments of `amulett_gym`.

Torch and Stable-Baselines3 are imported with the first name that needs them: a recipe is checked without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from amulett_agents.adapter import SB3VecEnv, make_sb3_env
    from amulett_agents.bundles import save_policy
    from amulett_agents.cloning import CloneSettings, clone
    from amulett_agents.config import TrainConfig, load_train_config
    from amulett_agents.run_folder import TrainResult
    from amulett_agents.sb3_zip import load_sb3_zip
    from amulett_agents.training import resume, train
    from amulett_agents.wrappers import native_view, recipe_view

__all__ = [
    "CloneSettings",
    "SB3VecEnv",
    "TrainConfig",
    "TrainResult",
    "clone",
    "load_sb3_zip",
    "load_train_config",
    "make_sb3_env",
    "native_view",
    "recipe_view",
    "resume",
    "save_policy",
    "train",
]

_NAMES = {
    "adapter": ("SB3VecEnv", "make_sb3_env"),
    "bundles": ("save_policy",),
    "cloning": ("CloneSettings", "clone"),
    "config": ("TrainConfig", "load_train_config"),
    "run_folder": ("TrainResult",),
    "sb3_zip": ("load_sb3_zip",),
    "training": ("resume", "train"),
    "wrappers": ("native_view", "recipe_view"),
}


def __getattr__(name: str) -> Any:
    for module, names in _NAMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
