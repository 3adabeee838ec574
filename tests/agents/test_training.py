"""Training with Stable-Baselines3: the adapter, PPO, and what a run leaves behind."""

import argparse
import json
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from helpers import blank_figures

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3  # noqa: E402
from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402
from stable_baselines3.common.env_util import make_vec_env  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize  # noqa: E402

import amulett_gym  # noqa: E402
from amulett_agents import load_train_config, make_sb3_env, save_policy, train  # noqa: E402
from amulett_agents.adapter import SB3VecEnv  # noqa: E402
from amulett_agents.config import TrainConfig  # noqa: E402
from amulett_agents.model import make_model  # noqa: E402
from amulett_agents.run_folder import COLUMNS  # noqa: E402
from amulett_agents.time_limit import ValuesAtTimeLimits  # noqa: E402
from amulett_agents.validation import evaluate, make_validation_env, torch_threads  # noqa: E402
from amulett_gym import learning  # noqa: E402
from amulett_gym.cli import build_parser, main, quickstart  # noqa: E402
from amulett_gym.cli import train as command  # noqa: E402
from amulett_gym.cli.quickstart import LAWS  # noqa: E402
from amulett_gym.envs.reward import TERMS  # noqa: E402
from amulett_gym.envs.single import ScalingEnv  # noqa: E402
from amulett_gym.envs.vector import TensionVectorEnv  # noqa: E402
from amulett_gym.errors import AmulettError  # noqa: E402
from amulett_gym.laws.bundle import read_bundle  # noqa: E402
from amulett_gym.laws.contenders import contender_names  # noqa: E402
from amulett_gym.laws.features import FEATURES  # noqa: E402

SCALING, TENSION = amulett_gym.ENV_IDS[:2]
ROOT = Path(__file__).parents[2]

HANGS = 600
"""What a process is given that ends after its present rollout [s]: many times what a busy machine takes."""

SMALL = [
    "num_envs=16",
    "total_steps=2000",
    "network.hidden=[16]",
    "ppo.n_steps=32",
    "ppo.batch_size=128",
    "ppo.n_epochs=2",
    "env.max_episode_steps=75",
    "validation.every_steps=700",
    "validation.episodes=10",
]


@pytest.fixture(autouse=True)
def one_thread():
    """Torch's threads only get in each other's way in networks this small."""
    with torch_threads(1):
        yield


def weights(folder: Path) -> list[np.ndarray]:
    return [array for layer in read_bundle(folder).layers for array in layer]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One small training run, with its recipe."""
    config = load_train_config(overrides=[*SMALL, "checkpoint=true"])
    return config, train(config, tmp_path_factory.mktemp("runs") / "run", progress=False, command=["amulett", "train"])


# --- adapter


def assert_infos_agree(ours: dict, theirs: dict) -> None:
    for key, value in theirs.items():
        if isinstance(value, dict):
            assert_infos_agree(ours[key], value)
        else:
            np.testing.assert_array_equal(ours[key], value, err_msg=key)


@pytest.mark.parametrize(
    ("keywords", "steps", "ends"),
    [
        ({"max_episode_steps": 20}, 65, "truncated"),
        ({"profile": {"base": "testbed", "plant": {"velocity_limit_deg": 80.0}}}, 200, "terminated"),
        ({"max_episode_steps": 20, "suite": "reach", "observation_noise": 0.01, "agent_period": 0.04}, 45, "truncated"),
    ],
)
@pytest.mark.parametrize("env_id", [SCALING, TENSION])
def test_the_adapter_is_bit_for_bit_sb3s_own_vector_of_single_environments(env_id, keywords, steps, ends):
    ours = make_sb3_env(env_id, num_envs=5, **keywords)
    theirs = DummyVecEnv([lambda: gym.make(env_id, **keywords) for _ in range(5)])
    ours.seed(7)
    theirs.seed(7)
    assert np.array_equal(ours.reset(), theirs.reset())
    generator = np.random.default_rng(0)
    endings = 0
    for _ in range(steps):
        actions = generator.uniform(-1.2, 1.2, (5, 1)).astype(np.float32)
        our_observations, our_rewards, our_dones, our_infos = ours.step(actions)
        their_observations, their_rewards, their_dones, their_infos = theirs.step(actions)
        assert np.array_equal(our_observations, their_observations)
        assert np.array_equal(our_rewards, their_rewards)
        assert our_rewards.dtype == their_rewards.dtype
        assert np.array_equal(our_dones, their_dones)
        for done, our_info, their_info in zip(our_dones, our_infos, their_infos, strict=True):
            if not done:
                assert our_info == {}
                continue
            endings += 1
            assert our_info["TimeLimit.truncated"] == (ends == "truncated")
            assert_infos_agree(our_info, their_info)
    assert endings >= 5
    assert_infos_agree(ours.reset_infos[0], theirs.reset_infos[0])


class Rewards(BaseCallback):
    """Keeps the rewards that PPO's update sees."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.seen = self.model.rollout_buffer.rewards.copy()


