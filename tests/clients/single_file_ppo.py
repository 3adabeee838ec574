"""PPO in one file, in the manner of CleanRL, for any vector environment of Gymnasium with Box spaces.

Nothing of this package is imported: it is what somebody brings along. ``python single_file_ppo.py ENV_ID [STEPS]``
"""

from __future__ import annotations

import sys

import gymnasium as gym
import numpy as np
import torch
from torch import nn

ROLLOUT, EPOCHS, BATCHES = 32, 4, 4
GAMMA, LAMBDA, CLIP, RATE = 0.95, 0.95, 0.2, 2e-3


class Agent(nn.Module):
    """A Gaussian policy and a value function, two small networks."""

    def __init__(self, observations: int, actions: int) -> None:
        super().__init__()
        self.mean = nn.Sequential(nn.Linear(observations, 32), nn.Tanh(), nn.Linear(32, actions))
        self.value = nn.Sequential(nn.Linear(observations, 32), nn.Tanh(), nn.Linear(32, 1))
        self.log_std = nn.Parameter(torch.full((actions,), -0.5))

    def policy(self, observation: torch.Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(self.mean(observation), self.log_std.exp())


def train(envs: gym.vector.VectorEnv, steps: int, seed: int = 0) -> tuple[Agent, list[float]]:
    """Train on a vector environment (autoreset mode NEXT_STEP); return the agent and each rollout's mean reward."""
    torch.manual_seed(seed)
    count = envs.num_envs
    size, actions = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, actions)
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE)
    observations = torch.zeros(ROLLOUT, count, size)
    taken, log_probs = torch.zeros(ROLLOUT, count, actions), torch.zeros(ROLLOUT, count)
    rewards, values = torch.zeros(ROLLOUT, count), torch.zeros(ROLLOUT + 1, count)
    ends, starts = torch.zeros(ROLLOUT, count), torch.zeros(ROLLOUT + 1, count)
    observation = torch.as_tensor(envs.reset(seed=seed)[0])
    learned = []
    for _ in range(steps // (ROLLOUT * count)):
        for t in range(ROLLOUT):
            observations[t] = observation
            with torch.no_grad():
                policy = agent.policy(observation)
                taken[t] = policy.sample()
                log_probs[t] = policy.log_prob(taken[t]).sum(-1)
                values[t] = agent.value(observation)[:, 0]
            seen, reward, terminated, truncated, _ = envs.step(taken[t].clamp(-1, 1).numpy())
            observation, rewards[t] = torch.as_tensor(seen), torch.as_tensor(reward, dtype=torch.float32)
            ends[t] = torch.as_tensor(terminated, dtype=torch.float32)
            starts[t + 1] = torch.as_tensor(terminated | truncated, dtype=torch.float32)
        with torch.no_grad():
            values[ROLLOUT] = agent.value(observation)[:, 0]
        advantages, following = torch.zeros(ROLLOUT, count), torch.zeros(count)
        for t in reversed(range(ROLLOUT)):
            error = rewards[t] + GAMMA * values[t + 1] * (1 - ends[t]) - values[t]
            following = error + GAMMA * LAMBDA * (1 - starts[t + 1]) * following
            advantages[t] = following
        counted = (starts[:ROLLOUT] == 0).flatten()  # the step that starts an episode takes no action
        flat = [
            x.flatten(0, 1)[counted] for x in (observations, taken, log_probs, advantages, advantages + values[:-1])
        ]
        starts[0] = starts[ROLLOUT]
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(flat[0])).chunk(BATCHES):
                seen, action, old, advantage, target = (x[rows] for x in flat)
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = (agent.policy(seen).log_prob(action).sum(-1) - old).exp()
                gain = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
                loss = (agent.value(seen)[:, 0] - target).pow(2).mean()
                optimiser.zero_grad()
                (0.5 * loss - gain).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
        learned.append(float(rewards.flatten()[counted].mean()))
    return agent, learned


if __name__ == "__main__":
    made = gym.make_vec(sys.argv[1], num_envs=8)
    print(np.array(train(made, int(sys.argv[2]) if len(sys.argv) > 2 else 20_000)[1]))
