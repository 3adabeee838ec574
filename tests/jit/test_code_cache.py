"""What was compiled once stays compiled, wherever the package lies and whatever can be written, and is never stale."""

import ast
import json
import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import amulett_gym
from amulett_gym.jit import code_cache
from amulett_gym.jit.notice import COMPILING, STOPPING
from amulett_gym.studies.speed.startup import COLD, COMMANDS, LIMITS, table

PACKAGE = Path(amulett_gym.__file__).parent

NOISE = """
import json
from numpy import uint64
from amulett_gym.jit.code_cache import cache_folder
from amulett_gym.simulation.random import noise
values = [noise(uint64(3), uint64(5)), noise(3, 5)]
compiled = sum(noise.stats.cache_misses.values())
print(json.dumps({"values": values, "compiled": compiled, "folder": str(cache_folder())}))
"""
ANNOUNCED = """
import json
from numpy import uint64
from amulett_gym.jit.notice import announce_compilation
lines = []
announce_compilation(lines.append)
from amulett_gym.simulation.random import noise
noise(uint64(3), uint64(5)), noise(3, 5)
print(json.dumps(lines))
"""

HELD = """
import json, signal
from numpy import uint64
from amulett_gym.jit.notice import announce_compilation
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts processes in the background without it
lines, ended = [], "not interrupted"
announce_compilation(lambda line: (lines.append(line), len(lines) == 1 and signal.raise_signal(signal.SIGINT)))
from amulett_gym.simulation.random import noise
try:
    noise(uint64(3), uint64(5))
except KeyboardInterrupt:
    ended = "interrupted"
noise(uint64(3), uint64(5))
print(json.dumps([lines, ended]))
"""

SIGNATURES = 2  # whole numbers with a sign, and without

SENSOR_NOISE = """
from amulett_gym.simulation.sensors import sensor_noise
print(sensor_noise(2.0, 3, 5))
"""

FIRST_STEP = """
import json, sys
import gymnasium, amulett_gym
env = gymnasium.make("Amulett/Scaling-v0")
env.reset(seed=3)
observation = env.step(env.action_space.low)[0]
ours = [module for name, module in sys.modules.items() if name.startswith("amulett_gym")]
functions = [f for module in ours for f in vars(module).values() if hasattr(f, "py_func")]
compiled = sum(sum(f.stats.cache_misses.values()) for f in functions)
loaded = sum(sum(f.stats.cache_hits.values()) for f in functions)
known = "matplotlib", "pygame", "torch", "stable_baselines3", "jinja2", "scipy.interpolate", "scipy.optimize"
heavy = [name for name in (*known, "numba.typed.typeddict") if name in sys.modules]
print(json.dumps({"observation": observation.tolist(), "compiled": compiled, "loaded": loaded, "heavy": heavy}))
"""