@pytest.mark.parametrize("limit", [500.0, 80.0])  # [deg/s]; with the lower one, some episodes fail
def test_what_is_beyond_the_time_limit_is_added_once_and_as_sb3_adds_it(limit):
    profile = f"env.profile={{base: testbed, plant: {{velocity_limit_deg: {limit}}}}}"
    config = load_train_config(None, [*SMALL, "env.max_episode_steps=10", profile])
    theirs, ours = Rewards(), Rewards()
    make_model(config).learn(512, callback=[theirs])
    make_model(config).learn(512, callback=[ValuesAtTimeLimits(), ours])
    np.testing.assert_allclose(ours.seen, theirs.seen, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("staggered", [True, False])
def test_what_is_beyond_the_time_limit_is_added_in_each_step_of_a_rollout(staggered):
    config = load_train_config(None, [*SMALL, "env.max_episode_steps=4", f"staggered={str(staggered).lower()}"])
    rollout = config.num_envs * config.ppo.n_steps
    theirs, ours = Rewards(), Rewards()
    make_model(config).learn(rollout, callback=[theirs])
    make_model(config).learn(rollout, callback=[ValuesAtTimeLimits(), ours])
    np.testing.assert_allclose(ours.seen, theirs.seen, rtol=1e-6, atol=1e-6)


class BreaksOff(BaseCallback):
    """Ends a rollout in its next-to-last step."""

    def _on_step(self):
        return self.n_calls < self.model.n_steps - 1


def test_a_rollout_that_was_broken_off_leaves_nothing_to_the_next_one():
    config = load_train_config(None, [*SMALL, "env.max_episode_steps=5"])
    same, seen = ValuesAtTimeLimits(), []
    for before, after in ((same, same), (ValuesAtTimeLimits(), ValuesAtTimeLimits())):
        model, rewards = make_model(config), Rewards()
        model.learn(512, callback=[before, BreaksOff()])
        model.learn(512, callback=[after, rewards], reset_num_timesteps=False)  # at other times of the episodes
        seen.append(rewards.seen)
    assert np.array_equal(*seen)


def test_the_adapter_sums_rewards_and_their_terms_over_the_episode():
    plain = make_sb3_env(num_envs=4, max_episode_steps=30)
    monitored = VecMonitor(make_sb3_env(num_envs=4, max_episode_steps=30))
    for env in (plain, monitored):
        env.seed(0)
        env.reset()
    for _ in range(60):
        *_, infos = plain.step(np.zeros((4, 1), dtype=np.float32))
        *_, theirs = monitored.step(np.zeros((4, 1), dtype=np.float32))
        for info, their in zip(filter(None, infos), filter(None, theirs), strict=True):
            assert sum(info["episode_terms"].values()) == pytest.approx(info["episode"]["r"])
            assert info["episode"]["r"] == pytest.approx(their["episode"]["r"], rel=1e-5)
            assert info["episode"]["l"] == their["episode"]["l"] == 30
            assert info["episode"]["r"] < 0


def test_sb3_logs_each_episode_of_the_adapter_once():
    for wrap in (lambda env: env, VecMonitor):
        env = wrap(make_sb3_env(num_envs=4, max_episode_steps=30))
        model = PPO("MlpPolicy", env, n_steps=60, batch_size=60, n_epochs=1, device="cpu").learn(240)
        assert len(model.ep_info_buffer) == 8
        assert {info["l"] for info in model.ep_info_buffer} == {30}


def test_sb3_takes_the_adapters_statistics_as_those_of_a_monitor():
    evaluated = []
    limit = {"max_episode_steps": 20}
    for env in (make_sb3_env(num_envs=4, **limit), make_vec_env(SCALING, 4, env_kwargs=limit)):
        model = PPO("MlpPolicy", env, n_steps=8, device="cpu", seed=0)
        env.seed(3)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            evaluated.append(evaluate_policy(model, env, n_eval_episodes=8, return_episode_rewards=True))
    (returns, lengths), others = evaluated
    assert lengths == others[1] == [20] * 8
    assert returns == pytest.approx(others[0], abs=1e-6)
    assert not any(make_sb3_env(num_envs=2).env_is_wrapped(gym.wrappers.TimeLimit))


def test_a_seed_of_the_adapter_is_that_of_sb3s_make_vec_env():
    ours, theirs = make_sb3_env(num_envs=3, seed=7), make_vec_env(SCALING, 3, seed=7)
    assert np.array_equal(ours.reset(), theirs.reset())
    assert np.array_equal(ours.action_space.sample(), make_sb3_env(seed=7).action_space.sample())


class Doubled(TensionVectorEnv):
    """Doubles the rewards."""

    def step_report(self, actions, brief=False):
        observations, report, *ends = super().step_report(actions, brief)
        report[:, 0] *= 2.0
        return observations, report, *ends


def test_what_a_subclass_changes_of_a_step_is_seen_with_and_without_the_adapter():
    plain, doubled = (make(num_envs=3, max_episode_steps=5) for make in (TensionVectorEnv, Doubled))
    adapter = SB3VecEnv(Doubled(num_envs=3, max_episode_steps=5))
    adapter.seed(0)
    adapter.reset()
    plain.reset(seed=0)
    doubled.reset(seed=0)
    actions, total = np.zeros((3, 1), dtype=np.float32), 0.0
    for _ in range(5):
        rewards = 2.0 * plain.step(actions)[1]
        total += rewards
        assert np.array_equal(doubled.step(actions)[1], rewards)
        _, seen, _, infos = adapter.step(actions)
        assert np.array_equal(seen, rewards.astype(np.float32))
    assert [info["episode"]["r"] for info in infos] == total.tolist()


@pytest.mark.parametrize(("name", "other"), [("step", "step_report"), ("next_episodes", "next_report")])
def test_the_adapter_refuses_a_subclass_whose_changes_it_would_pass_over(name, other):
    changed = type("Changed", (TensionVectorEnv,), {name: lambda self, given: None})
    with pytest.raises(AmulettError, match=f"Changed overrides '{name}', .* override '{other}'"):
        SB3VecEnv(changed(num_envs=1))


def test_the_adapter_refuses_an_autoreset_of_the_environment():
    with pytest.raises(AmulettError, match="autoreset_mode is 'SameStep'; SB3VecEnv resets finished devices itself"):
        make_sb3_env(autoreset_mode="SameStep")


def test_a_recipe_is_refused_without_importing_torch(tmp_path):
    script = (
        "import sys; from amulett_gym.cli import main;"
        "code = main(['train', '--set', 'seed=one', '--out', 'run']); print(code, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "2 False"
    assert not list(tmp_path.iterdir())


def test_observations_and_infos_of_the_adapter_never_alias():
    env = make_sb3_env(num_envs=2, max_episode_steps=2)
    env.seed(0)
    first = env.reset()
    copy = first.copy()
    _, _, _, infos = env.step(np.ones((2, 1), dtype=np.float32))
    assert np.array_equal(first, copy)
    assert infos[0] is not infos[1]
    infos[0]["mine"] = 1
    kept = infos[0]
    observations, _, _, infos = env.step(np.ones((2, 1), dtype=np.float32))
    assert "mine" not in infos[0] and kept == {"mine": 1}
    last = infos[0]["terminal_observation"].copy()
    observations[...] = 0.0
    assert np.array_equal(infos[0]["terminal_observation"], last)


def test_the_adapter_refuses_wrappers_below_itself():
    wrapped = gym.wrappers.vector.RecordEpisodeStatistics(gym.make_vec("Amulett/Scaling-v0", num_envs=2))
    with pytest.raises(AmulettError, match="is wrapped; give SB3VecEnv the native environment"):
        type(make_sb3_env(num_envs=2))(wrapped)


def test_the_adapter_replays_scenarios_given_by_set_options():
    env = make_sb3_env(num_envs=2)
    env.set_options({"scenario": {"initial_angle_deg": 30.0}})
    env.seed(0)
    assert env.reset()[:, 1] * 150 == pytest.approx([30.0, 30.0], abs=1.0)
    # SB3's reset is one of all devices: the vector environment's mask is none of its options.
    for wrong in ({"speed": 2}, {"reset_mask": np.zeros(2, dtype=bool)}):
        env.set_options(wrong)
        with pytest.raises(AmulettError, match=rf"unknown reset option '{next(iter(wrong))}'.*scenario"):
            env.reset()
    env.set_options([{"scenario": {}}, {}])
    with pytest.raises(AmulettError, match="gave a scenario to 1 of 2 devices"):
        env.reset()


def test_attributes_are_those_of_sb3s_own_vector_of_single_environments():
    keywords = {"suite": "reach", "agent_period": 0.05, "max_episode_steps": 40}
    ours = make_sb3_env(SCALING, num_envs=2, threads=2, **keywords)
    theirs = make_vec_env(SCALING, n_envs=2, env_kwargs=keywords, vec_env_cls=DummyVecEnv)
    ours.seed(3)
    theirs.seed(3)
    ours.reset()
    theirs.reset()
    names = ("observation_space", "action_space", "scenario", "profile", "tension_range")
    for name in names:
        assert ours.get_attr(name) == theirs.get_attr(name), name
        assert ours.env_method("get_wrapper_attr", name) == theirs.get_attr(name)
    assert ours.get_attr("scenario", 1) == theirs.get_attr("scenario", 1)
    assert ours.get_attr("metadata") == [{"render_modes": ["rgb_array", "rgb_array_list"], "render_fps": 20}] * 2
    mine, single = ours.get_attr("spec")[0], theirs.get_attr("spec")[0]
    assert (mine.id, mine.max_episode_steps, mine.kwargs) == (single.id, 40, {"suite": "reach", "agent_period": 0.05})
    assert gym.make(mine).unwrapped.observation_space == ours.get_attr("observation_space")[0]


def test_a_step_before_the_adapters_own_reset_is_refused():
    env = make_sb3_env(num_envs=2)
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before step\(\)"):
            env.step(np.zeros((2, 1)))
        env.venv.reset(seed=0)  # the adapter's sums have not begun yet
    env.reset()
    env.step(np.zeros((2, 1)))


def test_attributes_are_shared_and_devices_have_no_methods():
    env = VecMonitor(make_sb3_env(num_envs=3))
    assert env.get_attr("tension_range") == [(4.0, 15.0)] * 3
    assert env.env_is_wrapped(VecMonitor) == [False] * 3
    assert not env.has_attr("nothing")
    with pytest.raises(AmulettError, match="single devices"):
        env.env_method("get_state")
    env.close()
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"env_id": "Amulett/Scale-v0"}, "did you mean 'Amulett/Scaling-v0'"),
        ({"num_envs": 0}, "'num_envs' is 0"),
        ({"suite": "step"}, "did you mean 'steps'"),
    ],
)
def test_the_adapter_refuses_wrong_arguments(arguments, message):
    with pytest.raises(AmulettError, match=message):
        make_sb3_env(**arguments)


