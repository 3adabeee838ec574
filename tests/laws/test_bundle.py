"""Policy bundles: data that is verified before it is used, written whole or not at all."""

import itertools
import json
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import safetensors.numpy

import amulett_gym
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.laws import bundle as bundles
from amulett_gym.laws.bundle import (
    CARD,
    CRITIC,
    FILES,
    MANIFEST,
    Manifest,
    Network,
    PolicyDescription,
    TrainingEnv,
    read_bundle,
    write_bundle,
)
from amulett_gym.laws.card import rewrite_card
from amulett_gym.laws.contenders import parse_contender
from amulett_gym.storage.writing import write_json

SCALING, TENSION = amulett_gym.ENV_IDS[:2]
ENV = TrainingEnv(id=SCALING, keywords={"suite": "steps"}, max_episode_steps=500)


def describe(hidden=(8,), activation="tanh", output="clip", tension_range=(4.0, 15.0), **changes) -> PolicyDescription:
    content = {
        "network": Network(layers=[13, *hidden, 1], activation=activation, output=output),
        "observations": list(OBSERVATIONS),
        "observation_scales": dict(OBSERVATION_SCALES),
        "tension_range": list(tension_range),
        "agent_period": 0.02,
    }
    return PolicyDescription.model_validate(content | changes)


def random_layers(sizes, seed=0):
    generator = np.random.default_rng(seed)
    return [
        (
            generator.normal(0, inputs**-0.5, (outputs, inputs)).astype(np.float32),
            generator.normal(0, 0.1, outputs).astype(np.float32),
        )
        for inputs, outputs in itertools.pairwise(sizes)
    ]


def make_bundle(folder: Path, seed=0, hidden=(8,), **changes) -> Path:
    return write_bundle(folder, random_layers((13, *hidden, 1), seed), describe(hidden, **changes), ENV, {"seed": seed})


def vouch_for(folder: Path) -> None:
    """Write a manifest for what the folder holds now, as an attacker could."""
    names = [path.name for path in folder.iterdir() if path.name != MANIFEST]
    manifest = Manifest(sha256={name: bundles._digest((folder / name).read_bytes()) for name in names})
    write_json(folder / MANIFEST, manifest.model_dump())


def edit_json(path: Path, **changes) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.fixture
def folder(tmp_path):
    return make_bundle(tmp_path / "bundle")


def test_what_is_written_is_read(folder):
    bundle = read_bundle(folder)
    assert bundle.policy == describe()
    assert bundle.env == ENV
    assert bundle.provenance == {"seed": 0}
    for written, read in zip(random_layers((13, 8, 1)), bundle.layers, strict=True):
        assert np.array_equal(written[0], read[0])
        assert np.array_equal(written[1], read[1])
    assert {path.name for path in folder.iterdir()} == {*FILES, MANIFEST}


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_numpy_gives_what_torch_gives(activation, output):
    torch = pytest.importorskip("torch")
    layers = random_layers((13, 64, 64, 1))
    observations = np.random.default_rng(1).uniform(-1, 1, (500, 13)).astype(np.float32)
    network = Network(layers=[13, 64, 64, 1], activation=activation, output=output)
    values = torch.from_numpy(observations)
    for k, (weight, bias) in enumerate(layers):
        values = torch.nn.functional.linear(values, torch.from_numpy(weight), torch.from_numpy(bias))
        if k < len(layers) - 1:
            values = getattr(torch, activation)(values)
    expected = values.tanh() if output == "tanh" else values.clip(-1, 1)
    actions = bundles.forward(layers, network, observations)
    assert (np.abs(actions) < 1).mean() > 0.05
    np.testing.assert_allclose(actions, expected.numpy(), rtol=0, atol=1e-6)


def test_one_observation_gives_what_it_gives_in_a_batch(folder):
    env = gym.make_vec(SCALING, num_envs=50)
    policy = amulett_gym.load_policy(folder, env)
    observations, _ = env.reset(seed=0)
    batch = policy(observations)
    assert np.array_equal(batch, np.array([policy(observation) for observation in observations]))
    assert env.action_space.contains(batch)


