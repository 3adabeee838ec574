"""Settings: numbers are numbers wherever they come from, and what is no number is refused everywhere."""

# ruff: noqa: RUF012
from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import pytest
from pydantic import ValidationError

from amulett_agents.config import TrainConfig, load_train_config
from amulett_gym.errors import AmulettError
from amulett_gym.profile import load_profile
from amulett_gym.settings import Group, configs_folder, describe, find_config, to_plain
from amulett_gym.tasks.scenario import load_scenario


class Part(Group):
    size: float = 1.0


class Every(Group):
    number: float = 0.0
    maybe: float | None = None
    count: int = 0
    counts: list[int] = []
    either: int | float = 0
    whole: int | None = None
    switch: bool = False
    text: str = ""
    pair: tuple[float, float] = (0.0, 1.0)
    table: list[list[float]] = []
    weights: dict[str, float] = {}
    numbers_of: dict[str, int] = {}
    part: Part = Part()
    parts: list[Part] = []
    word: Literal["a", "b"] = "a"
    anything: dict[str, Any] = {}


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("number", 3, 3.0),
        ("number", np.float32(0.5), 0.5),
        ("number", np.float64(0.1), 0.1),
        ("number", np.int64(2), 2.0),
        ("number", np.array(0.25), 0.25),
        ("number", Fraction(1, 2), 0.5),
        ("number", np.longdouble(0.5), 0.5),
        ("maybe", np.float16(0.5), 0.5),
        ("count", 5e6, 5_000_000),
        ("count", np.int64(7), 7),
        ("count", np.float32(8.0), 8),
        ("count", np.array(9, dtype=np.uint8), 9),
        ("whole", 1e3, 1000),
        ("counts", (1, 2.0, np.int32(3)), [1, 2, 3]),
        ("counts", np.array([4.0, 5.0]), [4, 5]),
        ("either", 2.0, 2.0),
        ("either", 2, 2),
        ("switch", np.bool_(True), True),
        ("text", Path("dev") / "dev.yaml", str(Path("dev") / "dev.yaml")),
        ("text", np.str_("x"), "x"),
        ("pair", [1, np.float32(2.0)], (1.0, 2.0)),
        ("pair", np.array([1.0, 2.0]), (1.0, 2.0)),
        ("table", np.eye(2), [[1.0, 0.0], [0.0, 1.0]]),
        ("weights", {"position": np.float32(0.5)}, {"position": 0.5}),
        ("weights", MappingProxyType({"position": 1}), {"position": 1.0}),
        ("numbers_of", {"a": np.float64(2.0)}, {"a": 2}),
        ("part", {"size": np.int16(2)}, Part(size=2.0)),
        ("parts", ({"size": np.float32(1.5)}, Part(size=2.0)), [Part(size=1.5), Part(size=2.0)]),
        ("word", np.str_("b"), "b"),
        ("anything", {"drives": {"lag": np.float64(0.1)}, "n": (1,)}, {"drives": {"lag": 0.1}, "n": [1]}),
    ],
)
def test_numbers_lists_and_paths_of_any_make_are_taken(key, value, expected):
    found = getattr(Every(**{key: value}), key)
    assert found == expected
    assert type(found) is type(expected)
    assert not any(
        isinstance(part, np.generic | np.ndarray) for part in (found if isinstance(found, list) else [found])
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *((key, value) for key in ("number", "count") for value in ("3", "1e3", True, np.bool_(True), None, [1], 1j)),
        *(("number", value) for value in (float("nan"), float("-inf"), np.float32("nan"), np.array(np.inf))),
        *(("count", value) for value in (0.5, np.float32(2.5), float("inf"), float("nan"))),
        *(("switch", value) for value in (1, 0.0, "true", "yes", np.int64(1))),
        *(("text", value) for value in (1, True, None, np.float64(1.0), [Path("a")])),
        *(("counts", value) for value in ("12", np.array(1), np.array([1.5]), {1}, [True])),
        *(("pair", value) for value in ((1.0,), np.ones(3), np.ones((2, 2)))),
        *(("weights", value) for value in ({"a": np.bool_(True)}, {"a": "1"}, {"a": np.nan}, [("a", 1.0)])),
        ("part", {"sise": np.float64(1.0)}),
        ("number", np.datetime64("2024-01-01")),
    ],
)
def test_what_is_no_number_is_refused(key, value):
    with pytest.raises(ValidationError):
        Every(**{key: value})


def test_a_truth_value_says_what_it_may_be():
    with pytest.raises(ValidationError) as caught:
        Every(switch="yes")
    assert "'switch' is 'yes': Input should be a valid boolean: true or false" in str(
        describe(caught.value, Every, "settings")
    )


def test_plain_data_is_left_as_it_is():
    content = {"a": [1, 2.0, None, True, "x"], "b": {"c": 5e6}}
    assert to_plain(content) == content
    assert type(to_plain(content)["b"]["c"]) is float
    marker = object()
    assert to_plain(marker) is marker


def test_numbers_of_torch_are_numbers():
    torch = pytest.importorskip("torch")
    assert Every(number=torch.tensor(0.5), counts=torch.tensor([1, 2])) == Every(number=0.5, counts=[1, 2])


# One number, written in every way, under a key of every kind of file. `True`: it is to be read as that number.

NUMBERS: dict[str, float | None] = {
    "1e-3": 0.001,
    "1.0e-3": 0.001,
    "1E-3": 0.001,
    ".01": 0.01,
    "0": 0.0,
    "5e0": 5.0,
    "0o10": 8.0,
    "1_0.5": 10.5,
    "010": None,
    "1:30": None,
    "yes": None,
    "off": None,
    "true": None,
    "'1e-3'": None,
    ".nan": None,
    ".inf": None,
    "2024-01-01": None,
    "null": None,
}
"""YAML text -> the number that it is; None: no number."""