# --- learning


def test_plain_ppo_learns_on_a_single_environment_and_becomes_a_bundle(tmp_path):
    env = gym.make(f"amulett_gym:{SCALING}", max_episode_steps=100)
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=64, n_epochs=2, seed=0).learn(2048)
    policy = amulett_gym.load_policy(save_policy(model, tmp_path / "bundle"), env)
    observations = np.random.default_rng(0).uniform(-1, 1, (200, 13)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    np.testing.assert_allclose(policy(observations), expected, rtol=0, atol=1e-6)
    about = read_bundle(tmp_path / "bundle").env
    assert (about.id, about.keywords, about.max_episode_steps) == (SCALING, {}, 100)
    evaluate_policy(model, make_sb3_env(num_envs=2, max_episode_steps=10), n_eval_episodes=2, warn=False)


@pytest.mark.parametrize("use_sde", [False, True])
def test_ppo_and_a2c_learn_on_the_adapter_and_become_bundles(tmp_path, use_sde):
    for kind, steps in ((PPO, {"n_steps": 64, "batch_size": 256, "n_epochs": 2}), (A2C, {})):
        env = make_sb3_env(TENSION, num_envs=8, max_episode_steps=50, tension_range=(6.0, 12.0), profile="simulation")
        model = kind("MlpPolicy", env, use_sde=use_sde, seed=0, device="cpu", **steps).learn(2000)
        bundle = read_bundle(save_policy(model, tmp_path / "bundle"))
        observations = np.random.default_rng(0).uniform(-1, 1, (200, 13)).astype(np.float32)
        expected, _ = model.predict(observations, deterministic=True)
        np.testing.assert_allclose(bundle.act(observations), expected, rtol=0, atol=1e-6)
        assert bundle.policy.tension_range == [6.0, 12.0]
        assert bundle.env.keywords == {"tension_range": [6.0, 12.0], "profile": "simulation"}


@pytest.mark.parametrize("learner", [SAC, TD3, DDPG])
def test_sac_td3_and_ddpg_learn_on_the_adapter_and_become_bundles(learner, tmp_path):
    env = make_sb3_env(TENSION, num_envs=8, max_episode_steps=50)
    small = {"buffer_size": 2000, "gradient_steps": 2, "policy_kwargs": {"net_arch": [32, 32]}}
    model = learner("MlpPolicy", env, seed=0, device="cpu", learning_rate=0.001, **small)
    bundle = read_bundle(save_policy(model.learn(1500), tmp_path / "bundle"))
    observations = np.random.default_rng(0).uniform(-1, 1, (200, 13)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(bundle.act(observations), expected, rtol=0, atol=1e-6)
    assert bundle.policy.network.output == "tanh"


def test_the_adapters_state_can_be_put_back():
    env = make_sb3_env(num_envs=3, max_episode_steps=20)
    with pytest.raises(AmulettError, match="call reset"):
        env.get_state()
    env.seed(0)
    env.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (60, 3, 1)).astype(np.float32)

    def play():
        return [env.step(action) for action in actions[10:]]

    for action in actions[:10]:
        env.step(action)
    state = env.get_state()
    first, endings = play(), 0
    env.set_state(state)
    for before, after in zip(first, play(), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(before[:3], after[:3], strict=True))
        for ours, theirs in zip(before[3], after[3], strict=True):
            if ours:
                endings += 1
                assert ours["episode"]["r"] == theirs["episode"]["r"]
                assert ours["episode_terms"] == theirs["episode_terms"]
    assert endings == 9


def test_an_own_profile_travels_inside_the_bundle(tmp_path):
    env = make_sb3_env(profile={"base": "testbed", "name": "mine", "loop": {"offset_deg": 25.0}})
    model = PPO("MlpPolicy", env, n_steps=4, batch_size=4, device="cpu")
    about = read_bundle(save_policy(model, tmp_path / "bundle")).env
    again = gym.make(about.id, max_episode_steps=about.max_episode_steps, **about.keywords)
    assert again.unwrapped.profile == env.get_attr("profile")[0]


@pytest.mark.parametrize(
    ("make", "limit"),
    [
        (lambda: gym.make(SCALING, max_episode_steps=-1), -1),
        (lambda: ScalingEnv(), -1),
        (lambda: gym.wrappers.TimeLimit(ScalingEnv(), 30), 30),
        (lambda: gym.make(SCALING, max_episode_steps=None), 500),
        (lambda: gym.make(SCALING, max_episode_steps=True), 1),
        (lambda: make_sb3_env(SCALING, max_episode_steps=-1), -1),
        (lambda: make_sb3_env(SCALING, max_episode_steps=None), 500),
        (lambda: make_sb3_env(SCALING, max_episode_steps=np.int64(40), reward_weights={"effort": np.float32(0.5)}), 40),
    ],
)
def test_a_policy_can_be_kept_whatever_its_environments_time_limit(tmp_path, make, limit):
    model = PPO("MlpPolicy", make(), n_steps=4, batch_size=4, n_epochs=1, device="cpu").learn(4)
    about = read_bundle(save_policy(model, tmp_path / "bundle")).env
    assert (about.id, about.max_episode_steps) == (SCALING, limit)
    again = gym.make(about.id, max_episode_steps=about.max_episode_steps, **about.keywords)
    assert again.unwrapped.settings.keywords() == about.keywords


def test_wrappers_that_change_a_range_are_refused(tmp_path):
    wide = gym.wrappers.RescaleAction(gym.make(SCALING), np.float32(-2.0), np.float32(2.0))
    inner = gym.make(SCALING)
    space = gym.spaces.Box(10.0 * inner.observation_space.low, 10.0 * inner.observation_space.high)
    large = gym.wrappers.TransformObservation(inner, lambda observation: 10.0 * observation, space)
    for env, what in ((wide, "actions"), (large, "observations")):
        model = PPO("MlpPolicy", env, n_steps=4, batch_size=4, device="cpu")
        with pytest.raises(AmulettError, match=f"changes the range of the {what}"):
            save_policy(model, tmp_path / "bundle")


def test_a_bundle_names_the_reward_function_it_was_trained_with(tmp_path):
    def rooted(costs, terms):
        return -np.sqrt(costs["position"])

    model = PPO("MlpPolicy", make_sb3_env(reward_fn=rooted), n_steps=4, batch_size=4, n_epochs=1, device="cpu").learn(4)
    bundle = read_bundle(save_policy(model, tmp_path / "bundle"))
    assert bundle.provenance["reward_fn"].endswith("rooted") and bundle.env.keywords == {}


def test_what_a_bundle_cannot_hold_is_refused(tmp_path):
    small = {"n_steps": 4, "batch_size": 4, "device": "cpu"}
    env = make_sb3_env()
    two = gym.wrappers.TransformAction(gym.make(SCALING), lambda choice: [choice - 0.5], gym.spaces.Discrete(2))
    cases = [
        (PPO("MlpPolicy", VecNormalize(make_sb3_env()), **small), "VecNormalize"),
        (PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.ELU}, **small), "ELU"),
        (PPO("MlpPolicy", make_vec_env("Pendulum-v1"), **small), "AMULETT environment"),
        (DQN("MlpPolicy", two, device="cpu", buffer_size=10), "PPO, A2C, SAC, TD3 or DDPG.*DQNPolicy"),
    ]
    for model, message in cases:
        with pytest.raises(AmulettError, match=message):
            save_policy(model, tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


# --- recipes


def test_the_shipped_recipe_is_the_default_one():
    assert load_train_config(ROOT / "configs" / "ppo.yaml") == TrainConfig()


def test_overrides_are_yaml_and_exponents_are_numbers():
    config = load_train_config(
        None, ["ppo.learning_rate=3e-4", "env.tension_range=[6, 12]", "seed=5", "env.reward_weights.contact=1.0"]
    )
    assert config.ppo.learning_rate == 3e-4
    assert config.env.tension_range == [6, 12]
    assert config.env.reward_weights == {"contact": 1.0}
    assert config.seed == 5


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("ppo.learing_rate=1", "did you mean 'learning_rate'"),
        ("total_step=1", "did you mean 'total_steps'"),
        ("ppo.gamma=1.5", r"'ppo\.gamma' is 1\.5.*less than or equal to 1"),
        ("seed=one", "'seed' is 'one'"),
        ("env.id=Amulett/Scalling-v0", "did you mean 'Amulett/Scaling-v0'"),
        ("env.suite=step", "did you mean 'steps'"),
        ("env.reward_weights.efort=1", "did you mean 'effort'"),
        ("env.tension_range=[9, 5]", "0 <= low < high"),
        ("ppo.batch_size=1000", "has to divide"),
        ("algorithm=a2c", "'ppo' or 'sac'"),
        ("sac.tau=0", r"'sac\.tau' is 0"),
        ("env.history=0", r"'env\.history' is 0"),
        ("network.initial_tension=20", "tension_range"),
        ("network.hidden=[0]", "from 1 to 1024"),
        ("seed", "key=value"),
        ("=1", "key=value"),
        ("ppo.=1", "key=value"),
        ("seed=[", "not valid YAML"),
    ],
)
def test_a_wrong_override_is_refused_with_what_would_be_right(override, message):
    with pytest.raises(AmulettError, match=message):
        load_train_config(None, [override])


