"""A policy that starts as another one ended: it acts alike, its critic learns first, and nothing else may differ."""

import shutil
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from amulett_agents import run  # noqa: E402
from amulett_agents.bundles import describe_policy, save_policy, start_from  # noqa: E402
from amulett_agents.config import ADAPTATION, CRITIC_STEPS, load_train_config  # noqa: E402
from amulett_agents.critic_file import critic_of_bundle  # noqa: E402
from amulett_agents.model import callbacks, make_model  # noqa: E402
from amulett_agents.run import Run  # noqa: E402
from amulett_agents.training import resume, train  # noqa: E402
from amulett_gym.cli import main  # noqa: E402
from amulett_gym.envs.transition import OBSERVATIONS  # noqa: E402
from amulett_gym.errors import AmulettError  # noqa: E402
from amulett_gym.laws.actor import Actor  # noqa: E402
from amulett_gym.laws.bundle import read_bundle, write_bundle  # noqa: E402
from amulett_gym.laws.contenders import bundle_folder  # noqa: E402
from amulett_gym.laws.features import FEATURES  # noqa: E402

SMALL = [
    "num_envs=4",
    "network.hidden=[16, 8]",
    "ppo.n_steps=16",
    "ppo.batch_size=32",
    "ppo.n_epochs=1",
    "env.max_episode_steps=30",
]
CAUSAL = Path(__file__).parents[2] / "configs" / "causal.yaml"


def model_of(*changes):
    return make_model(load_train_config(None, [*SMALL, *changes]))


def bundle_of(folder, *changes):
    """Return a bundle of such a recipe's network with random weights."""
    model = model_of(*changes)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for weights in model.policy.parameters():
            weights.copy_(0.2 * torch.randn(weights.shape, generator=generator))
    return read_bundle(save_policy(model, folder))


def stopping_at(steps):
    """Return a run's method that stops it, as a signal does, once it has taken so many steps."""
    original = Run._on_rollout_end

    def stop(self):
        original(self)
        self.stopping |= self.num_timesteps >= steps

    return stop


def actions_of(layers, policy, model, steps=40):
    """Return what a network does, step by step, in a model's environment."""
    env = model.get_env().unwrapped.venv
    actor, actions = Actor(layers, policy, env), []
    observations, _ = env.reset(seed=3)
    for _ in range(steps):
        actions.append(actor(observations))
        observations, *_ = env.step(actions[-1])
    return np.array(actions)


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ([], []),
        ([], ["env.privileged=true"]),
        (["env.privileged=true"], ["env.privileged=true"]),
        (["env.history=3"], ["env.history=3", "env.privileged=true"]),
        (["network.features=false"], ["network.features=false", "env.privileged=true"]),
        (["network.standard_inputs=false"], ["ppo.privileged_critic=false"]),
        ([], ["network.standard_inputs=false"]),
    ],
)
def test_it_acts_as_the_bundle_does(given, asked, tmp_path):
    bundle = bundle_of(tmp_path / "bundle", *given)
    model = model_of(*asked, f"network.start={tmp_path / 'bundle'}")
    layers, policy = describe_policy(model)
    expected = actions_of(bundle.layers, bundle.policy, model)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(actions_of(layers, policy, model), expected, rtol=0, atol=1e-4)


def test_the_causal_reference_starts_as_the_shipped_policy():
    config = load_train_config(CAUSAL, ["num_envs=4", "ppo.batch_size=128", "env.max_episode_steps=30"])
    layers, policy = describe_policy(make_model(config))
    assert policy.is_privileged and config.network.start == "pretrained:testbed"
    weight, known = layers[0][0], len(OBSERVATIONS) + len(FEATURES)
    shipped = read_bundle(bundle_folder("pretrained:testbed")).layers[0][0]
    np.testing.assert_allclose(weight[:, :known], shipped, rtol=1e-5, atol=1e-6)
    assert weight.shape[1] > known and not weight[:, known:].any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["network.hidden=[16, 16]"], r"hidden layers \[16, 16\]; this recipe's has \[16, 8\]"),
        (["network.activation=tanh"], "the activation tanh; this recipe's has relu"),
        (["network.features=false"], "features False; this recipe's has True"),
        (["env.history=2"], "history 2; this recipe's has 1"),
        (["env.privileged=true"], r"observations of the hidden state \(privileged\) True; this recipe's has False"),
        (["env.tension_range=[5.0, 9.0]", "network.initial_tension=6"], r"tension_range \[5.0, 9.0\]"),
        (["env.agent_period=0.05"], "agent_period 0.05; this recipe's has 0.02"),
        (["env.follow_time=0"], "agent_period / follow_time 1.0; this recipe's has 0.4"),
    ],
)
def test_what_means_something_else_is_refused(given, message, tmp_path):
    bundle_of(tmp_path / "bundle", *given)
    with pytest.raises(AmulettError, match=rf"network\.start: the policy of '.*bundle' has .*{message}"):
        model_of(f"network.start={tmp_path / 'bundle'}")


