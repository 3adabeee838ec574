"""Files from strangers: refused with an error that says why, or loaded within their ranges; never run, never endless.

Every kind of file is damaged as often as hypothesis would try: 200 times, and 10,000 times by
``pytest --hypothesis-profile=nightly``.
"""

from __future__ import annotations

import copy
import io
import json
import os
import pickle
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import BUSY, make_bundle
from hypothesis import settings

from amulett_agents.config import TrainConfig, load_train_config
from amulett_gym.errors import AmulettError
from amulett_gym.laws import bundle as bundles
from amulett_gym.laws.bundle import FILES, MANIFEST, Bundle, Manifest, read_bundle
from amulett_gym.logs import read_log
from amulett_gym.logs.mapping import load_mapping
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.storage.curve import read_curve
from amulett_gym.storage.provenance import Provenance, read_provenance, versions
from amulett_gym.storage.reading import read_arrays, read_json, read_text
from amulett_gym.storage.safe_yaml import parse_yaml
from amulett_gym.storage.writing import write_json
from amulett_gym.studies.paper.own_study import OwnStudy, read_study
from amulett_gym.studies.paper.study import profile_text, shipped
from amulett_gym.studies.paper.tables import DEVICES
from amulett_gym.tasks.scenario import Scenario, load_scenario, pack

TESTBED = load_profile("testbed")
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Kind:
    """A kind of file: a valid one, its reader, and what is done with what was read; that has to be finite."""

    name: str
    valid: bytes
    read: Callable[[Path], Any]
    use: Callable[[Any], Any]


def simulate(profile: Profile) -> Any:
    simulation = Simulation(profile, 1)
    return [simulation.parameters[name] for name in simulation.parameters.dtype.names]


def prepare(scenario: Scenario) -> Any:
    row = pack(scenario, TESTBED)
    return [row[name] for name in row.dtype.names]


def read_own_study(path: Path) -> OwnStudy:
    for name in DEVICES:
        (path.parent / f"{name}.yaml").write_text(PROFILES[name])
    return read_study(path.parent)


PROFILES = {name: profile_text(name, shipped()) for name in DEVICES}
NOTE = Provenance(kind="evaluate", command=["amulett", "evaluate"], versions=versions(), git_revision=None)


def packed() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, digest=np.array("0" * 64), values=np.random.default_rng(0).normal(size=(5, 40)))
    return file.getvalue()


KINDS = {
    kind.name: kind
    for kind in (
        Kind("device.yaml", (ROOT / "configs" / "my_device.yaml").read_bytes(), load_profile, simulate),
        Kind(
            "recipe.yaml",
            (ROOT / "configs" / "ppo.yaml").read_bytes(),
            load_train_config,
            lambda recipe: TrainConfig.model_validate(recipe.model_dump()).env.tension_range,
        ),
        Kind("scenario.json", json.dumps(BUSY).encode(), load_scenario, prepare),
        Kind(
            "curve.csv",
            b"deflection_m,force_N,spring_deflection_m\n0,0,0\n0.002,1.5,0.001\n0.004,4.5,0.002\n0.006,12,0.004\n",
            read_curve,
            lambda curve: [values for _, values in curve],
        ),
        Kind(
            "log.csv",
            b"t;setpoint (deg);angle [rad];force_biceps_N\r\n0;1,5;0,1;\r\n10;1,5;0,2;5\r\n20;2;0,2;6\r\n",
            lambda path: read_log(path, {"time": {"name": "t", "unit": "ms"}}),
            lambda log: [log["time"]],
        ),
        Kind(
            "mapping.yaml",
            b"time: {name: t, unit: ms}\nangle: {name: 3, sign: -1, offset: 2.5, scale: 0.1}\nfile: {decimal: comma}\n",
            load_mapping,
            lambda mapping: [mapping.angle.offset, mapping.angle.scale],
        ),
        Kind("identification.json", json.dumps(shipped()).encode(), read_own_study, lambda study: [study.folder]),
        Kind(
            "command.json",
            NOTE.model_dump_json().encode(),
            lambda path: read_provenance(path.parent),
            lambda note: [note.seeds],
        ),
        Kind("episodes.npz", packed(), lambda path: read_arrays(path, "episodes"), lambda arrays: arrays.values()),
    )
}