def test_the_first_policy_is_the_constant_of_the_recipe():
    config = load_train_config(None, [*SMALL, "network.initial_tension=11", "env.tension_range=[5, 13]"])
    model = make_model(config)
    shape = (20, *model.observation_space.shape)
    observations = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    actions, _ = model.predict(observations, deterministic=True)
    assert 5 + (actions + 1) / 2 * 8 == pytest.approx(11.0, abs=1e-5)


def test_exploration_falls_to_its_final_size_if_that_is_given(tmp_path):
    config = load_train_config(None, [*SMALL, "ppo.initial_std=0.2", "ppo.final_std=0.05"])
    result = train(config, tmp_path / "run", progress=False)
    rows = (result.out / "evaluations.csv").read_text().splitlines()
    stds = [float(row.split(",")[-1]) for row in rows[1:]]
    assert stds[0] == pytest.approx(0.2)
    assert stds[1] == pytest.approx(0.2 * 0.25 ** (1024 / 2000))
    assert stds == sorted(stds, reverse=True)


def test_threads_change_neither_the_weights_nor_the_bundle(run, tmp_path):
    config, result = run
    env = config.env.model_copy(update={"threads": 1})
    again = train(config.model_copy(update={"env": env}), tmp_path / "run", progress=False)
    assert all(np.array_equal(a, b) for a, b in zip(weights(result.last), weights(again.last), strict=True))
    assert read_bundle(again.last).env == read_bundle(result.last).env


