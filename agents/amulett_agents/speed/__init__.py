"""Speed of learning with PPO."""

from amulett_agents.speed.learning_time import Evaluator, describe_beats, time_to_beat, with_neutral_start
from amulett_agents.speed.throughput import ppo_throughput

__all__ = ["Evaluator", "describe_beats", "ppo_throughput", "time_to_beat", "with_neutral_start"]
