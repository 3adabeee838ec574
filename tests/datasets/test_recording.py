"""Data sets in Minari's format: complete or not there, and enough to play every episode again and to learn from it."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from amulett_gym import WORN_ID
from amulett_gym.datasets import files, recording
from amulett_gym.datasets.playing import Random
from amulett_gym.errors import AmulettError
from amulett_gym.laws.contenders import parse_contender

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

from amulett_gym.datasets.files import datasets_folder, open_dataset  # noqa: E402
from amulett_gym.datasets.reading import read_demonstrations  # noqa: E402
from amulett_gym.datasets.recording import record_dataset  # noqa: E402

EQ6, CONSTANT, RANDOM = parse_contender("eq6-held"), parse_contender("constant:8"), Random("random")
FLEET = ["testbed", "simulation"]


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "all"))
    return tmp_path / "all"


def record(*contenders, **options):
    given = {"suite": "mixed", **options.pop("given", {})}
    return record_dataset(contenders or (EQ6,), given=given, **{"duration": 0.5, "episodes": 3, **options})


def content(folder: Path) -> list[str]:
    """Return the files and folders below a folder."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_a_data_set_plays_again_in_the_environment_that_minari_recovers(root):
    found = record(EQ6, RANDOM, given={"fleet": FLEET})
    assert (found.name, found.episodes, found.steps) == ("amulett/scaling/2-devices-mixed-eq6-held-random-v0", 12, 300)
    dataset = minari.load_dataset(found.name)
    assert (
        dataset.total_episodes == 12
        and dataset.total_steps == 300
        and list(minari.list_local_datasets()) == [found.name]
    )
    env, devices, policies = dataset.recover_environment(), [], []
    for episode, about in zip(dataset, dataset.storage.get_episode_metadata(range(12)), strict=True):
        observations, rewards = [env.reset(seed=about["seed"], options=about["options"])[0]], []
        for action in episode.actions:
            observation, reward, terminated, truncated, _ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        np.testing.assert_array_equal(observations, episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        assert (terminated, truncated) == (episode.terminations[-1], episode.truncations[-1]) == (False, True)
        assert about["rewards_sum"] == episode.rewards.sum()
        devices.append(about["options"]["device"])
        policies.append(about["policy"])
        repr(episode)  # Minari's own needs infos
    assert devices == 2 * [*3 * ["testbed"], *3 * ["simulation"]]
    assert policies == [*6 * ["eq6-held"], *6 * ["random"]]


def test_the_metadata_say_who_what_and_with_which_code():
    about = {"author": {"A. Author"}, "author_email": {"a@b.example"}, "description": "Mine."}
    found = record(
        EQ6, CONSTANT, name="mine/several-v3", about=about, origin={"command": ["amulett", "record"]}, seed=7
    )
    dataset = minari.load_dataset("mine/several-v3")
    metadata = dataset.storage.metadata
    assert {key: metadata[key] for key in about} == about
    assert metadata["algorithm_name"] == "eq6-held, constant:8"
    assert "/tree/" in metadata["code_permalink"]
    assert metadata["requirements"][0].startswith("amulett-gym==")
    own = metadata["amulett"]
    assert (
        own["policies"] == ["eq6-held", "constant:8"] and own["seed"] == 7 and own["command"] == ["amulett", "record"]
    )
    assert "numba" in own["versions"]
    assert dataset.recover_environment(eval_env=True).unwrapped.settings.split == "held-out"
    assert found.policies["eq6-held"].mean_return == np.mean([each.rewards.sum() for each in list(dataset)[:3]])


def test_the_default_name_tells_the_device_and_is_one_that_minari_takes():
    own = {"name": "my device", "base": "testbed"}
    assert record(parse_contender("constant:5.5"), given={"profile": own}).name == (
        "amulett/scaling/my_device-mixed-constant_5_5-v0"
    )
    assert record(RANDOM, env_id=WORN_ID, given={"suite": "assembly"}).name == "amulett/worn/assembly-random-v0"


@pytest.mark.parametrize("name", ["plain", "../up-v0", "/abs-v0", "a b-v0", "x-v"])
def test_names_that_minari_would_refuse_are_refused(name, root):
    with pytest.raises(AmulettError, match="is no name of a data set.*mine-v0"):
        record(name=name)
    assert not root.exists()


def test_an_earlier_data_set_is_kept_unless_it_is_to_be_replaced(root):
    found = record(seed=1)
    before = (found.folder / "data" / "metadata.json").read_bytes()
    with pytest.raises(AmulettError, match="already; choose another --name.*--overwrite"):
        record(seed=2)
    assert (found.folder / "data" / "metadata.json").read_bytes() == before
    record(seed=2, overwrite=True)
    dataset = minari.load_dataset(found.name)
    assert [each["seed"] for each in dataset.storage.get_episode_metadata(range(3))] == [2, 3, 4]
    with pytest.raises(AmulettError, match="is a data set, which holds no others"):
        record(name=f"{found.name}/inner-v0")
    with pytest.raises(AmulettError, match="exists and is no data set"):
        (root / "amulett" / "scaling" / "folder-v0").mkdir()
        record(name="amulett/scaling/folder-v0", overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
def test_what_is_interrupted_leaves_nothing_behind(error, overwrite, root, monkeypatch):
    before = []
    if overwrite:
        record()
        before = content(root)
    add = files.DatasetWriter.add

    def fail(writer, episodes):
        add(writer, episodes)
        raise error

    monkeypatch.setattr(files.DatasetWriter, "add", fail)
    wanted = pytest.raises(AmulettError, match="cannot write the data set .*: No space left on device")
    with pytest.raises(KeyboardInterrupt) if isinstance(error, KeyboardInterrupt) else wanted:
        record(overwrite=overwrite)
    assert (content(root) if root.exists() else []) == before


def test_a_full_disk_is_found_before_hdf5_writes(root, monkeypatch):
    tried = []

    def full(folder, size):
        tried.append(size)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "_try_room", full)
    with pytest.raises(AmulettError, match="No space left on device"):
        record(episodes=40, duration=2.0)
    assert content(root) == []
    monkeypatch.undo()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    found = record(episodes=40, duration=2.0)
    assert tried[0] > sum(path.stat().st_size for path in found.folder.rglob("*"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 0}, "episodes is 0; it has to be at least 1"),
        ({"seed": -1}, "seed is -1; it has to be at least 0"),
        ({"seed": 2**63}, "seed is 9223372036854775808; it has to be at most"),
        ({"duration": float("inf")}, "duration is inf s"),
        ({"duration": 0.03}, "no whole number of the 0.02 s steps"),
        ({"given": {"suite": "mixd"}}, "did you mean 'mixed'"),
        ({"given": {"split": "test"}}, "split"),
    ],
)
def test_wrong_values_write_nothing(options, message, root):
    with pytest.raises(AmulettError, match=message):
        record(**options)
    assert not root.exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(AmulettError, match="cannot write the data set '.*file/below/"):
        record(root=tmp_path / "file" / "below")