def test_a_flipped_bit_in_any_byte_of_any_file_is_noticed(folder):
    for name in (*FILES, MANIFEST):
        content = (folder / name).read_bytes()
        for position in range(len(content)):
            changed = bytearray(content)
            changed[position] ^= 1 << position % 8
            (folder / name).write_bytes(changed)
            with pytest.raises(AmulettError, match=None if name == MANIFEST else name):
                read_bundle(folder)
        (folder / name).write_bytes(content)
    read_bundle(folder)


def test_a_model_card_is_part_of_the_bundle_and_old_bundles_have_none(folder):
    assert read_bundle(folder).card is None
    content = random_layers((13, 8, 1)), describe(), ENV, {"seed": 0}
    write_bundle(folder, *content, "# Card\n")
    assert read_bundle(folder).card == "# Card\n"
    (folder / CARD).write_text("# Cart\n")
    with pytest.raises(AmulettError, match=f"{CARD}' was changed or damaged"):
        read_bundle(folder)
    vouch_for(folder)
    assert read_bundle(folder).card == "# Cart\n"
    (folder / CARD).unlink()
    with pytest.raises(AmulettError, match=f"{CARD}.*No such file"):
        read_bundle(folder)
    with pytest.raises(AmulettError, match=f"{CARD}' holds characters that cannot be printed"):
        write_bundle(folder, *content, "# \x1b[2J\n")


def test_a_critic_is_part_of_the_bundle_and_only_a_training_reads_it(folder):
    plain = (folder / MANIFEST).read_bytes()
    assert read_bundle(folder).critic is None
    content = random_layers((13, 8, 1)), describe(), ENV, {"seed": 0}
    write_bundle(folder, *content, critic=b"arrays")
    found = read_bundle(folder)
    assert found.critic == b"arrays" and found.card is None
    assert read_bundle(rewrite_card(folder, ["It fears pushes."])).critic == b"arrays"
    (folder / CRITIC).write_bytes(b"others")
    with pytest.raises(AmulettError, match=f"{CRITIC}' was changed or damaged"):
        read_bundle(folder)
    (folder / CRITIC).unlink()
    with pytest.raises(AmulettError, match=f"{CRITIC}.*No such file"):
        read_bundle(folder)
    write_bundle(folder, *content)
    assert (folder / MANIFEST).read_bytes() == plain
    (folder / CRITIC).write_bytes(b"arrays")
    with pytest.raises(AmulettError, match=f"{CRITIC}' is not listed"):
        read_bundle(folder)
    (folder / CRITIC).write_bytes(bytes(bundles.MAX_BYTES + 1))
    vouch_for(folder)
    with pytest.raises(AmulettError, match=f"{CRITIC}' has .* bytes; at most"):
        read_bundle(folder)


def test_a_space_that_became_a_tab_in_the_manifest_is_noticed(folder):
    content = (folder / MANIFEST).read_text()
    (folder / MANIFEST).write_text(content.replace("  ", " \t", 1))
    with pytest.raises(AmulettError, match=f"{MANIFEST}.*was changed or damaged"):
        read_bundle(folder)


