"""skrl's PPO on the native vector environment."""

from __future__ import annotations

import tempfile

import gymnasium as gym
import torch
from judging import ENV_ID, Trained, mean_return, run
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed

NUM_ENVS, ROLLOUT = 16, 256


def network(inputs: int) -> torch.nn.Sequential:
    """Return a small network."""
    first, second = torch.nn.Linear(inputs, 64), torch.nn.Linear(64, 64)
    return torch.nn.Sequential(first, torch.nn.Tanh(), second, torch.nn.Tanh(), torch.nn.Linear(64, 1))


class Policy(GaussianMixin, Model):
    """A Gaussian with a small exploration noise: noise in the tension costs motor effort."""

    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net, self.log_std = network(self.num_observations), torch.nn.Parameter(torch.full((1,), -1.0))

    def compute(self, inputs, role=""):
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """The value function."""

    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = network(self.num_observations)

    def compute(self, inputs, role=""):
        return self.net(inputs["observations"]), {}


def train(steps: int) -> Trained:
    """Train for `steps` steps of all environments together."""
    set_seed(0)
    envs = wrap_env(gym.make_vec(ENV_ID, num_envs=NUM_ENVS), wrapper="gymnasium")
    spaces = {"observation_space": envs.observation_space, "action_space": envs.action_space, "device": "cpu"}
    models = {"policy": Policy(**spaces), "value": Value(**spaces)}
    with tempfile.TemporaryDirectory() as folder:
        about = PPO_CFG(rollouts=ROLLOUT, mini_batches=8, discount_factor=0.95, learning_rate=1e-3)
        about.experiment.directory, about.experiment.write_interval, about.experiment.checkpoint_interval = folder, 0, 0
        memory = RandomMemory(memory_size=ROLLOUT, num_envs=NUM_ENVS, device="cpu")
        agent = PPO(models=models, memory=memory, cfg=about, **spaces)

        def act(observations):
            with torch.no_grad():
                return models["policy"].net(torch.as_tensor(observations)).clamp(-1, 1).numpy()

        before = mean_return(act)
        timesteps = max(steps // NUM_ENVS, ROLLOUT)
        settings = {"timesteps": timesteps, "headless": True, "disable_progressbar": True}
        SequentialTrainer(env=envs, agents=agent, cfg=settings).train()
        return Trained(before, mean_return(act), timesteps * NUM_ENVS)


if __name__ == "__main__":
    run(train, 100_000)