NO_DISK = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
"""

OTHER_NUMBA = """
import numba.core.caching
del numba.core.caching._CacheLocator
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.plant import deflection_biceps
print(repr(type(deflection_biceps._cache).__module__).replace("'", '"'))
"""


def install(folder: Path) -> Path:
    """Copy the package as an installation does it: without caches, with new time stamps."""
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, folder / "amulett_gym", copy_function=shutil.copyfile, ignore=without)
    return folder


def start(site: Path, script: str = NOISE, **variables: object) -> subprocess.Popen[str]:
    """Start a process that imports the package from `site` and has no cache of this user's."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    variables = {"HOME": site / "home", "PYTHONPATH": site, **variables}
    return subprocess.Popen(
        [sys.executable, "-c", script],
        env=inherited | {name: str(value) for name, value in variables.items()},
        cwd=site,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def result(process: subprocess.Popen[str]) -> Any:
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    return json.loads(output)


def run(site: Path, script: str = NOISE, **variables: object) -> Any:
    return result(start(site, script, **variables))


def code_below(folder: Path) -> dict[str, int]:
    """Return the files of compiled code and when they were written."""
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*.nb?")}


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return an installation, and what its first process found, which compiled everything."""
    folder = install(tmp_path_factory.mktemp("used"))
    cold = run(folder)
    assert cold["compiled"] == SIGNATURES
    return folder, cold


@pytest.fixture
def site(tmp_path: Path, used: tuple[Path, dict[str, Any]]) -> Path:
    """Return a copy of the installation, with its bytecode, for a user without compiled code."""
    return Path(shutil.copytree(used[0], tmp_path / "site", ignore=shutil.ignore_patterns("home")))


@pytest.fixture
def warm(site: Path, used: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    """Give the user of `site` the compiled code, and return what the first process found."""
    shutil.copytree(used[0] / "home", site / "home")
    cold = used[1]
    return {**cold, "folder": str(site / Path(cold["folder"]).relative_to(used[0]))}


def test_a_reinstalled_package_steps_without_compiling(site, tmp_path):
    ours = code_cache.cache_folder()
    assert ours is not None
    kept = site / "home" / ".cache" / "amulett-gym" / ours.name
    kept.mkdir(parents=True)
    for path in ours.glob("*.nb?"):  # what other tests compiled from the same sources: it takes long
        shutil.copy(path, kept)
    first = run(site, FIRST_STEP)
    code = code_below(site)
    again = run(install(tmp_path / "other"), FIRST_STEP, HOME=site / "home")
    assert again["compiled"] == 0 < again["loaded"]
    assert again["observation"] == first["observation"]
    assert again["heavy"] == []
    assert code_below(site) == code != {}
    assert code_below(tmp_path / "other") == {}


def test_code_is_kept_in_the_users_cache_folder(site, warm, tmp_path):
    assert Path(warm["folder"]).parent == site / "home" / ".cache" / "amulett-gym"
    assert code_below(site / "amulett_gym") == {}
    assert Path(run(site, XDG_CACHE_HOME=tmp_path)["folder"]).parent == tmp_path / "amulett-gym"
    assert Path(run(site, NUMBA_CACHE_DIR=tmp_path / "numba")["folder"]).parent == tmp_path / "numba" / "amulett-gym"


@pytest.mark.parametrize(
    ("system", "folder"), [("macos.MacOS", "home/Library/Caches/amulett-gym"), ("windows.Windows", "local/amulett-gym")]
)
def test_each_system_has_its_documented_cache_folder(system, folder, tmp_path, monkeypatch):
    module, _, name = system.partition(".")
    there = import_module(f"platformdirs.{module}")
    monkeypatch.setattr("platformdirs.PlatformDirs", getattr(there, name))
    monkeypatch.setattr("platformdirs.windows.get_win_folder", lambda which: str(tmp_path / "local"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    assert next(code_cache._places()) == tmp_path / folder


def test_a_user_without_a_home_gets_a_temporary_folder(monkeypatch):
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as it is without one
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    assert list(code_cache._places()) == [code_cache._temporary_folder()]


def test_an_edit_of_what_is_called_reaches_the_caller_in_another_file(site):
    assert abs(run(site, SENSOR_NOISE)) < 10.0
    with (site / "amulett_gym" / "simulation" / "random.py").open("a") as file:
        file.write("\n\n@compiled\ndef noise(key, counter):\n    return 21.0\n")
    assert run(site, SENSOR_NOISE) == 42.0


def test_an_edit_of_what_is_not_compiled_keeps_the_code(site, warm):
    with (site / "amulett_gym" / "evaluation" / "plots.py").open("a") as file:
        file.write("\nANSWER = 42\n")
    assert run(site) == {**warm, "compiled": 0}


def test_other_settings_of_the_compiler_are_other_code(site, warm):
    checked = run(site, NUMBA_BOUNDSCHECK=1)
    assert checked["folder"] != warm["folder"] and checked["compiled"] == SIGNATURES


def test_with_a_home_that_cannot_be_written_code_is_kept_with_the_temporary_files(site, tmp_path):
    (tmp_path / "home").write_text("a file has no folders, not even for root")
    (tmp_path / "tmp").mkdir()
    cold, again = (run(site, HOME=tmp_path / "home", TMPDIR=tmp_path / "tmp") for _ in range(2))
    assert tmp_path / "tmp" in Path(cold["folder"]).parents
    assert again == {**cold, "compiled": 0}


@pytest.mark.skipif(sys.platform == "win32", reason="a user's temporary folder is the user's own")
def test_code_is_never_taken_from_where_others_can_write(site, tmp_path):
    (tmp_path / "home").touch()
    shared = tmp_path / "tmp" / f"amulett-gym-{os.getuid()}"
    shared.mkdir(parents=True)
    shared.chmod(0o777)
    for _ in range(2):
        found = run(site, HOME=tmp_path / "home", TMPDIR=tmp_path / "tmp")
        assert found["folder"] == "None" and found["compiled"] == SIGNATURES
    assert list(shared.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit to set")
def test_a_full_disk_stops_nothing(site, tmp_path):
    full = run(site, NO_DISK + NOISE)
    assert full["compiled"] == SIGNATURES
    assert run(site)["values"] == full["values"]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit to set")
def test_code_that_is_there_is_used_where_nothing_can_be_written(site, warm):
    assert run(site, NO_DISK + NOISE) == {**warm, "compiled": 0}


@pytest.mark.parametrize("pattern", ["*.noise-*.nbi", "*.noise-*.nbc"])
def test_damaged_files_are_written_anew(site, warm, pattern):
    for path in Path(warm["folder"]).glob(pattern):
        path.write_bytes(path.read_bytes()[:100])
    assert run(site) == warm
    assert run(site) == {**warm, "compiled": 0}


def test_code_of_another_signature_is_not_used(site, warm):
    one, other = sorted(Path(warm["folder"]).glob("*.noise-*.nbc"))
    shutil.copyfile(one, other)  # as two processes can leave it that number their files at the same time
    assert run(site) == {**warm, "compiled": 1}
    assert run(site) == {**warm, "compiled": 0}


def test_processes_that_start_together_compile_side_by_side(site):
    together = [start(site) for _ in range(3)]
    found = [result(process) for process in together]
    assert all(one["values"] == found[0]["values"] for one in found)
    assert run(site) == {**found[0], "compiled": 0}


def test_folders_that_were_not_used_for_long_are_deleted(site):
    place = site / "home" / ".cache" / "amulett-gym"
    for age in range(20):
        (place / f"old-{age:02}").mkdir(parents=True)
        os.utime(place / f"old-{age:02}", (1e9 - age, 1e9 - age))
    folder = Path(run(site)["folder"])
    newest = [f"old-{age:02}" for age in range(code_cache.KEPT_FOLDERS - 1)]
    assert sorted(path.name for path in place.iterdir()) == sorted([folder.name, *newest])
    os.utime(folder, (1e8, 1e8))
    run(site)
    assert folder.stat().st_mtime > 1e9  # it was used


def test_a_numba_that_was_rearranged_keeps_code_its_own_way(site):
    assert run(site, OTHER_NUMBA) == "numba.core.caching"


def test_every_file_with_compiled_functions_and_what_it_imports_counts():
    """Else an edit of it would leave old code behind."""

    def imported(path: Path) -> set[Path]:
        modules = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("amulett_gym"):
                modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        places = (PACKAGE.joinpath(*module.split(".")[1:]) for module in modules)
        return {path for place in places if (path := place.with_suffix(".py")).is_file()}

    counted: set[Path] = set()
    pending = {path for path in PACKAGE.rglob("*.py") if "\n@compiled" in path.read_text()}
    while pending - counted:
        path = (pending - counted).pop()
        counted.add(path)
        pending |= imported(path)
    assert counted - code_cache.sources() == set(), "add them to SOURCES of code_cache.py"


def test_benchmark_says_which_limits_are_missed():
    lines = table({name: [9.0, 0.5, 0.25] for name in COMMANDS}).splitlines()
    assert [line.endswith("MISSED") for line in lines[1:]] == [LIMITS.get(name, 1.0) < 0.5 for name in COMMANDS]
    assert lines[-1].split() == [*COLD.split(), "0.500", "0.25-9.00", "1.0", "1.00", "12", "s"]


def test_ctrl_c_while_code_is_compiled_ends_the_process_after_it(site):
    lines, ended = run(site, HELD)
    assert lines == [COMPILING, STOPPING] and ended == "interrupted"


def test_a_compilation_is_announced_once_and_only_where_code_is_compiled(site):
    assert run(site, ANNOUNCED) == [COMPILING]
    assert run(site, ANNOUNCED) == []
