"""What learns: PPO and SAC, the SB3 adapter and the writing of policy bundles.

Torch and Stable-Baselines3 are imported when a name that needs them is: a recipe can be checked without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from amulett_agents.adapter import SB3VecEnv, make_sb3_env
    from amulett_agents.bundles import save_policy
    from amulett_agents.config import TrainConfig, load_train_config
    from amulett_agents.run_folder import TrainResult
    from amulett_agents.sb3_zip import load_sb3_zip
    from amulett_agents.training import resume, train

__all__ = [
    "SB3VecEnv",
    "TrainConfig",
    "TrainResult",
    "load_sb3_zip",
    "load_train_config",
    "make_sb3_env",
    "resume",
    "save_policy",
    "train",
]

_MODULES = {
    "SB3VecEnv": "adapter",
    "TrainConfig": "config",
    "TrainResult": "run_folder",
    "load_sb3_zip": "sb3_zip",
    "load_train_config": "config",
    "make_sb3_env": "adapter",
    "resume": "training",
    "save_policy": "bundles",
    "train": "training",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
