"""Episodes of a data set: the environment that they name plays them again, bit for bit. Minari is not needed."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from helpers import make_bundle

from amulett_gym import DRIVES_ID, ENV_IDS, WORN_ID
from amulett_gym.datasets import files, playing
from amulett_gym.datasets.playing import PlayedEpisode, Random, make_stage, play_episodes
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import Own, parse_contender
from amulett_gym.laws.worn import Latched, WornLaw

SCALING, TENSION = ENV_IDS[:2]
SLOWER = {"name": "slower", "base": "testbed", "variable_stiffness": {"minimum_tension": 5.0}}
RANDOM = Random("random")


def both_ways(observations):
    """Return two actions, beyond the space's range now and then."""
    return np.stack([1.5 * observations[:, 3], -observations[:, 1]], axis=1)


def play(contender, env_id=SCALING, episodes=3, seed=5, duration=0.6, **given):
    stage = make_stage([contender], env_id, duration, given)
    return stage, [each for batch in play_episodes(stage, contender, seed, episodes) for each in batch]


def replayed(spec: EnvSpec, episode: PlayedEpisode):
    """Return observations, rewards and last flags of the same actions in an environment made from its description."""
    env = gym.make(EnvSpec.from_json(spec.to_json()))
    observations, rewards = [env.reset(seed=episode.seed, options=episode.options)[0]], []
    flags = ()
    for action in episode.actions:
        assert env.action_space.contains(action)
        observation, reward, *flags, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.stack(observations), np.array(rewards), flags


CASES = {
    "eq. 6": (parse_contender("eq6-held"), SCALING, {"suite": "mixed"}),
    "random actions": (RANDOM, TENSION, {"suite": "contact", "split": "shifted", "profile": "simulation"}),
    "a policy with a memory": (
        parse_contender("pretrained"),
        SCALING,
        {"suite": "mixed", "fleet": ["testbed", "simulation"]},
    ),
    "a law with its device's parameters": (parse_contender("eq6-held"), TENSION, {"fleet": ["testbed", SLOWER]}),
    "another loop": (parse_contender("co-rotation/constant:3"), SCALING, {"suite": "reach"}),
    "both drives": (Own("both", act=both_ways), DRIVES_ID, {"fleet": ["simulation", "testbed"]}),
    "a worn device": (Own("latched", act=WornLaw(Latched())), WORN_ID, {}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_named_environment_plays_the_same_episode_again(case):
    contender, env_id, given = CASES[case]
    stage, episodes = play(contender, env_id, episodes=2, **given)
    assert len(episodes) == 2 * len(stage.settings.devices)
    assert [each.seed for each in episodes] == list(range(5, 5 + len(episodes)))
    for episode in (episodes[0], episodes[-1]):
        observations, rewards, flags = replayed(stage.spec, episode)
        np.testing.assert_array_equal(observations, episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        assert flags == [episode.failed, not episode.failed]
        assert episode.observations.dtype == episode.actions.dtype == np.float32
        assert len(episode.actions) == 30


def test_a_failure_ends_its_episode_alone():
    fragile = {"name": "fragile", "base": "testbed", "plant": {"velocity_limit_deg": 150.0}}
    stage, episodes = play(RANDOM, episodes=12, duration=4.0, suite="steps", profile=fragile)
    lengths = [len(each.actions) for each in episodes]
    assert {each.failed for each in episodes} == {True, False} and min(lengths) < max(lengths) == stage.steps
    for episode in episodes:
        assert episode.failed == (len(episode.actions) < stage.steps)
    failed = next(each for each in episodes if each.failed)
    observations, rewards, flags = replayed(stage.spec, failed)
    np.testing.assert_array_equal(observations, failed.observations)
    np.testing.assert_array_equal(rewards, failed.rewards)
    assert flags == [True, False]


@pytest.mark.parametrize("contender", [RANDOM, parse_contender("pretrained")], ids=["random", "pretrained"])
def test_batches_change_no_bit(contender, monkeypatch):
    _, whole = play(contender, episodes=5, suite="mixed")
    monkeypatch.setattr(playing, "BATCH", 2)
    _, parts = play(contender, episodes=5, suite="mixed")
    for one, other in zip(whole, parts, strict=True):
        assert one.seed == other.seed
        np.testing.assert_array_equal(one.observations, other.observations)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_random_actions_fill_the_space_and_differ():
    _, episodes = play(RANDOM, DRIVES_ID, episodes=3)
    actions = np.stack([each.actions for each in episodes])
    assert actions.shape == (3, 30, 2) and -1.0 <= actions.min() < -0.9 and 0.9 < actions.max() <= 1.0
    assert np.unique(actions).size == actions.size


def test_the_environment_reaches_as_far_as_any_of_its_policies(tmp_path):
    wide = parse_contender(str(make_bundle(tmp_path / "wide", tension_range=[4.5, 18.0])))
    stage = make_stage([wide], SCALING, 1.0, {})
    assert stage.spec.kwargs["tension_range"] == [4.5, 18.0]
    stage = make_stage([wide, parse_contender("constant:4")], SCALING, 1.0, {})
    assert stage.spec.kwargs["tension_range"] == [4.0, 18.0]


@pytest.mark.parametrize(
    ("names", "env_id", "message"),
    [
        (["eq6"], SCALING, "'eq6' acts inside the loop, .* record 'eq6-held'"),
        (["position-only"], SCALING, "acts inside the loop, where actions have no effect"),
        (["constant:8", "co-rotation/constant:8"], SCALING, "needs control=decentralized and .* two data sets"),
        (["constant:8"], "Amulett/Scalling-v0", "did you mean 'Amulett/Scaling-v0'"),
    ],
)
def test_policies_without_a_common_environment_are_refused(names, env_id, message):
    with pytest.raises(AmulettError, match=message):
        make_stage([parse_contender(name) for name in names], env_id, 1.0, {})


def test_policies_of_another_environment_are_refused():
    drives = Own("drives", act=both_ways, env_id=DRIVES_ID)
    with pytest.raises(AmulettError, match=f"'drives' acts in {DRIVES_ID} alone.*--env-id"):
        make_stage([drives], SCALING, 1.0, {})
    stage = make_stage([parse_contender("constant:8")], WORN_ID, 1.0, {})
    with pytest.raises(AmulettError, match="'constant:8' chooses a tension and cannot act in Amulett/Worn-v0"):
        next(play_episodes(stage, parse_contender("constant:8"), 0, 1))


def test_without_minari_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(files, "find_spec", lambda name: None if name == "minari" else object())
    with pytest.raises(AmulettError, match=r"data sets need minari, not installed here.*'\.\[datasets\]'"):
        files.check_minari()