def test_what_is_no_bundle_is_refused(tmp_path):
    for wrong in ("pretraind", "eq6", str(tmp_path)):
        with pytest.raises(
            AmulettError, match=rf"network\.start is '{wrong}'; it has to be pretrained, pretrained:tension"
        ):
            model_of(f"network.start={wrong}")
    with pytest.raises(AmulettError, match="only PPO can start from a bundle"):
        model_of("algorithm=sac", "network.start=pretrained")


def test_a_critic_that_learns_alone_to_the_end_is_refused():
    with pytest.raises(AmulettError, match=r"ppo\.critic_steps is 449; it can be at most 448, where the last rollout"):
        model_of("ppo.critic_steps=449", "total_steps=500")
    model_of("ppo.critic_steps=448", "total_steps=500")
    with pytest.raises(AmulettError, match=r"ppo\.final_std is null"):
        model_of("ppo.critic_steps=500", "ppo.final_std=null")


def test_a_run_is_resumed_without_the_bundle_that_it_began_as(tmp_path):
    bundle_of(tmp_path / "bundle")
    recipe = [*SMALL, "total_steps=640", "validation.episodes=2", "checkpoint_seconds=0"]
    recipe += [f"network.start={tmp_path / 'bundle'}", "ppo.critic_steps=100"]
    config, weights = load_train_config(None, recipe), {}
    for name, limit in (("whole", None), ("stopped", 256)):
        run = tmp_path / name
        with pytest.MonkeyPatch.context() as patch:
            if limit is not None:
                patch.setattr(Run, "_on_rollout_end", stopping_at(limit))
            train(config, run, progress=False)
        if limit is not None:
            shutil.rmtree(tmp_path / "bundle")
            resume(run, progress=False)
        weights[name] = [array for layer in read_bundle(run / "last").layers for array in layer]
    assert all(np.array_equal(one, other) for one, other in zip(*weights.values(), strict=True))
    # And it is done again from the bundle that is kept with it.
    assert main(["rerun", str(tmp_path / "whole"), "--out", str(tmp_path / "again")]) == 0
    train(load_train_config(tmp_path / "again" / "config.yaml"), tmp_path / "whole", progress=False, overwrite=True)


def test_the_critic_learns_first(tmp_path):
    bundle_of(tmp_path / "bundle")
    config = load_train_config(
        None, [*SMALL, f"network.start={tmp_path / 'bundle'}", "ppo.critic_steps=128", "ppo.anneal=false"]
    )
    model = make_model(config)

    def learned(steps):
        before = {name: value.clone() for name, value in model.policy.state_dict().items()}
        model.learn(steps, callbacks(config), reset_num_timesteps=False)
        after = model.policy.state_dict()
        return {name for name, value in before.items() if not torch.equal(value, after[name])}

    critic = {name for name in model.policy.state_dict() if "value_net" in name}
    policy = {name for name in model.policy.state_dict() if "policy_net" in name or "action_net" in name}
    assert learned(128) - {"log_std"} == critic
    assert learned(64) >= critic | policy
    start_from(model, read_bundle(tmp_path / "bundle"))  # and may start again
    assert learned(64) >= critic | policy


def adapted(start, *changes):
    """Return the recipe that adapts a policy, made small."""
    return load_train_config(None, [*SHORT, *changes], start=str(start))


SHORT = ["num_envs=4", "total_steps=256", "max_seconds=null", "ppo.n_steps=16", "ppo.batch_size=32"]
SHORT += ["ppo.critic_steps=64", "validation.episodes=4", "validation.every_steps=64", "checkpoint_seconds=0"]
OTHER_DEVICE = "env.profile={name: heavy, base: testbed, plant: {masses: [{mass: 0.4, arm: 0.13}]}}"


