"""A run whose weights stop being numbers ends with what was good until then; a study goes on without it."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from amulett_agents import load_train_config, resume, train  # noqa: E402
from amulett_agents.bundles import has_diverged  # noqa: E402
from amulett_agents.model import make_model  # noqa: E402
from amulett_agents.tuning import load_space, tune  # noqa: E402
from amulett_agents.validation import torch_threads  # noqa: E402
from amulett_gym.cli import main  # noqa: E402
from amulett_gym.laws.bundle import MAX_WEIGHT, read_bundle  # noqa: E402

SMALL = [
    "num_envs=16",
    "total_steps=2048",
    "network.hidden=[8]",
    "network.critic_hidden=[8]",
    "env.max_episode_steps=50",
    "env.suite=steps",
    "staggered=false",
    "validation.every_steps=512",
    "validation.episodes=2",
]
PPO = [*SMALL, "ppo.n_steps=32", "ppo.batch_size=128", "ppo.n_epochs=1", "ppo.target_kl=null"]
SAC = [*SMALL, "algorithm=sac", "sac.learning_starts=64", "sac.batch_size=64"]


@pytest.fixture(autouse=True)
def one_thread():
    with torch_threads(1):
        yield


def exploding(monkeypatch, updates):
    """Let each optimiser's step with this number, and those after it, leave weights that are no numbers."""
    step, done = torch.optim.Adam.step, []

    def explode(self, *arguments, **keywords):
        result = step(self, *arguments, **keywords)
        done.append(1)
        if len(done) >= updates:
            for group in self.param_groups:
                for weights in group["params"]:
                    weights.data.fill_(np.nan)
        return result

    monkeypatch.setattr(torch.optim.Adam, "step", explode)


@pytest.mark.parametrize(("recipe", "updates"), [(PPO, 6), (PPO, 8), (SAC, 1000)])
def test_divergence_ends_a_run_and_keeps_what_was_good(recipe, updates, monkeypatch, tmp_path):
    """In PPO's eighth update the last minibatch of a rollout explodes, in the sixth one in the middle."""
    exploding(monkeypatch, updates)
    out = tmp_path / "run"
    result = train(load_train_config(None, recipe), out, progress=False)
    assert 0 < result.steps == result.diverged < 2048 and not result.interrupted
    assert np.isfinite([result.best_cost, result.last_cost]).all()
    for bundle in (result.best, result.last):
        read_bundle(bundle)
    assert not (out / "checkpoints").exists()
    assert resume(out, progress=False) == result


@pytest.mark.parametrize("recipe", [PPO, SAC])
def test_the_steps_before_the_first_validation_are_counted(recipe, monkeypatch, tmp_path, capsys):
    exploding(monkeypatch, 1)
    assert main(["train", "--set", *recipe, "--out", str(tmp_path / "run")]) == 1
    finished = json.loads((tmp_path / "run" / "finished.json").read_text())
    assert finished["best_steps"] == 0 < finished["steps"] == finished["diverged"] <= 512
    assert f"\n{finished['steps']:,} steps in " in capsys.readouterr().out


def test_weights_that_no_bundle_can_hold_have_diverged():
    model = make_model(load_train_config(None, PPO))
    assert not has_diverged(model)
    with torch.no_grad():
        model.policy.action_net.bias.fill_(1.1 * MAX_WEIGHT)
    assert has_diverged(model)


def test_the_command_says_it_in_one_line_with_exit_code_1(monkeypatch, tmp_path, capsys):
    exploding(monkeypatch, 5)
    assert main(["train", "--set", *PPO, "--out", str(tmp_path / "run")]) == 1
    assert "diverged after 1,024 steps" in capsys.readouterr().out
    assert main(["train", "--resume", str(tmp_path / "run")]) == 1
    printed = capsys.readouterr().out
    assert "diverged after 1,024 steps" in printed and "nothing to resume" in printed


def test_a_learning_rate_that_is_far_too_high_is_no_traceback(tmp_path):
    result = train(load_train_config(None, [*SAC, "sac.learning_rate=0.9"]), tmp_path / "run", progress=False)
    assert result.diverged is not None and result.best_steps <= result.diverged


def test_another_error_of_a_run_is_not_taken_for_divergence(monkeypatch, tmp_path):
    from amulett_agents.run import Run

    def fail(self):
        raise ValueError("something else")

    monkeypatch.setattr(Run, "_on_rollout_end", fail)
    with pytest.raises(ValueError, match="something else"):
        train(load_train_config(None, PPO), tmp_path / "run", progress=False)


def test_a_study_goes_on_after_a_failed_trial_and_its_resume_comes_to_the_same(monkeypatch, tmp_path):
    (tmp_path / "space.yaml").write_text(
        "ppo.gamma: {choices: [0.9, 0.99]}\nenv.agent_period: {choices: [0.02, 0.0213]}"
    )
    config = load_train_config(None, [*PPO, "total_steps=512"])
    space = load_space(tmp_path / "space.yaml", config)
    with monkeypatch.context() as patch:
        exploding(patch, 1)  # every run that begins
        trials = tune(config, space, 6, tmp_path / "study")
    reasons = [next((word for word in ("diverged", "agent_period") if word in trial.error), "") for trial in trials]
    assert set(reasons) == {"diverged", "agent_period"}
    assert all(trial.cost is None for trial in trials)
    kept = (tmp_path / "study" / "trials.json").read_text()
    again = tune(config, space, 8, tmp_path / "study")
    assert again[:6] == trials
    assert json.loads((tmp_path / "study" / "trials.json").read_text())[:6] == json.loads(kept)
    assert any(trial.costs for trial in again[6:])