each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


@pytest.fixture(scope="session")
def tries() -> int:
    return settings.default.max_examples


def is_refused(kind: Kind, path: Path) -> bool:
    """Read and use a file; whatever else than AmulettError it raises fails the test."""
    try:
        with np.errstate(all="ignore"):
            used = kind.use(kind.read(path))
    except AmulettError as error:
        assert 0 < len(str(error)) < 5000
        return True
    for part in used:
        if np.asarray(part).dtype.kind == "f":
            assert not np.isnan(part).any(), path.read_bytes()
    return False


def count(faults: Callable[[str, int], None], refused: list[bool]) -> None:
    faults("refused", sum(refused))
    faults("loaded within their ranges", len(refused) - sum(refused))


@each_kind
def test_every_kind_of_file_is_read(kind, tmp_path):
    (tmp_path / kind.name).write_bytes(kind.valid)
    assert not is_refused(kind, tmp_path / kind.name)


@each_kind
def test_random_bytes_do_no_harm(kind, tmp_path, tries, faults):
    path, random = tmp_path / kind.name, np.random.default_rng(0)
    outcomes = []
    for _ in range(tries):
        damaged = bytearray(kind.valid)
        for position in random.integers(len(damaged), size=random.integers(1, 4)):
            damaged[position] = random.integers(256)
        path.write_bytes(damaged)
        outcomes.append(is_refused(kind, path))
    assert any(outcomes)
    count(faults, outcomes)