@pytest.mark.parametrize("by_option", [True, False])
def test_folders_may_be_relative(by_option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "somewhere" if by_option else "data")
    found = record(root="data" if by_option else None)
    assert found.folder == tmp_path / "data" / found.name
    assert read_demonstrations(f"data/{found.name}").name == found.name


def test_data_sets_are_found_by_name_and_by_folder(root, tmp_path):
    found, elsewhere = record(), record(root=tmp_path / "other", name="other/mine-v0")
    assert datasets_folder() == root
    assert open_dataset(found.name).id == open_dataset(str(found.folder)).id == found.name
    assert open_dataset("other/mine-v0", tmp_path / "other").id == elsewhere.name
    with pytest.raises(AmulettError, match=f"there are {found.name}; did you mean '{found.name}'"):
        open_dataset(found.name.replace("mixed", "mxed"))
    with pytest.raises(AmulettError, match="there are none; amulett record writes one"):
        open_dataset("x-v0", tmp_path / "empty")


def test_demonstrations_are_those_of_the_chosen_policy():
    found = record(EQ6, CONSTANT, given={"fleet": FLEET})
    data = read_demonstrations(found.name, "constant:8")
    assert data.policies == {"constant:8": 6} and len(data.actions) == 6
    assert all((actions == data.actions[0][0]).all() for actions in data.actions)
    assert data.observations[0].shape == (25, 13) and data.actions[0].shape == (25, 1)
    assert data.mean_return == pytest.approx(found.policies["constant:8"].mean_return)
    assert data.env.max_episode_steps == 25 and data.env.keywords["fleet"] == FLEET
    with pytest.raises(AmulettError, match="unknown policy .* 'constant:9'; .* did you mean 'constant:8'"):
        read_demonstrations(found.name, "constant:9")


