"""The shipped recipe's standardised inputs for other trainers of Stable-Baselines3's models: ``configs/zoo``."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecFrameStack, unwrap_vec_wrapper

from amulett_agents.bundles import describe_env
from amulett_agents.networks import StandardInputs, measure_inputs
from amulett_agents.wrappers import ActorView
from amulett_gym import DRIVES_ID
from amulett_gym.errors import AmulettError


class MeasuredInputs(BaseCallback):
    """Measures the inputs before a training, for all `StandardInputs` of a model.

    They are measured under the middle of the action's range, in fixed training scenarios of the model's environment. A
    model needs ``policy_kwargs={"features_extractor_class": StandardInputs}``. One that has measured inputs, because it
    was trained before, keeps them.
    """

    def _on_training_start(self) -> None:
        extractors = [module for module in self.model.policy.modules() if isinstance(module, StandardInputs)]
        if not extractors:
            raise AmulettError("MeasuredInputs needs policy_kwargs with features_extractor_class: StandardInputs")
        if any(bool((extractor.gains != 1.0).any()) for extractor in extractors):
            return
        env = self.model.get_env()
        assert env is not None
        assert env.action_space.shape is not None
        made = describe_env(env)
        view, stack = unwrap_vec_wrapper(env, ActorView), unwrap_vec_wrapper(env, VecFrameStack)
        if made.id == DRIVES_ID:
            raise AmulettError(f"MeasuredInputs is not for {DRIVES_ID}: train with configs/drives.yaml")
        size = env.action_space.shape[0]

        def middle(observations: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
            return np.zeros((len(observations), size), dtype=np.float32)

        keywords = {key: value for key, value in made.keywords.items() if key != "split"}
        inputs = measure_inputs(
            made.id,
            keywords,
            made.max_episode_steps,
            middle,
            1 if stack is None else stack.stacked_obs.n_stack,
            view.tension_range if view is not None and view.features else None,
            memory=view is not None and view.memory is not None,
        )
        for extractor in extractors:
            extractor.standardise(inputs)

    def _on_step(self) -> bool:
        return True