# --- runs


def test_a_run_keeps_recipe_command_validations_and_policies(run):
    config, result = run
    assert load_train_config(result.out / "config.yaml") == config
    assert json.loads((result.out / "command.json").read_text())["command"] == ["amulett", "train"]
    header, *rows = (result.out / "evaluations.csv").read_text().splitlines()
    assert header == ",".join(COLUMNS)
    assert [int(row.split(",")[0]) for row in rows] == [0, 1024, 2048]
    costs = [float(row.split(",")[2]) for row in rows]
    assert (result.best_cost, result.last_cost, result.steps) == (min(costs), costs[-1], 2048)
    provenance = read_bundle(result.best).provenance
    assert provenance["validation"]["cost"] == result.best_cost
    assert provenance["steps"] == result.best_steps
    assert provenance["config"] == config.model_dump()
    assert provenance["versions"]["torch"] == torch.__version__
    assert (result.out / "last_sb3.zip").is_file()


def test_the_kept_policy_costs_what_its_validation_said(run):
    config, result = run
    env = make_validation_env(config)
    policy = amulett_gym.load_policy(result.last, env)
    observations, _ = env.reset(seed=config.validation.seed)
    total = 0.0
    for _ in range(75):  # the task begins after the 25th
        observations, rewards, *_ = env.step(policy(observations))
        total -= rewards.mean()
    assert total == pytest.approx(result.last_cost, rel=1e-5)
    assert total > 0.0