@pytest.mark.parametrize("name", [*FILES, MANIFEST])
def test_a_truncated_missing_or_oversized_file_is_named(folder, name, monkeypatch):
    content = (folder / name).read_bytes()
    for shorter in (content[:-2], content[: len(content) // 2], b""):
        (folder / name).write_bytes(shorter)
        with pytest.raises(AmulettError, match=name):
            read_bundle(folder)
    (folder / name).unlink()
    with pytest.raises(AmulettError, match=f"{name}.*No such file"):
        read_bundle(folder)
    (folder / name).write_bytes(content)
    monkeypatch.setattr(bundles, "MAX_BYTES", len(content) - 1)
    with pytest.raises(AmulettError, match=r"at most \d+ are allowed"):
        read_bundle(folder)


def test_an_extra_file_is_named(folder):
    (folder / "payload.pkl").write_bytes(pickle.dumps("surprise"))
    with pytest.raises(AmulettError, match=r"payload\.pkl.*not listed"):
        read_bundle(folder)


def test_hidden_files_are_no_content(folder, tmp_path):
    for name in (".DS_Store", "._manifest.json", ".git/config"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"\0\1")
    expected = read_bundle(folder)
    new = tmp_path / "new"
    new.mkdir()
    (new / ".DS_Store").write_bytes(b"\0")
    write_bundle(new, expected.layers, expected.policy, expected.env, expected.provenance)
    assert read_bundle(new).policy == expected.policy


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "a/b", "..", ".", "", ".hidden", MANIFEST, "a\n"])
def test_a_manifest_cannot_reach_outside_its_folder(folder, name):
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["sha256"][name] = "0" * 64
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(AmulettError, match="lists .*; a bundle holds"):
        read_bundle(folder)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(folder, wrong):
    tensors = safetensors.numpy.load_file(folder / "weights.safetensors")
    tensors["layer_1.bias"] = np.array([wrong], dtype=np.float32)
    (folder / "weights.safetensors").write_bytes(safetensors.numpy.save(tensors))
    vouch_for(folder)
    with pytest.raises(AmulettError, match=r"weights\.safetensors.*layer_1\.bias.*not finite"):
        read_bundle(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layer_0.weight": np.zeros((8, 12), np.float32)}, r"layer_0\.weight.*shape \(8, 13\)"),
        ({"layer_0.weight": np.zeros((8, 13), np.float64)}, "float32"),
        ({"layer_2.bias": np.zeros(1, np.float32)}, r"layer_2\.bias missing or unexpected"),
    ],
)
def test_weights_that_do_not_fit_the_network_are_refused(folder, changes, message):
    tensors = safetensors.numpy.load_file(folder / "weights.safetensors") | changes
    (folder / "weights.safetensors").write_bytes(safetensors.numpy.save(tensors))
    vouch_for(folder)
    with pytest.raises(AmulettError, match=message):
        read_bundle(folder)


def test_a_pickle_in_the_place_of_weights_is_not_opened(folder, tmp_path):
    trap = tmp_path / "trapped"

    class Trap:
        def __reduce__(self):
            return Path.touch, (trap,)

    (folder / "weights.safetensors").write_bytes(pickle.dumps(Trap()))
    vouch_for(folder)
    with pytest.raises(AmulettError, match="not a valid safetensors file"):
        read_bundle(folder)
    assert not trap.exists()


@pytest.mark.parametrize(
    ("file", "changes", "message"),
    [
        ("policy.json", {"version": 2}, "'version' is 2"),
        ("policy.json", {"agent_perod": 0.1}, "did you mean 'agent_period'"),
        ("policy.json", {"observations": list(OBSERVATIONS)[::-1]}, "their order"),
        ("policy.json", {"observation_scales": {**OBSERVATION_SCALES, "position_error": 1.0}}, "position_error"),
        ("policy.json", {"tension_range": [9.0, 4.0]}, "0 <= low < high"),
        ("policy.json", {"network": {"layers": [13, 1], "activation": "gelu", "output": "clip"}}, "activation"),
        ("policy.json", {"network": {"layers": [12, 1], "activation": "tanh", "output": "clip"}}, "13 observations"),
        ("env.json", {"max_episode_steps": 0}, "max_episode_steps"),
        (MANIFEST, {"version": 3}, "'version' is 3"),
        (MANIFEST, {"format": "zip"}, "format"),
    ],
)
def test_a_description_that_cannot_be_used_is_refused(folder, file, changes, message):
    edit_json(folder / file, **changes)
    if file != MANIFEST:
        vouch_for(folder)
    with pytest.raises(AmulettError, match=message) as refused:
        read_bundle(folder)
    assert file in str(refused.value)