def test_a_policy_is_adapted_by_a_recipe_of_its_own_kind(tmp_path):
    kind = ["network.memory=true", "network.features=false", "network.activation=tanh", "env.history=2"]
    kind += ["env.tension_range=[5.2, 9.0]", "env.agent_period=0.05", "env.follow_time=0.1", "env.suite=reach"]
    start = bundle_of(tmp_path / "start", *kind, "env.fleet=[testbed, simulation]")
    config = adapted(start.folder, OTHER_DEVICE)
    env, network = config.env, config.network
    assert [device.name for device in env.devices] == ["heavy"]
    assert (env.tension_range, env.history, env.suite, env.max_episode_steps) == ([5.2, 9.0], 2, "reach", 30)
    assert (network.hidden, network.activation, network.features, network.memory) == ([16, 8], "tanh", False, True)
    assert (env.agent_period, env.share) == (0.05, pytest.approx(0.5))
    model = make_model(config)
    layers, policy = describe_policy(model)
    assert policy == start.policy
    np.testing.assert_allclose(layers[1][0], start.layers[1][0], rtol=0, atol=1e-6)
    there = load_train_config(None, [], start=str(start.folder))
    assert [device.name for device in there.env.devices] == ["testbed", "simulation"]
    assert (there.max_seconds, there.network.initial_tension) == (60.0, 7.0)
    with pytest.raises(AmulettError, match="policy 'runs/none' to start from"):
        load_train_config(None, [], start="runs/none")


def test_the_policy_to_start_from_stays_where_none_is_better(tmp_path, monkeypatch, capsys):
    start = bundle_of(tmp_path / "start")
    costs = iter([1.0, 1.0, 1.2, 1.1, 1.3])  # the second while only the critic learns
    rated = run.evaluate
    monkeypatch.setattr(run, "evaluate", lambda *them: {**rated(*them), "cost": next(costs)})
    out = tmp_path / "run"
    assert main(["train", "--start", str(start.folder), "--out", str(out), "--set", *SHORT, OTHER_DEVICE]) == 0
    assert "none of those trained is better" in capsys.readouterr().out
    best, last = (read_bundle(out / name).layers for name in ("best", "last"))
    assert not np.allclose(best[0][0], last[0][0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(best[0][0], start.layers[0][0], rtol=0, atol=1e-5)
    assert main(["train", "--start", "pretrained", "--config", str(CAUSAL), "--out", str(out)]) == 2
    assert "--start has its own recipe" in capsys.readouterr().err


def critic_of(model, observations):
    """Return the values of observations by a model's critic."""
    with torch.no_grad():
        return model.policy.predict_values(torch.as_tensor(observations)).numpy().ravel()


def same_critic(one, other):
    critics = (model.policy.mlp_extractor.value_net.parameters() for model in (one, other))
    return all(torch.equal(*pair) for pair in zip(*critics, strict=True))


def seen_by(model):
    """Return observations of a model's networks."""
    model.get_env().seed(5)
    observations = [model.get_env().reset()]
    for _ in range(20):
        observations.append(model.get_env().step(np.zeros((4, 1), dtype=np.float32))[0])
    return np.concatenate(observations)


@pytest.mark.parametrize(
    "kind",
    [
        [],
        ["ppo.privileged_critic=false", "network.critic_hidden=[12]"],
        ["env.privileged=true"],
        ["env.history=2", "network.memory=true", "network.activation=tanh"],
        ["env.fleet=[testbed, simulation]"],
    ],
)
def test_the_critic_of_a_bundle_starts_too(kind, tmp_path):
    trained = model_of(*kind)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weights in trained.policy.parameters():
            weights.copy_(0.2 * torch.randn(weights.shape, generator=generator))
    save_policy(trained, tmp_path / "bundle")
    model, shown = model_of(*kind, f"network.start={tmp_path / 'bundle'}"), seen_by(trained)
    expected = critic_of(trained, shown)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(critic_of(model, shown), expected, rtol=0, atol=1e-4)
    plain = model_of(*kind, f"network.start={tmp_path / 'bundle'}", "network.standard_inputs=false")
    np.testing.assert_allclose(critic_of(plain, shown), expected, rtol=0, atol=1e-4)


def test_on_one_device_the_critic_of_a_fleet_knows_that_device(tmp_path):
    bundle_of(tmp_path / "bundle", "env.fleet=[testbed, simulation]")
    start = f"network.start={tmp_path / 'bundle'}"
    values = {}
    for device in ("testbed", "simulation"):
        fleet = model_of(f"env.fleet=[{device}]", start)
        shown = seen_by(fleet)
        one = model_of(f"env.profile={device}", start)
        entries = one.observation_space.shape[0]
        assert entries < shown.shape[1]
        values[device] = critic_of(one, shown[:, :entries])
        np.testing.assert_allclose(values[device], critic_of(fleet, shown), rtol=0, atol=1e-4)
    assert not np.allclose(values["testbed"][:4], values["simulation"][:4], atol=1e-2)
    # A critic that did not know devices pays no attention to them at first.
    bundle_of(tmp_path / "other", "env.profile=simulation")
    fleet = model_of("env.fleet=[testbed, simulation]", f"network.start={tmp_path / 'other'}")
    first = fleet.policy.mlp_extractor.value_net[0].weight.detach().numpy()
    assert first[:, :entries].all() and not first[:, entries:].any()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["ppo.privileged_critic=false"], "inputs that this one does not have: .'spring_biceps_factor'"),
        (["network.critic_hidden=[16]"], r"hidden layers: \[128, 128\]; this recipe's has \[16\]"),
        (["ppo.gamma=0.9"], "ppo.gamma: 0.99; this recipe's has 0.9"),
        (["ppo.reward_scale=1.0"], "ppo.reward_scale: 10.0; this recipe's has 1.0"),
    ],
)
def test_another_kind_of_critic_is_new_and_the_user_is_told(asked, message, tmp_path):
    bundle_of(tmp_path / "bundle")
    with pytest.warns(UserWarning, match=f"critic of '.*bundle' has {message}.* A new critic learns instead"):
        model = model_of(*asked, f"network.start={tmp_path / 'bundle'}")
    assert same_critic(model, model_of(*asked))


