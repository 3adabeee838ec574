"""The shipped recipes: valid, short, and all on the suite that the benchmark is about."""

from pathlib import Path

import pytest

from amulett_agents.config import TrainConfig, load_train_config
from amulett_gym.storage.provenance import differences
from amulett_gym.storage.safe_yaml import read_yaml

CONFIGS = Path(__file__).parents[2] / "configs"
RECIPES = ("ppo-history", "causal", "sac", "drives")


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_gives_what_differs_from_the_default_and_nothing_else(name):
    config = load_train_config(CONFIGS / f"{name}.yaml")
    assert config.env.suite == "mixed"

    def leaves(tree, path=""):
        for key, value in tree.items():
            yield from leaves(value, f"{path}{key}.") if isinstance(value, dict) else [f"{path}{key}"]

    changed = {line.split(" was ")[0] for line in differences(TrainConfig().model_dump(), config.model_dump())}
    given = set(leaves(read_yaml(CONFIGS / f"{name}.yaml", "recipe")))
    assert {key for key in given if not any(one.startswith(key) for one in changed)} == set()


def test_the_default_recipe_writes_out_every_key_with_its_default():
    default = TrainConfig().model_dump()
    del default["sac"]
    assert differences(default, read_yaml(CONFIGS / "ppo.yaml", "recipe")) == []


def test_a_recipe_without_a_delay_is_written_as_before_there_were_any(tmp_path):
    assert "action_delay" not in TrainConfig().model_dump()["env"] | TrainConfig().env.keywords()
    path = tmp_path / "late.yaml"
    path.write_text("env: {action_delay: 3}")
    late = load_train_config(path)
    assert late.model_dump()["env"]["action_delay"] == late.env.keywords()["action_delay"] == 3
    assert TrainConfig(**late.model_dump()) == late


def test_each_recipe_is_of_its_kind():
    history, causal, sac, drives = (load_train_config(CONFIGS / f"{name}.yaml") for name in RECIPES)
    assert (history.algorithm, causal.algorithm, sac.algorithm) == ("ppo", "ppo", "sac")
    assert (drives.algorithm, drives.env.id) == ("ppo", "Amulett/Drives-v0")
    assert history.env.history > 1
    assert causal.env.privileged