def test_sb3s_own_checkpoint_is_the_last_policy(run):
    _, result = run
    model = PPO.load(result.out / "last_sb3.zip", device="cpu")
    shape = (50, *model.observation_space.shape)  # what its critic saw, too
    observations = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    known = 13 + len(FEATURES)
    np.testing.assert_allclose(read_bundle(result.last).act(observations[:, :known]), expected, rtol=0, atol=1e-5)


def test_tensorboard_shows_the_rewards_terms_and_the_validations(run):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    _, result = run
    log = EventAccumulator(str(result.out / "tensorboard"))
    log.Reload()
    tags = set(log.Tags()["scalars"])
    assert {f"reward/{term}" for term in TERMS} <= tags
    assert {"time/rollout_steps_per_second", "validation/cost", "rollout/ep_rew_mean", "train/value_loss"} <= tags
    returns = {event.step: event.value for event in log.Scalars("rollout/ep_rew_mean")}
    for term_sum in zip(*(log.Scalars(f"reward/{term}") for term in TERMS), strict=True):
        assert sum(event.value for event in term_sum) == pytest.approx(returns[term_sum[0].step], rel=1e-4)
    assert log.Scalars("validation/cost")[-1].value == pytest.approx(result.last_cost)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(run, tmp_path):
    config, result = run
    again = train(config, tmp_path / "again", progress=False)
    other = train(config.model_copy(update={"seed": 1}), tmp_path / "other", progress=False)
    for name in ("best", "last"):
        first = weights(result.out / name)
        assert all(np.array_equal(a, b) for a, b in zip(first, weights(again.out / name), strict=True))
    assert not np.array_equal(weights(result.last)[0], weights(other.last)[0])