def test_with_a_critic_it_learns_alone_for_a_shorter_time(tmp_path):
    kind = ["network.critic_hidden=[12, 6]", "ppo.gamma=0.98", "ppo.privileged_critic=false", "ppo.reward_scale=5"]
    start = bundle_of(tmp_path / "start", *kind).folder
    config = load_train_config(None, [], start=str(start))
    assert (config.network.critic_hidden, config.ppo.privileged_critic) == ([12, 6], False)
    assert (config.ppo.gamma, config.ppo.reward_scale, config.ppo.critic_steps) == (0.98, 5.0, CRITIC_STEPS)
    # Alone in the first rollout only; each rollout is used once.
    assert (config.num_envs * config.ppo.n_steps, config.ppo.n_epochs) == (CRITIC_STEPS, 1)
    own = load_train_config(None, ["ppo.gamma=0.98", "ppo.critic_steps=1000"], start=str(start))
    assert own.ppo.critic_steps == 1000
    long = ADAPTATION["ppo"]["critic_steps"]
    assert load_train_config(None, ["ppo.gamma=0.99"], start=str(start)).ppo.critic_steps == long > CRITIC_STEPS
    without_critic(start)
    config = load_train_config(None, [], start=str(start))
    assert (config.network.critic_hidden, config.ppo.gamma, config.ppo.critic_steps) == ([128, 128], 0.99, long)


def without_critic(folder):
    """Write a bundle anew, as earlier versions did."""
    found = read_bundle(folder)
    write_bundle(folder, found.layers, found.policy, found.env, found.provenance, found.card)


def test_a_bundle_without_a_critic_starts_as_before(tmp_path, recwarn):
    bundle_of(tmp_path / "bundle")
    without_critic(tmp_path / "bundle")
    model = model_of(f"network.start={tmp_path / 'bundle'}")
    assert same_critic(model, model_of())
    assert not recwarn.list


def test_the_best_policy_has_the_critic_of_its_time(tmp_path, monkeypatch):
    costs, critics = iter([3.0, 1.0, 2.0, 2.0, 2.0]), []
    rated = run.evaluate

    def rate(model, *them):
        critics.append(model.policy.value_net.weight.detach().numpy().copy())
        return {**rated(model, *them), "cost": next(costs)}

    monkeypatch.setattr(run, "evaluate", rate)
    short = ["total_steps=192", "validation.every_steps=64", "validation.episodes=4"]
    train(load_train_config(None, [*SMALL, *short]), tmp_path, progress=False)
    best, last = (critic_of_bundle(read_bundle(tmp_path / name)).layers[-1][0] for name in ("best", "last"))
    assert np.array_equal(best, critics[1]) and np.array_equal(last, critics[-1]) and not np.array_equal(best, last)
