"""Zips of Stable-Baselines3 are pickles, which say little: they compete if they are trusted and described."""

from __future__ import annotations

import json
import pickle
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml
from helpers import blank_figures

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC, TD3

from amulett_agents import load_sb3_zip
from amulett_gym import ENV_IDS
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.laws.contenders import in_loop
from amulett_gym.laws.copies import FOLDER
from amulett_gym.profile import load_profile

TESTBED = load_profile("testbed")
ABOUT = {"env_id": ENV_IDS[0], "agent_period": 0.1, "tension_range": [5.0, 12.0]}
OBSERVATIONS = np.random.default_rng(0).uniform(-1, 1, (20, 13)).astype(np.float32)


def saved(folder: Path, algorithm=PPO, env: str | gym.Env = ENV_IDS[0], **keywords) -> Path:
    keywords = {"policy_kwargs": {"net_arch": [8]}, "seed": 0, "device": "cpu", **keywords}
    if algorithm is PPO:
        keywords |= {"n_steps": 8, "batch_size": 8}
    path = folder / f"{algorithm.__name__}.zip"
    algorithm("MlpPolicy", env, **keywords).save(path)
    path.with_suffix(".json").write_text(json.dumps(ABOUT))
    return path


@pytest.mark.parametrize(
    ("algorithm", "keywords"), [(PPO, {}), (PPO, {"use_sde": True}), (SAC, {"use_sde": True}), (TD3, {})]
)
def test_a_trusted_zip_acts_as_the_model_did(tmp_path, algorithm, keywords):
    path = saved(tmp_path, algorithm, **keywords)
    expected, _ = algorithm.load(path, device="cpu").predict(OBSERVATIONS, deterministic=True)
    act = load_sb3_zip(path, TESTBED, trust_pickle=True).act
    assert np.ptp(expected) > 0
    assert np.array_equal(act(OBSERVATIONS), expected)