def test_validation_charges_only_the_episode_of_each_device():
    config = load_train_config(None, [*SMALL, "network.initial_tension=null"])
    model = make_model(config)
    keywords = {"num_envs": 6, "profile": {"base": "testbed", "plant": {"velocity_limit_deg": 80.0}}}
    scores = evaluate(model, gym.make_vec(SCALING, **keywords), seed=3)
    env = gym.make_vec(SCALING, **keywords)
    env.reset(seed=3)
    returns, playing = np.zeros(6), np.ones(6, dtype=bool)
    while playing.any():
        _, rewards, terminated, truncated, _ = env.step(np.zeros((6, 1), dtype=np.float32))
        returns += np.where(playing, rewards, 0.0)
        playing &= ~(terminated | truncated)
    assert scores["cost"] == pytest.approx(-returns.mean())
    assert 0 < scores["failures"] <= 6


def test_a_time_limit_ends_a_run(tmp_path):
    config = load_train_config(None, [*SMALL, "total_steps=100000000", "max_seconds=0.5"])
    result = train(config, tmp_path / "run", progress=False)
    assert not result.interrupted
    assert 0 < result.steps < 100_000_000
    read_bundle(result.last)


def test_the_time_limit_begins_when_the_kernel_is_compiled(tmp_path, monkeypatch):
    clock = iter(range(10_000_000))
    config = load_train_config(None, [*SMALL, "total_steps=64", "max_seconds=1000000"])
    monkeypatch.setattr("amulett_agents.training.warm_up", lambda _: [next(clock) for _ in range(5_000_000)])
    monkeypatch.setattr("amulett_agents.run.time.monotonic", lambda: float(next(clock)))
    assert train(config, tmp_path / "run", progress=False).steps == 512


def test_a_run_overwrites_nothing_unasked(run, tmp_path):
    config, _ = run
    short = config.model_copy(update={"total_steps": 512})
    out = tmp_path / "run"
    out.mkdir()
    train(short, out, progress=False)
    before = weights(out / "last")
    with pytest.raises(AmulettError, match="holds a training run already"):
        train(short.model_copy(update={"seed": 1}), out, progress=False)
    assert all(np.array_equal(a, b) for a, b in zip(before, weights(out / "last"), strict=True))
    train(short.model_copy(update={"seed": 1}), out, progress=False, overwrite=True)
    assert not np.array_equal(before[0], weights(out / "last")[0])
    (tmp_path / "notes.txt").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(AmulettError, match="holds no training run"):
            train(short, tmp_path, progress=False, overwrite=overwrite)
    with pytest.raises(AmulettError, match="is a file"):
        train(short, tmp_path / "notes.txt", progress=False)