def of_device(folder: Path, text: str) -> Any:
    (folder / "device.yaml").write_text(f"name: on\nbase: testbed\nsensors: {{force_filter: {text}}}\n")
    profile = load_profile(folder / "device.yaml")
    assert profile.name == "on"  # text, not true
    return profile.sensors.force_filter


def of_recipe(folder: Path, text: str) -> Any:
    (folder / "recipe.yaml").write_text(f"checkpoint_seconds: {text}\n")
    return load_train_config(folder / "recipe.yaml").checkpoint_seconds


def of_override(folder: Path, text: str) -> Any:
    return load_train_config(None, [f"checkpoint_seconds={text}"]).checkpoint_seconds


@pytest.mark.parametrize("read", [of_device, of_recipe, of_override])
@pytest.mark.parametrize("text", NUMBERS)
def test_all_readers_of_yaml_agree_what_a_number_is(read, text, tmp_path):
    expected = NUMBERS[text]
    if expected is None:
        with pytest.raises(AmulettError, match=r"force_filter' is|checkpoint_seconds' is"):
            read(tmp_path, text)
    else:
        assert read(tmp_path, text) == expected


@pytest.mark.parametrize("text", ["5e6", "5_000_000", "5000000", "5.0e+6", "0x4C4B40"])
def test_an_integer_may_be_written_with_an_exponent(text, tmp_path):
    (tmp_path / "recipe.yaml").write_text(f"total_steps: {text}\n")
    config = load_train_config(tmp_path / "recipe.yaml")
    assert config.total_steps == 5_000_000
    assert type(config.total_steps) is int
    assert load_train_config(None, [f"total_steps={text}"]) == config


@pytest.mark.parametrize("name", ["device.yaml", "recipe.yaml", "scenario.json"])
def test_all_readers_take_a_byte_order_mark(name, tmp_path):
    content = {
        "device.yaml": {"name": "mine", "base": "testbed"},
        "recipe.yaml": {"seed": 3},
        "scenario.json": {"measure_from": 1},
    }[name]
    load = {"device.yaml": load_profile, "recipe.yaml": load_train_config, "scenario.json": load_scenario}[name]
    path, text = tmp_path / name, json.dumps(content)
    path.write_text(text, encoding="utf-8")
    plain = load(path)
    path.write_text(text, encoding="utf-8-sig")
    assert load(path) == plain
    path.write_text(text, encoding="utf-16")
    with pytest.raises(AmulettError, match="not UTF-8"):
        load(path)


def test_numbers_from_python_are_taken_by_every_reader():
    assert load_profile({"name": "a", "base": "testbed", "loop": {"substeps": np.int64(2)}}).loop.substeps == 2
    moves = ({"time": np.float32(0.5), "angle_deg": 10},)
    assert load_scenario({"moves": moves, "noise_seed": np.uint64(2**63)}).noise_seed == 2**63
    recipe = TrainConfig.model_validate({"env": {"tension_range": np.array([5, 12])}, "network": {"start": Path("a")}})
    assert (list(recipe.env.tension_range), recipe.network.start) == ([5.0, 12.0], "a")
    assert type(recipe.model_dump()["env"]["tension_range"][0]) is float


def test_an_integer_beyond_all_bounds_is_refused():
    with pytest.raises(AmulettError, match="total_steps"):
        load_train_config(None, [f"total_steps={sys.float_info.max}"])


def test_a_users_own_file_comes_before_the_packaged_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    packaged = configs_folder() / "ppo.yaml"
    for name in ("ppo.yaml", "./ppo.yaml", "configs/ppo.yaml", Path("configs") / "ppo.yaml", "ppo"):
        assert find_config(name, "recipe") == packaged
    (tmp_path / "ppo").mkdir()  # a run, say
    assert find_config("ppo", "recipe") == packaged
    (tmp_path / "ppo.yaml").write_text("seed: 7")
    assert load_train_config("ppo.yaml").seed == load_train_config(tmp_path / "ppo.yaml").seed == 7
    assert find_config("ppo.yaml", "recipe", Path("other")) == packaged


@pytest.mark.parametrize(
    "name", ["none/ppo.yaml", "../configs/ppo.yaml", "/ppo.yaml", "configs", "", "x" * 5000, "a\0b"]
)
def test_other_names_are_no_packaged_files(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AmulettError, match="cannot read recipe"):
        load_train_config(name)


def test_a_missing_file_suggests_the_nearest_packaged_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AmulettError, match=r"No such file.*packaged are .*sac\.yaml.*; did you mean 'my_device\.yaml'"):
        load_profile("configs/my_devise.yaml")


def test_the_home_folder_is_expanded_for_all_readers(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    (tmp_path / "curve.csv").write_text("deflection_m,force_N\n0,0\n0.002,5\n0.004,10\n")
    (tmp_path / "d.yaml").write_text("{name: d, base: testbed, spring: {measured_curve: ~/curve.csv}}")
    (tmp_path / "r.yaml").write_text("{seed: 2, env: {profile: ~/d.yaml}}")
    (tmp_path / "s.json").write_text('{"measure_from": 1, "setpoint": {"file": "~/log.csv", "column": "angle"}}')
    (tmp_path / "log.csv").write_text("time,angle\n0,1\n1,2\n")
    assert load_profile(load_train_config("~/r.yaml").env.profile).name == "d"
    assert load_scenario(Path("~/s.json")).measure_from == 1
