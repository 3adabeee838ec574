"""A PPO in one file, in the manner of CleanRL, on the native vector environment."""

from __future__ import annotations

import gymnasium as gym
import torch
from judging import ENV_ID, Trained, mean_return, run
from single_file_ppo import Agent
from single_file_ppo import train as train_agent


def train(steps: int) -> Trained:
    """Train with `single_file_ppo.train`; its seed makes the agent before it the same."""
    torch.manual_seed(0)
    envs = gym.make_vec(ENV_ID, num_envs=32)
    untrained = Agent(13, 1)
    agent, _ = train_agent(envs, max(steps, 1024))
    return Trained(judged(untrained), judged(agent), max(steps, 1024) // 1024 * 1024)


def judged(agent: Agent) -> float:
    """Return the mean return of the policy's mean."""
    with torch.no_grad():
        return mean_return(lambda observations: agent.mean(torch.as_tensor(observations)).clamp(-1, 1).numpy())


if __name__ == "__main__":
    run(train, 100_000)