def test_wrong_environment_settings_leave_nothing_behind(run, tmp_path):
    config, _ = run
    wrong = config.model_copy(update={"env": config.env.model_copy(update={"agent_period": 0.0213})})
    with pytest.raises(AmulettError, match="agent_period"):
        train(wrong, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_without_torch_the_command_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(learning, "find_spec", lambda name: None if name == "torch" else object())
    with pytest.raises(AmulettError, match=r"needs torch, not installed.*\[agents\]"):
        command.run(argparse.Namespace(config=None, overrides=[], out=str(tmp_path / "run"), seed=None))


def interruptible(words, **pipes):
    """Start a process that Ctrl-C ends, even if the tests run in the background, where shells let it be ignored."""
    return subprocess.Popen(words, text=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **pipes)


def test_ctrl_c_ends_the_command_in_good_order(tmp_path):
    program = (
        "import argparse, sys; from amulett_gym.cli import train; parser = argparse.ArgumentParser();"
        "train.add_arguments(parser); sys.exit(train.run(parser.parse_args()))"
    )
    out = tmp_path / "run"
    arguments = ["--out", str(out), "--json", "--seed", "3", "--set", *SMALL, "total_steps=100000000"]
    process = interruptible([sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE)
    table = out / "evaluations.csv"
    while process.poll() is None and not (table.is_file() and len(table.read_text().splitlines()) > 2):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate(timeout=HANGS)
    assert process.returncode == 130
    result = json.loads(stdout)
    assert result["interrupted"] is True
    assert read_bundle(result["last"]).provenance["steps"] == result["steps"] > 0
    assert read_bundle(result["best"]).provenance["seed"] == 3


def test_sac_is_trained_logged_and_kept_like_ppo(tmp_path, monkeypatch):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    monkeypatch.setattr("amulett_agents.run._LOG_EVERY", 500)
    changes = ["algorithm=sac", "sac.learning_starts=400", "sac.gradient_steps=1", "sac.batch_size=64"]
    config = load_train_config(None, [*SMALL, *changes, "network.initial_tension=7"])
    result = train(config, tmp_path / "run", progress=False)
    bundle = read_bundle(result.last)
    assert bundle.provenance["algorithm"] == "SAC"
    header, *rows = (result.out / "evaluations.csv").read_text().splitlines()
    assert header == ",".join(COLUMNS)
    assert [int(row.split(",")[0]) for row in rows] == [0, 704, 1408, 2000]
    assert float(rows[0].split(",")[-1]) == pytest.approx(config.sac.initial_std)
    env = make_validation_env(config)
    policy, total = amulett_gym.load_policy(result.last, env), 0.0
    observations, _ = env.reset(seed=config.validation.seed)
    for _ in range(75):
        observations, rewards, *_ = env.step(policy(observations))
        total -= rewards.mean()
    assert total == pytest.approx(result.last_cost, rel=1e-5)
    log = EventAccumulator(str(result.out / "tensorboard"))
    log.Reload()
    tags = set(log.Tags()["scalars"])
    assert {f"reward/{term}" for term in TERMS} <= tags
    assert {"validation/cost", "rollout/ep_rew_mean", "train/critic_loss", "train/ent_coef"} <= tags
    assert [event.step for event in log.Scalars("time/rollout_steps_per_second")] == [512, 1008, 1504, 2000]


def test_the_first_policy_of_sac_is_the_constant_of_the_recipe():
    for tension in (5.0, 7.0, 8.0):
        config = load_train_config(None, [*SMALL, "algorithm=sac", f"network.initial_tension={tension}"])
        model = make_model(config)
        shape = (20, *model.observation_space.shape)
        observations = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
        actions, _ = model.predict(observations, deterministic=True)
        assert 4 + (actions + 1) / 2 * 11 == pytest.approx(tension, abs=0.01)


def test_a_model_leaves_no_folder_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    make_model(load_train_config(None, SMALL)).learn(512)
    assert not list(tmp_path.iterdir())


# --- quickstart


def test_quickstart_trains_compares_all_laws_and_replaces_only_its_own(tmp_path, monkeypatch, capsys):
    out = tmp_path / "quick"
    monkeypatch.setattr(quickstart, "_recipe", lambda arguments: load_train_config(None, SMALL))
    monkeypatch.setattr("amulett_gym.reporting.progress.FIRST", 0.0)  # else only a slow training shows its progress
    words = ["quickstart", "--episodes", "2", "--out", str(out)]
    assert main([*words, "--json"]) == 0
    printed = capsys.readouterr()
    assert "training, seed 0" in printed.err  # stdout is the JSON document alone
    steps = json.loads((out / "ppo" / "finished.json").read_text())["steps"]
    remarks = json.loads((out / "results.json").read_text())["remarks"]
    assert f"the policy was trained for {steps:,} steps; the full recipe (amulett train) takes 5,000,000" in remarks
    assert any(remark.startswith("the best constant on these scenarios is") for remark in remarks)
    assert f"{steps:,} steps" in (out / "report.html").read_text()
    assert set(LAWS) | {str(out / "ppo")} == set(json.loads(printed.out)["policies"])
    laws = {name for name in contender_names() if not name.endswith(">")}
    elsewhere = {f"{law}:{suite}" for law in ("eq6-tuned", "parametric") for suite in ("mixed", "steps", "plausible")}
    elsewhere |= {name for name in laws if name.startswith("pretrained")}  # made by hours of what is shown here
    assert laws - elsewhere <= set(LAWS)
    assert (out / "report.html").read_text().count("<svg") == len(list(out.glob("*.png"))) == 4
    blank_figures(monkeypatch)
    assert main(["rerun", str(out), "--out", str(tmp_path / "again")]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    assert main(words) == 0
    again = capsys.readouterr().out
    assert "Replacing the earlier run" in again
    assert f"amulett play {out / 'ppo'}" in again
    (tmp_path / "notes.txt").write_text("mine")
    assert main([*words[:-1], str(tmp_path)]) == 2
    assert "holds no quickstart" in capsys.readouterr().err


def test_the_quickstart_trains_for_steps_and_not_for_seconds():
    arguments = build_parser().parse_args(["quickstart"])
    config = quickstart._recipe(arguments)
    assert (config.total_steps, config.max_seconds) == (quickstart.STEPS, None)


def test_ctrl_c_in_quickstart_says_what_is_kept(tmp_path):
    program = (
        "import sys; from amulett_agents import load_train_config; from amulett_gym.cli import main, quickstart;"
        f"quickstart._recipe = lambda arguments: load_train_config(None, {[*SMALL, 'total_steps=100000000']});"
        f"sys.exit(main(['quickstart', '--out', {str(tmp_path)!r}]))"
    )  # with small rollouts: it ends after the present one
    process = interruptible([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while process.poll() is None and not (tmp_path / "ppo" / "evaluations.csv").is_file():
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=HANGS)
    assert process.returncode == 130
    assert f"is kept in {tmp_path / 'ppo' / 'best'}" in stderr
    read_bundle(tmp_path / "ppo" / "best")