@pytest.mark.parametrize("content", [b"[]", b"null", b"{", b"\xff", b"[" * 100_000])
def test_what_is_no_json_object_is_refused(folder, content):
    (folder / "provenance.json").write_bytes(content)
    vouch_for(folder)
    with pytest.raises(AmulettError, match=r"provenance\.json"):
        read_bundle(folder)


def test_no_folder_no_bundle(tmp_path):
    with pytest.raises(AmulettError, match="not a folder"):
        read_bundle(tmp_path / "nowhere")


def test_a_bundle_is_replaced_whole_and_leaves_nothing_behind(folder):
    make_bundle(folder, seed=1)
    assert read_bundle(folder).provenance == {"seed": 1}
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_what_cannot_be_a_bundle_is_not_written_and_the_old_one_stays(folder):
    layers = random_layers((13, 8, 1))
    layers[0][0][0, 0] = np.nan
    with pytest.raises(AmulettError, match="not finite"):
        write_bundle(folder, layers, describe(), ENV, {})
    with pytest.raises(ValueError, match="JSON"):
        write_bundle(folder, random_layers((13, 8, 1)), describe(), ENV, {"score": float("nan")})
    assert read_bundle(folder).provenance == {"seed": 0}
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_write_that_fails_at_the_last_moment_brings_the_old_bundle_back(folder, monkeypatch, error):
    rename = Path.rename

    def fail(path, target):
        if path.name == "new":
            raise error
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises((AmulettError, KeyboardInterrupt)):
        make_bundle(folder, seed=1)
    assert read_bundle(folder).provenance == {"seed": 0}
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_a_folder_of_other_things_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(AmulettError, match="is not a policy bundle and not empty"):
        make_bundle(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_policy_means_the_same_tensions_in_every_tension_range(folder):
    def tensions(env):
        policy = amulett_gym.load_policy(folder, env)
        observation, _ = env.reset(seed=0)
        chosen = []
        for _ in range(100):
            observation, *_, info = env.step(policy(observation))
            chosen.append(info["tension_setpoint"])
        return chosen

    expected = tensions(gym.make(SCALING))
    assert np.ptp(expected) > 0.1
    assert tensions(gym.make(TENSION)) == expected
    np.testing.assert_allclose(tensions(gym.make(TENSION, tension_range=(3.0, 20.0))), expected, atol=1e-3)
    with pytest.raises(AmulettError, match=r"needs 4 to 15 N.*from 5 to 12 N"):
        amulett_gym.load_policy(folder, gym.make(TENSION, tension_range=(5.0, 12.0)))


def test_a_policy_keeps_its_own_agent_period(tmp_path):
    slow = make_bundle(tmp_path / "slow", agent_period=0.1)
    with pytest.raises(AmulettError, match=r"agent_period=0\.1"):
        amulett_gym.load_policy(slow, gym.make(SCALING))
    contender = parse_contender(str(slow))
    assert contender.env_keywords == {"agent_period": 0.1}
    amulett_gym.load_policy(contender.policy_name, gym.make(SCALING, **contender.env_keywords))


def test_a_training_runs_folder_stands_for_its_best_policy(tmp_path):
    make_bundle(tmp_path / "run" / "best")
    assert parse_contender(str(tmp_path / "run")).policy_name == str(tmp_path / "run" / "best")


def test_a_damaged_bundle_is_no_contender(folder):
    shutil.copy(folder / "env.json", folder / "policy.json")
    with pytest.raises(AmulettError, match=r"policy\.json.*changed"):
        parse_contender(str(folder))


def test_a_policy_runs_without_torch(folder):
    program = (
        "import sys, gymnasium, amulett_gym; env = gymnasium.make('Amulett/Scaling-v0');"
        f"env.step(amulett_gym.load_policy({str(folder)!r}, env)(env.reset(seed=0)[0]));"
        "sys.exit(bool({'torch', 'stable_baselines3', 'amulett_agents'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
