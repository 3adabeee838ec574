"""What learns: PPO, the SB3 adapter and the writing of policy bundles."""

from amulett_agents.adapter import SB3VecEnv, make_sb3_env
from amulett_agents.config import TrainConfig, load_train_config
from amulett_agents.ppo import save_policy
from amulett_agents.training import TrainResult, train

__all__ = ["SB3VecEnv", "TrainConfig", "TrainResult", "load_train_config", "make_sb3_env", "save_policy", "train"]
