"""TorchRL's PPO loss, advantage and collector, on one single environment."""

from __future__ import annotations

import torch
from judging import ENV_ID, Trained, mean_return, run
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs import GymEnv
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.modules.distributions import IndependentNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import amulett_gym  # noqa: F401  (registers the id)

ROLLOUT, EPOCHS, BATCHES = 4096, 10, 8


class Deviation(torch.nn.Module):
    """A small exploration noise, the same everywhere: noise in the tension costs motor effort."""

    def __init__(self):
        super().__init__()
        self.log = torch.nn.Parameter(torch.full((1,), -1.0))

    def forward(self, mean):
        return mean, self.log.exp().expand_as(mean)


def network() -> torch.nn.Sequential:
    """Return a small network."""
    first, second = torch.nn.Linear(13, 64), torch.nn.Linear(64, 64)
    return torch.nn.Sequential(first, torch.nn.Tanh(), second, torch.nn.Tanh(), torch.nn.Linear(64, 1))


def train(steps: int) -> Trained:
    """Train with rollouts of one environment."""
    torch.manual_seed(0)
    env = GymEnv(ENV_ID)
    env.set_seed(0)
    mean = network()
    outputs = TensorDictModule(
        torch.nn.Sequential(mean, Deviation()), in_keys=["observation"], out_keys=["loc", "scale"]
    )
    actor = ProbabilisticActor(
        outputs,
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(network(), in_keys=["observation"])
    advantage = GAE(gamma=0.95, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, critic_coeff=0.5)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)

    def act(observations):
        with torch.no_grad():
            return mean(torch.as_tensor(observations)).clamp(-1, 1).numpy()

    before = mean_return(act)
    rollouts = max(round(steps / ROLLOUT), 1)
    collector = Collector(env, actor, frames_per_batch=ROLLOUT, total_frames=rollouts * ROLLOUT)
    for data in collector:
        for _ in range(EPOCHS):
            with torch.no_grad():
                advantage(data)
            for rows in torch.randperm(ROLLOUT).chunk(BATCHES):
                losses = loss(data[rows])
                optimiser.zero_grad()
                sum(losses[name] for name in ("loss_objective", "loss_critic")).backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
    collector.shutdown()
    return Trained(before, mean_return(act), rollouts * ROLLOUT)


if __name__ == "__main__":
    run(train, 100_000)