@each_kind
@pytest.mark.parametrize("tenths", range(10))
def test_what_was_cut_off_does_no_harm(kind, tenths, tmp_path, faults):
    (tmp_path / kind.name).write_bytes(kind.valid[: len(kind.valid) * tenths // 10])
    count(faults, [is_refused(kind, tmp_path / kind.name)])


HOSTILE: list[Any] = [
    *(float("nan"), float("inf"), 1e308, -1e308, 5e-324, -0.0, 10**99, 10**4000, -(2**63), True, None),
    *("", "x" * 10_000, "\0", "../../etc/passwd", "${HOME}", "{{7*7}}", "__import__('os')", "\ud800"),
    *([], {}, [[]], {"a": 1}, {"__class__": 1}, [0.0] * 2000, {str(i): i for i in range(500)}),
]


def places(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    below = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path, *(place for key, item in below for place in places(item, (*path, key)))]


def changed(tree: Any, place: tuple[Any, ...], value: Any) -> Any:
    if not place:
        return value
    tree = copy.deepcopy(tree)
    parent = tree
    for key in place[:-1]:
        parent = parent[key]
    parent[place[-1]] = value
    return tree


TREES = {
    "identification.json": json.loads(KINDS["identification.json"].valid),
    "command.json": json.loads(KINDS["command.json"].valid),
    "device.yaml": yaml.safe_load(KINDS["device.yaml"].valid)
    | {"loop": {"position": TESTBED.loop.position.model_dump()}},
    "recipe.yaml": TrainConfig().model_dump(),
    "scenario.json": BUSY,
}


@pytest.mark.parametrize("name", TREES)
def test_a_hostile_value_in_any_place_does_no_harm(name, tmp_path, tries, faults):
    tree, path, random = TREES[name], tmp_path / name, np.random.default_rng(0)
    everywhere = places(tree)
    for _ in range(tries):
        place = everywhere[random.integers(len(everywhere))]
        damaged = changed(tree, place, HOSTILE[random.integers(len(HOSTILE))])
        text = json.dumps(damaged) if name.endswith(".json") else yaml.safe_dump(damaged)
        path.write_bytes(text.encode(errors="surrogatepass"))
        count(faults, [is_refused(KINDS[name], path)])


DEEP = 100_000
BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{here}: &{here} [{', '.join([f'*{before}'] * 8)}]\n"
    for before, here in zip("abcdefghijk", "bcdefghijkl", strict=True)
)
MERGES = "a: &a {k: 1}\n" + "".join(
    f"{here}: &{here} {{<<: [{', '.join([f'*{before}'] * 8)}]}}\n"
    for before, here in zip("abcdefghijk", "bcdefghijkl", strict=True)
)
BOMBS = {
    "aliases.yaml": BOMB,
    "merges.yaml": MERGES,
    "itself.yaml": "a: &a {b: *a}",
    "itself_in_a_list.yaml": "a: &a [*a]",
    "brackets.yaml": "[" * 50_000,
    "braces.yaml": "{a: " * 20_000,
    "dashes.yaml": "- " * 40_000,
    "keys.yaml": "? " * 40_000,
    "long.yaml": "a: [" + "1, " * 30_000 + "]",
    "digits.yaml": "name: " + "9" * 50_000,
    "sexagesimal.yaml": "name: " + ":".join(["59"] * 30_000),
    "large.yaml": "#" * 5_000_000,
    "twice.yaml": "name: mine\nname: yours",
    "brackets.json": "[" * DEEP,
    "braces.json": '{"a":' * DEEP,
    "closed.json": "[" * 900 + "]" * 900,
    "digits.json": '{"noise_seed": ' + "9" * 90_000 + "}",
    "large.json": " " * 5_000_000,
    "nan.json": '{"initial_angle_deg": NaN}',
    "overflow.json": '{"initial_angle_deg": 1e999}',
    "twice.json": '{"noise_seed": 1, "noise_seed": 2}',
    "wide.csv": "deflection_m,force_N" + ",x" * 100_000 + "\n" + "0,0\n" * 100_000,
    "long.csv": "deflection_m,force_N\n" + "0,0\n" * 200_000,
    "field.csv": "deflection_m,force_N\n0," + "1" * 500_000 + "\n",
    "quote.csv": 'deflection_m,force_N\n"' + "0,0\n" * 100_000,
    "preamble.csv": ("x," * 9_900 + "\n") * 100,
    "units.csv": "time [s],setpoint [deg],angle [deg]" + "," + "[" * 9_000 + "\n0,0,0,0\n1,1,1,x,1\n",
    "subnormal.csv": "deflection_m,force_N\n0,0\n5e-324,1\n1e-323,2\n",
    "huge.csv": "deflection_m,force_N\n0,0\n1e300,1e308\n1e301,1.7e308\n",
    "nan.csv": "deflection_m,force_N\n0,0\nnan,1\n1,2\n",
}
READ_ALL = """
import resource, sys
from pathlib import Path
from amulett_gym.profile import load_profile
from amulett_gym.errors import AmulettError
from amulett_gym.logs import read_log
from amulett_gym.storage.curve import read_curve
from amulett_gym.tasks.scenario import load_scenario
from amulett_agents.config import load_train_config

readers = {".yaml": [load_profile, load_train_config], ".json": [load_scenario], ".csv": [read_curve, read_log]}
here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (here + 200_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
for path in sorted(Path(sys.argv[1]).iterdir()):
    for read in readers[path.suffix]:
        try:
            read(path)
        except AmulettError as error:
            print(path.name, len(str(error)))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits memory as Linux does")
def test_bombs_are_refused_in_little_memory_and_time(tmp_path, faults):
    """All of them together, in a process that may take 200 MB and 60 s and no more."""
    for name, text in BOMBS.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", READ_ALL, str(tmp_path)], capture_output=True, text=True, env=os.environ, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    refused = dict(line.split() for line in done.stdout.splitlines())
    assert set(refused) == set(BOMBS)
    assert max(map(int, refused.values())) < 2000
    faults("refused", len(BOMBS))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "has more than 200000 keys and values"),
        ("a: &a [*a]", "refers to itself"),
        ("[" * 40 + "]" * 40, "nested more than 32 levels deep"),
        ("a: 1\na: 2", "the key 'a' is there twice"),
        ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("!!binary aGVsbG8=", "could not determine a constructor"),
        ("!!int ''", "not valid YAML"),
        ("!!bool perhaps", "not valid YAML"),
        ("a: " + "9" * 200, "an integer of more than 100 digits"),
    ],
)
def test_yaml_says_why_it_is_refused(text, message):
    with pytest.raises(AmulettError, match=message):
        parse_yaml(text, "file")


def test_yaml_may_still_repeat_itself():
    text = "gains: &gains {kp: 1.0, ki: 2.0}\nposition: *gains\ntension: {<<: *gains, kp: 3.0}"
    gains = {"kp": 1.0, "ki": 2.0}
    assert parse_yaml(text, "file") == {"gains": gains, "position": gains, "tension": {"kp": 3.0, "ki": 2.0}}


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/dev/zero")])
@each_kind
def test_what_is_no_ordinary_file_is_not_opened(kind, make, tmp_path, faults):
    make(tmp_path / kind.name)
    with pytest.raises(AmulettError, match="no ordinary file|Is a directory|there is no command|is missing"):
        kind.read(tmp_path / kind.name)
    faults("refused", 1)


@pytest.mark.parametrize("name", ["a" * 5000, "nul\0.yaml", "a/" * 3000 + "b.yaml"])
def test_names_that_no_file_can_have_are_refused(name):
    for read in (load_scenario, read_curve, read_bundle, load_train_config, lambda name: load_profile(f"{name}.yaml")):
        with pytest.raises(AmulettError):
            read(name)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"\xff\xfe")
    with pytest.raises(AmulettError, match="not UTF-8"):
        read_text(tmp_path / "file", "file")
    with pytest.raises(AmulettError, match="not UTF-8"):
        read_json(tmp_path / "file", "file")


# Bundles: whatever is changed, the manifest tells; and if the attacker writes a new manifest, all is checked again.


def vouch_for(folder: Path) -> None:
    """Write a manifest for what the folder holds now, as an attacker would."""
    names = [path.name for path in folder.iterdir() if path.name != MANIFEST]
    manifest = Manifest(sha256={name: bundles._digest((folder / name).read_bytes()) for name in names})
    write_json(folder / MANIFEST, manifest.model_dump())


@pytest.fixture
def bundle(tmp_path):
    return make_bundle(tmp_path / "bundle")


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in (*FILES, MANIFEST)}


def test_a_bundle_with_random_bytes_is_refused(bundle, tries, faults):
    original, random = contents(bundle), np.random.default_rng(0)
    for k in range(tries):
        name = [*FILES, MANIFEST][k % 5]
        damaged = bytearray(original[name])
        position = random.integers(len(damaged))
        damaged[position] ^= random.integers(1, 256)
        (bundle / name).write_bytes(damaged)
        with pytest.raises(AmulettError):
            read_bundle(bundle)
        (bundle / name).write_bytes(original[name])
    read_bundle(bundle)
    faults("refused", tries)


@pytest.mark.parametrize("name", [*FILES, MANIFEST])
@pytest.mark.parametrize("tenths", range(10))
def test_a_bundle_that_was_cut_off_is_refused(bundle, name, tenths, faults):
    content = (bundle / name).read_bytes()
    (bundle / name).write_bytes(content[: len(content) * tenths // 10])
    with pytest.raises(AmulettError, match=name):
        read_bundle(bundle)
    faults("refused", 1)


def test_a_forged_bundle_is_refused_or_acts_within_the_range(bundle, tries, faults):
    original, random = contents(bundle), np.random.default_rng(0)
    observations = random.uniform(-1, 1, (10, 13))
    outcomes = []
    for k in range(tries):
        name = FILES[k % 4]
        damaged = bytearray(original[name])
        damaged[random.integers(len(damaged))] = random.integers(256)
        (bundle / name).write_bytes(damaged)
        vouch_for(bundle)
        outcomes.append(acts(bundle, observations))
        (bundle / name).write_bytes(original[name])
    assert {True, False} == set(outcomes)
    count(faults, [not acted for acted in outcomes])


def acts(folder: Path, observations: Any) -> bool:
    try:
        bundle: Bundle = read_bundle(folder)
    except AmulettError:
        return False
    assert (np.abs(bundle.act(observations)) <= 1).all()
    assert 0 < bundle.policy.tension_range[0] < bundle.policy.tension_range[1]
    return True


def test_the_largest_network_of_the_largest_weights_does_not_overflow():
    """Layers of the largest size, with rows that are all the same: one column stands for all."""
    most = bundles.MAX_WEIGHT
    value = 13 * most + most
    for _ in range(18):
        value = 4096 * most * value + most
    assert np.isfinite(value)


class Trap:
    def __init__(self, trap: Path) -> None:
        self.trap = trap

    def __reduce__(self):
        return Path.touch, (self.trap,)


@pytest.mark.parametrize("name", [*FILES, MANIFEST])
def test_a_pickle_in_a_bundle_is_not_opened(bundle, name, tmp_path, faults):
    (bundle / name).write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    if name != MANIFEST:
        vouch_for(bundle)
    with pytest.raises(AmulettError, match=name):
        read_bundle(bundle)
    assert not (tmp_path / "sprung").exists()
    faults("refused", 1)


@pytest.mark.parametrize("name", [*FILES, MANIFEST])
@pytest.mark.parametrize("make", ["link", "pipe", "folder", "dangling"])
def test_what_is_no_ordinary_file_in_a_bundle_is_not_opened(bundle, name, make, tmp_path, faults):
    content = tmp_path / "elsewhere"
    (bundle / name).rename(content)
    {
        "link": lambda path: path.symlink_to(content),  # even if the content is right
        "pipe": os.mkfifo,
        "folder": Path.mkdir,
        "dangling": lambda path: path.symlink_to("nowhere"),
    }[make](bundle / name)
    with pytest.raises(AmulettError, match=name):
        read_bundle(bundle)
    faults("refused", 1)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("env.json", {"id": "os:Amulett/Scaling-v0"}, "unknown environment 'os:Amulett/Scaling-v0'"),
        ("env.json", {"keywords": {"profile": "/etc/passwd.yaml"}}, "unknown profile"),
        ("env.json", {"keywords": {"profile": "../mine.yaml"}}, "unknown profile"),
        ("env.json", {"keywords": {"profile": ["testbed"]}}, "unknown profile"),
        ("policy.json", {"version": 2}, "this amulett-gym reads 1: update amulett-gym"),
        ("policy.json", {"version": 0}, "this amulett-gym reads 1: train again, or write the bundle anew"),
        ("policy.json", {"agent_period": 10**99}, "agent_period"),
    ],
)
def test_a_bundle_names_no_module_and_no_path_and_its_own_version(bundle, file, change, message):
    (bundle / file).write_text(json.dumps(json.loads((bundle / file).read_text()) | change))
    vouch_for(bundle)
    with pytest.raises(AmulettError, match=message):
        read_bundle(bundle)


def safetensors(header: Any, data: bytes = b"", length: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + data


def tensor(shape: list[Any], start: Any, end: Any, dtype: str = "F32") -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}


FLOATS = np.zeros(61, dtype=np.float32).tobytes()
GOOD = {
    "layer_0.weight": tensor([4, 13], 0, 208),
    "layer_0.bias": tensor([4], 208, 224),
    "layer_1.weight": tensor([1, 4], 224, 240),
    "layer_1.bias": tensor([1], 240, 244),
}
LIES = {
    "nothing": b"",
    "a header of 2^64 bytes": safetensors(GOOD, FLOATS, 2**64 - 1),
    "a header of 2^40 bytes": safetensors(GOOD, FLOATS, 2**40),
    "a header longer than the file": safetensors(GOOD, FLOATS, 10_000),
    "a shorter header": safetensors(GOOD, FLOATS, 20),
    "an empty header": safetensors(b"", FLOATS),
    "a header that is no JSON": safetensors(b"\xff" * 8, FLOATS),
    "a header that is a list": safetensors([1, 2], FLOATS),
    "a deep header": safetensors(b"[" * 100_000, FLOATS),
    "overlapping tensors": safetensors({**GOOD, "layer_1.bias": tensor([1], 0, 4)}, FLOATS),
    "a gap": safetensors({**GOOD, "layer_1.bias": tensor([1], 244, 248)}, FLOATS + b"0000"),
    "an end beyond the file": safetensors({**GOOD, "layer_1.bias": tensor([1], 240, 2**40)}, FLOATS),
    "an end before its start": safetensors({**GOOD, "layer_1.bias": tensor([1], 244, 240)}, FLOATS),
    "a negative offset": safetensors({**GOOD, "layer_0.weight": tensor([4, 13], -208, 0)}, FLOATS),
    "a shape that overflows": safetensors({**GOOD, "layer_1.bias": tensor([2**32, 2**32], 240, 244)}, FLOATS),
    "a negative shape": safetensors({**GOOD, "layer_1.bias": tensor([-1], 240, 244)}, FLOATS),
    "a shape of a thousand axes": safetensors({**GOOD, "layer_1.bias": tensor([1] * 1000, 240, 244)}, FLOATS),
    "another type": safetensors({**GOOD, "layer_1.bias": tensor([1], 240, 244, "I32")}, FLOATS),
    "a type that numpy does not know": safetensors({**GOOD, "layer_1.bias": tensor([2], 240, 244, "BF16")}, FLOATS),
    "a type that nobody knows": safetensors({**GOOD, "layer_1.bias": tensor([1], 240, 244, "PICKLE")}, FLOATS),
    "a missing tensor": safetensors({name: GOOD[name] for name in list(GOOD)[:3]}, FLOATS[:240]),
    "data after its end": safetensors(GOOD, FLOATS + b"0000"),
    "an infinity": safetensors(GOOD, FLOATS[:-4] + struct.pack("<f", float("inf"))),
    "a NaN": safetensors(GOOD, struct.pack("<f", float("nan")) + FLOATS[4:]),
    "a number that might overflow": safetensors(GOOD, struct.pack("<f", 3e38) + FLOATS[4:]),
    "a zip": b"PK\x03\x04" + bytes(100),
}


def test_the_good_header_is_read(bundle):
    (bundle / "weights.safetensors").write_bytes(safetensors(GOOD, FLOATS))
    vouch_for(bundle)
    assert read_bundle(bundle).act(np.zeros((1, 13))) == 0.0


def npz(entry: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("values.npy", entry)
    return file.getvalue()


def npy(shape: Any, dtype: str, data: bytes = b"") -> bytes:
    header = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape!r}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + data


ARCHIVES: dict[str, Callable[[], bytes]] = {
    "objects": lambda: npz(npy((1,), "|O", pickle.dumps([1]))),
    "a shape beyond all memory": lambda: npz(npy((2**50,), "<f8", bytes(8))),
    "a shape beyond all numbers": lambda: npz(npy((2**60, 2**60), "<f8", bytes(8))),
    "a bomb": lambda: npz(npy((450_000_000,), "|u1", bytes(450_000_000))),
    "no header": lambda: npz(b"nothing"),
    "code in the header": lambda: npz(npy("__import__('os')", "<f8")),
    "no zip": lambda: b"PK",
    "a pickle": lambda: pickle.dumps([1]),
}
"""What makes each: a bomb takes seconds, which the processes that only collect tests need not spend."""


@pytest.mark.parametrize("name", ARCHIVES)
def test_archives_that_lie_are_refused(name, tmp_path, faults):
    (tmp_path / "arrays.npz").write_bytes(ARCHIVES[name]())
    with pytest.raises(AmulettError, match=r"arrays\.npz' is damaged"):
        read_arrays(tmp_path / "arrays.npz", "arrays")
    faults("refused", 1)


@pytest.mark.parametrize("lie", LIES)
def test_weights_that_lie_are_refused(bundle, lie, faults):
    (bundle / "weights.safetensors").write_bytes(LIES[lie])
    vouch_for(bundle)
    with pytest.raises(AmulettError, match=r"weights\.safetensors"):
        read_bundle(bundle)
    faults("refused", 1)


def test_nothing_is_unpickled_or_evaluated_anywhere():
    """In our own source; zips of Stable-Baselines3 aside, which `tests/agents/test_sb3_zip.py` is about."""
    words = (
        "pickle.load",
        "torch.load(",
        "np.load(",
        "eval(",
        "exec(",
        "yaml.load(",
        "yaml.unsafe",
        "marshal",
        "shelve",
    )
    found = {
        (path.name, word)
        for folder in (ROOT / "amulett_gym", ROOT / "agents")
        for path in folder.rglob("*.py")
        for line in path.read_text().splitlines()
        for word in words
        if word in line and "allow_pickle=False" not in line
    }
    own = {(name, "pickle.load") for name in ("conformance.py", "cluster.py")}  # of what they dumped
    assert found == {("safe_yaml.py", "yaml.load("), *own}