def change(folder: Path, **spec) -> None:
    """Change the environment that a data set names."""
    path = folder / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    described = json.loads(metadata["env_spec"])
    metadata["env_spec"] = json.dumps(
        {**described, **spec, "kwargs": {**described["kwargs"], **spec.get("kwargs", {})}}
    )
    path.write_text(json.dumps(metadata))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"id": "CartPole-v1"}, "names the environment CartPole-v1; it has to be one of Amulett/"),
        ({"kwargs": {"profile": "/etc/passwd"}}, "unknown profile '/etc/passwd'"),
        ({"kwargs": {"suit": "steps"}}, "data set '.*cannot be made: Amulett/Scaling-v0 got an unexpected .* 'suit'"),
        ({"kwargs": {"tension_law": "eq6"}}, "had no effect: its tension_law is 'eq6'"),
        ({"kwargs": {"privileged": True}}, r"observations and actions of the shapes .* has \(26, "),
    ],
)
def test_data_sets_of_others_are_checked(spec, message):
    found = record()
    change(found.folder, **spec)
    with pytest.raises(AmulettError, match=message):
        read_demonstrations(found.name)


def test_an_entry_point_that_a_data_set_names_is_not_imported():
    found = record()
    change(found.folder, entry_point="no_such_module:Env")
    assert read_demonstrations(found.name).env.id == "Amulett/Scaling-v0"


@pytest.mark.parametrize("file", ["metadata.json", "main_data.hdf5"])
def test_a_damaged_data_set_is_named(file):
    found = record()
    (found.folder / "data" / file).write_bytes(b"{}")
    with pytest.raises(AmulettError, match="cannot read the data set"):
        read_demonstrations(found.name)


def put(folder: Path, name: str, values) -> None:
    """Replace an array of a data set's first episode."""
    import h5py

    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        del file["episode_0"][name]
        file["episode_0"][name] = values


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"actions": np.full((25, 1), np.nan)}, "episode 0 .* holds what is no finite number"),
        ({"rewards": np.full(25, np.nan)}, "episode 0 .* holds what is no finite number"),
        ({"actions": np.array([[b"x"]] * 25)}, "episode 0 .* holds what is no finite number"),
        ({"observations": np.zeros((1, 13)), "actions": np.zeros((0, 1)), "rewards": np.zeros(0)}, "at least 1 step"),
    ],
)
def test_arrays_that_nothing_can_learn_from_are_refused(arrays, message):
    found = record()
    for name, values in arrays.items():
        put(found.folder, name, values)
    with pytest.raises(AmulettError, match=message):
        read_demonstrations(found.name)


def test_a_data_set_without_episodes_is_refused():
    found = record()
    path = found.folder / "data" / "metadata.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "total_episodes": 0}))
    with pytest.raises(AmulettError, match="has no episodes"):
        read_demonstrations(found.name)


def test_actions_are_read_as_the_environment_takes_them():
    found = record()
    put(found.folder, "actions", np.full((25, 1), 1e30))
    assert (read_demonstrations(found.name).actions[0] == 1.0).all()


def test_two_policies_of_one_name_are_refused():
    with pytest.raises(AmulettError, match="none twice"):
        record(EQ6, EQ6)
    assert recording.DATA_VERSION == 0


def test_the_example_of_the_documentation_runs():
    page = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text()
    record()
    exec(page.split("```python\n")[1].split("```")[0], {})
