"""`amulett config validate`: says what a file is and what it comes to, or which key is wrong and what it may be."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from annotated_types import Ge, Gt, Le, Lt
from helpers import make_bundle
from pydantic import BaseModel

from amulett_agents.config import TrainConfig, load_train_config
from amulett_gym.cli import main
from amulett_gym.cli.config import show, validate
from amulett_gym.profile import Profile, load_profile
from amulett_gym.storage import reading
from amulett_gym.storage.safe_yaml import parse_yaml, to_yaml
from amulett_gym.studies.benchmark.description import Benchmark, Learned
from amulett_gym.studies.benchmark.devices.description import DevicesBenchmark
from amulett_gym.tasks.scenario import Scenario

CONFIGS = Path(__file__).parents[2] / "configs"
ALL = sorted(path for kind in ("yaml", "yml", "json") for path in CONFIGS.rglob(f"*.{kind}"))
ZOO = sorted(CONFIGS.glob("zoo/*.yml"))


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_what_we_ship_is_valid(path, capsys):
    assert main(["config", "validate", str(path)]) == 0
    assert f"{path}: valid, " in capsys.readouterr().out


@pytest.mark.parametrize("path", ZOO, ids=lambda path: path.name)
def test_rl_zoo3_reads_the_same_numbers(path):
    text = path.read_text()
    assert yaml.safe_load(text) == parse_yaml(text, path.name)  # it reads YAML 1.1, in which 1e-3 is text


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("mine.yaml", "{name: mine, base: testbed}", "a device profile"),
        ("mine.yaml", "{ppo: {gamma: 0.98}}", "a training recipe"),
        ("mine.yaml", "{headline: steps, suites: [steps]}", "a benchmark's description"),
        ("mine.yaml", "{held_out: 16, cables: []}", "a study of wearers"),
        (
            "mine.yml",
            "{default: {policy: MlpPolicy, n_timesteps: 1}, Amulett/Tension-v0: {policy: MlpPolicy, n_timesteps: 1}}",
            "hyper-parameters of rl_zoo3 for 2 environments",
        ),
        ("mine.json", '{"moves": []}', "a scenario"),
        ("mine.json", '{"total_steps": 256}', "a training recipe"),
        ("mine.json", '{"name": "mine", "base": "testbed"}', "a device profile"),
    ],
)
def test_a_kind_is_told_by_its_keys(name, text, kind, tmp_path):
    (tmp_path / name).write_text(text)
    if kind == "a benchmark's description":
        text = "{headline: steps, suites: [steps], clairvoyant: {scenarios: {}}}"
        (tmp_path / name).write_text(text)
    assert validate(tmp_path / name).kind == kind


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_a_file_is_read_once(path, monkeypatch):
    read, done = reading.read_bytes, []

    def counted(place, *given, **more):
        done.append(Path(place))
        return read(place, *given, **more)

    monkeypatch.setattr(reading, "read_bytes", counted)
    validate(path)
    assert done.count(path) == 1


def test_a_json_file_is_read_alike_by_all(tmp_path):
    (tmp_path / "mine.json").write_text('{\n\t"name": "mine",\n\t"base": "testbed"\n}')  # YAML knows no tabs
    assert validate(tmp_path / "mine.json").content == load_profile(tmp_path / "mine.json")


RUN = ["total_steps=64", "num_envs=4", "ppo.n_steps=16", "ppo.batch_size=64", "ppo.n_epochs=1", "network.hidden=[4]"]


def test_the_folder_of_a_training_run_is_valid_with_its_recipe_and_best_bundle(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "run"
    run.mkdir()
    config = load_train_config(None, [*RUN, "network.start=gone"])
    (run / "config.yaml").write_text(to_yaml(config.model_dump()))

    def validated(code):
        assert main(["config", "validate", "run"]) == code
        return "".join(capsys.readouterr())

    assert "unknown policy 'gone'" in validated(2)
    make_bundle(run / "start")
    assert "run: valid, a training run without a policy yet (run)" in validated(0)
    make_bundle(run / "best")
    assert "run: valid, a training run with its best policy (run)" in validated(0)
    assert validate(run).content == config
    monkeypatch.chdir(run / "best")
    assert validate(".")[:2] == ("a policy bundle", "best")
    monkeypatch.chdir(tmp_path)
    (run / "start" / "env.json").open("a").write(" ")
    assert "start/env.json' was changed or damaged" in validated(2)
    (run / "start" / "env.json").write_text((run / "start" / "env.json").read_text()[:-1])
    (run / "best" / "env.json").unlink()
    assert "best/env.json'" in validated(2)
    (run / "config.yaml").write_text("{ppo: {gama: 0.9}}")
    assert "unknown key 'ppo.gama'; did you mean 'gamma'" in validated(2)
    (run / "config.yaml").unlink()
    assert "'run' holds neither a policy bundle (manifest.json) nor a training run" in validated(2)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("mine.yaml", "{name: mine, base: testbed, plnt: {}}", "unknown key 'plnt'; did you mean 'plant'"),
        ("mine.yaml", "{ppo: {gama: 0.9}}", "unknown key 'ppo.gama'; did you mean 'gamma'"),
        ("mine.json", '{"move": []}', "unknown key 'move'; did you mean 'moves'"),
        ("mine.yml", "{Amulett/Tensio-v0: {policy: MlpPolicy}}", r"/mine\.yml': unknown .* mean 'Amulett/Tension-v0'"),
        (
            "mine.yml",
            "{Amulett/Tension-v0: {policy: MlpPolicy, n_timestep: 1000}}",
            r"'Amulett/Tension-v0' in '.*/mine\.yml': unknown key 'n_timestep'; did you mean 'n_timesteps'\?",
        ),
        ("mine.yml", "{Amulett/Tension-v0: {policy: A, n_timesteps: 1, N_env: 4}}", "'N_env'; did you mean 'n_envs'"),
        ("mine.yml", "{Amulett/Tension-v0: {policy: MlpPolicy}}", "n_timesteps"),
        ("mine.yml", "{Amulett/Tension-v0: {policy: MlpPolicy, n_timesteps: 0}}", "'n_timesteps' is 0"),
        (
            "mine.yml",
            "{Amulett/Tension-v0: {policy: A, n_timesteps: 1, env_kwargs: {suit: mixed}}}",
            "env_kwargs got an unexpected keyword argument 'suit'; did you mean 'suite'",
        ),
        ("mine.yml", "{Amulett/Tension-v0: ppo}", "has to be a mapping of hyper-parameters, not 'ppo'"),
        ("mine.yaml", "{colour: red}", "has no key of any kind of file"),
        ("mine.txt", "", "is neither .yaml"),
        (
            "mine.json",
            '{"moves": [{"time": -1, "angle_deg": 5}]}',
            "'moves.0.time' is -1: .*greater than or equal to 0",
        ),
    ],
)
def test_what_is_wrong_is_named(name, text, message, tmp_path, capsys):
    (tmp_path / name).write_text(text)
    assert main(["config", "validate", str(tmp_path / name)]) == 2
    assert re.search(message, capsys.readouterr().err)


CURVE = "{name: mine, base: testbed, spring: {measured_curve: curve.csv}}"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("mine.yaml", CURVE, r"cannot read measured spring curve '.*curve\.csv'"),
        ("mine.yaml", "{env: {profile: none.yaml}}", r"cannot read profile 'none\.yaml'"),
        ("mine.yaml", "{env: {profile: {base: testbed, drive: {}}}}", "unknown key 'drive'; did you mean 'drives'"),
        ("mine.yaml", "{network: {start: none/best}}", "there is no policy bundle 'none/best'"),
        ("mine.yaml", "{headline: steps, profile: none.yaml}", r"cannot read profile 'none\.yaml'"),
        (
            "mine.yaml",
            "{suites: [mixed], clairvoyant: {scenarios: {}}, learned: {ppo: {recipe: pppo.yaml, seeds: [0]}}}",
            "did you mean 'ppo.yaml'",
        ),
        ("mine.yaml", "{suites: [mixed], clairvoyant: {scenarios: {}, starts: [eq6]}}", "acts inside the loop"),
    ],
)
def test_what_a_command_would_refuse_is_not_valid(name, text, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text)
    assert main(["config", "validate", name]) == 2
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(
    "name", ["configs/ppo.yaml", "ppo.yaml", "ppo", "tune", "configs/scenario.json", "identified/testbed"]
)
def test_packaged_files_are_found_from_any_folder(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["config", "validate", name]) == 0
    assert f"{name}: valid, " in capsys.readouterr().out


def test_a_home_folder_is_expanded_in_all_words(tmp_path, capsys, monkeypatch):
    home, here = tmp_path / "home", tmp_path / "here"
    for folder in (home, here):
        folder.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    (home / "mine.yaml").write_text("{name: mine, base: testbed}")
    assert main(["config", "validate", "~/mine.yaml"]) == 0
    words = ["simulate", "--profile=~/mine.yaml", "--duration", "0.1", "--out=~/x.csv", "--plot", "~/new/x.png"]
    assert main(words) == 0
    assert {path.name for path in home.glob("[!.]*")} == {"mine.yaml", "x.csv", "new"}
    assert not list(here.iterdir())


def test_what_is_shown_is_the_file_in_full_with_units(tmp_path, capsys):
    (tmp_path / "mine.yaml").write_text("{name: mine, base: testbed, sensors: {potentiometer_noise: 0.00002}}")
    expected = load_profile(tmp_path / "mine.yaml")
    assert main(["config", "validate", "--show", str(tmp_path / "mine.yaml")]) == 0
    text = capsys.readouterr().out
    assert "standard deviation [m]" in text
    assert load_profile(parse_yaml(text, "shown")) == expected
    assert main(["config", "validate", "--json", str(tmp_path / "mine.yaml")]) == 0
    assert load_profile(json.loads(capsys.readouterr().out)["content"]) == expected


def test_a_recipe_is_shown_in_full(tmp_path):
    config = TrainConfig()
    assert TrainConfig.model_validate(parse_yaml("\n".join(show(config)), "shown")) == config


def fields(model: type[BaseModel], path: str = ""):
    from amulett_gym.settings import _group_in

    for name, field in model.model_fields.items():
        group = _group_in(field.annotation)
        if group is not None:
            yield from fields(group, f"{path}{name}.")
        elif name not in ("sources", "version"):
            yield f"{path}{name}", field


ALL_FIELDS = [
    pytest.param(field, id=f"{model.__name__}.{name}")
    for model in (Profile, TrainConfig, Scenario, Benchmark, Learned, DevicesBenchmark)
    for name, field in fields(model)
]


@pytest.mark.parametrize("field", ALL_FIELDS)
def test_every_field_says_what_it_means_and_every_number_its_range_and_unit(field):
    assert field.description
    if field.annotation in (float, int, float | None, int | None):
        kinds = {type(item) for item in field.metadata}
        assert kinds & {Ge, Gt}, "no lower bound"
        assert kinds & {Le, Lt}, "no upper bound"
        assert re.search(r"\[[^\]]+\]", field.description), "no unit"