def test_a_trusted_zip_competes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(saved(tmp_path).parent)
    assert main(["evaluate", "--policies", "PPO.zip", "--trust-pickle", "--episodes", "2", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert list(result["policies"]) == ["eq6", "PPO.zip"]
    assert result["command"].endswith("--trust-pickle")


def test_a_zip_is_kept_with_its_description_and_compared_again(tmp_path, monkeypatch, capsys):
    zip_file = saved(tmp_path)
    monkeypatch.chdir(tmp_path)
    blank_figures(monkeypatch)
    words = ["evaluate", "--policies", "./PPO.zip", "--trust-pickle", "--episodes", "2", "--duration", "1"]
    assert main([*words, "--out", "kept"]) == 0
    for path in (zip_file, zip_file.with_suffix(".json")):
        path.unlink()
    assert main(["rerun", "kept", "--out", "again", "--trust-pickle"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    (tmp_path / "kept" / FOLDER / "0" / "PPO.json").write_text(json.dumps({**ABOUT, "tension_range": [5.0, 13.0]}))
    assert main(["rerun", "kept", "--out", "third", "--trust-pickle"]) == 2
    assert "PPO.json', was changed" in capsys.readouterr().err


def test_a_trusted_zip_is_played(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(saved(tmp_path).parent)
    words = ["play", "PPO.zip", "--steps", "2", "--video", "arm.gif"]
    assert main(words) == 2 and "--trust-pickle" in capsys.readouterr().err
    assert main([*words, "--trust-pickle"]) == 0
    assert (tmp_path / "arm.gif").is_file()


class Trap:
    def __init__(self, trap: Path) -> None:
        self.trap = trap

    def __reduce__(self):
        return Path.touch, (self.trap,)


def test_without_trust_nothing_in_a_zip_is_run(tmp_path, capsys):
    import base64

    trap, path = tmp_path / "sprung", tmp_path / "model.zip"
    serialized = base64.b64encode(pickle.dumps(Trap(trap))).decode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {":type:": "?", ":serialized:": serialized}}))
    assert main(["evaluate", "--policies", str(path), "--episodes", "1"]) == 2
    message = capsys.readouterr().err
    assert "opening a pickle runs any code in it" in message
    assert "--trust-pickle" in message
    with pytest.raises(AmulettError, match="load_sb3_zip"):
        evaluate([str(path)], episodes=1)
    assert not trap.exists()
    with pytest.raises(AmulettError, match="no model that this Stable-Baselines3 can load"):
        load_sb3_zip(path, TESTBED, trust_pickle=True, about=ABOUT)
    assert trap.exists(), "the trap would not have worked"


@pytest.mark.parametrize("content", [b"", b"PK", b"no zip at all"])
def test_what_is_no_model_is_refused(tmp_path, content):
    (tmp_path / "model.zip").write_bytes(content)
    with pytest.raises(AmulettError, match=r"model\.zip.*no model"):
        load_sb3_zip(tmp_path / "model.zip", TESTBED, trust_pickle=True, about=ABOUT)
    with pytest.raises(AmulettError, match="no such file"):
        load_sb3_zip(tmp_path / "none.zip", TESTBED, trust_pickle=True)


def test_a_model_of_another_environment_is_refused(tmp_path):
    with pytest.raises(AmulettError, match=r"the observations of .* have shape \(3,\); it has to be \(13,\)"):
        load_sb3_zip(saved(tmp_path, env="Pendulum-v1"), TESTBED, trust_pickle=True)


def test_what_its_actions_mean_is_asked_for_and_used(tmp_path):
    path = saved(tmp_path)
    contender = load_sb3_zip(path, TESTBED, trust_pickle=True)
    assert contender.env_keywords == {"agent_period": 0.1, "tension_range": [5.0, 12.0]}
    env = evaluate([contender], episodes=1, duration=1.0).schedules[str(path)]
    assert env.tension_range == (5.0, 12.0) and env.error.size == 10  # agent steps of 0.1 s
    given = load_sb3_zip(path, TESTBED, trust_pickle=True, about={**ABOUT, "agent_period": 0.05})
    assert given.env_keywords["agent_period"] == 0.05
    looped = load_sb3_zip(path, TESTBED, trust_pickle=True, about={**ABOUT, "control": "cascade"})
    assert looped.env_keywords["control"] == "cascade"
    assert in_loop(looped, "co-rotation").env_keywords["control"] == "co-rotation"
    path.with_suffix(".json").unlink()
    with pytest.raises(
        AmulettError, match=r"holds neither the time between actions .*PPO\.json', for example .*agent_period"
    ):
        load_sb3_zip(path, TESTBED, trust_pickle=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env_id": "Amulett/Scaling-v1"}, "did you mean 'Amulett/Scaling-v0'"),
        ({"agent_period": -0.1}, r"PPO\.json'.*'agent_period' is -0\.1"),
        ({"period": 0.1}, "unknown key 'period'"),
    ],
)
def test_a_wrong_description_is_refused(changes, message, tmp_path):
    path = saved(tmp_path)
    path.with_suffix(".json").write_text(json.dumps({**ABOUT, **changes}))
    with pytest.raises(AmulettError, match=message):
        load_sb3_zip(path, TESTBED, trust_pickle=True)


def test_the_recipe_beside_a_zip_says_what_its_actions_mean(tmp_path):
    path = saved(tmp_path)
    path.with_suffix(".json").unlink()
    (tmp_path / "config.yaml").write_text(
        "env: {agent_period: 0.1, tension_range: [5.0, 8.0]}\nnetwork: {features: false}"
    )
    for env_id in ENV_IDS[:3]:
        contender = load_sb3_zip(path, TESTBED, env_id, trust_pickle=True)
        assert contender.env_keywords == {"agent_period": 0.1, "tension_range": [5.0, 8.0]}


@pytest.mark.parametrize(
    "settings",
    [
        {"network": {"features": True}, "env": {"agent_period": 0.1}},
        {"network": {"features": False}},  # the default low-pass
        {"network": {"features": False}, "env": {"agent_period": 0.1, "history": 3}},
    ],
)
def test_a_zip_of_a_recipe_that_shows_or_does_something_else_is_refused(tmp_path, settings):
    path = saved(tmp_path)
    path.with_suffix(".json").unlink()
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(settings))
    with pytest.raises(AmulettError, match="which its zip does not hold; use the bundle"):
        load_sb3_zip(path, TESTBED, trust_pickle=True)
