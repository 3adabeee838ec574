"""A training run that is killed, interrupted or damaged, and resumed: the same bits as if nothing had happened.

With AMULETT_KILLS=20 in the environment each kind of killing is done 20 times instead of 3.
"""

import csv
import hashlib
import json
import multiprocessing
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from helpers import forkserver

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC  # noqa: E402
from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402
from stable_baselines3.common.logger import Logger  # noqa: E402

from amulett_agents import load_train_config, resume, run_folder, train  # noqa: E402
from amulett_agents import run as module  # noqa: E402
from amulett_agents.checkpoint import ARRAYS, MANIFEST, STATE, capture, newest_checkpoint, read_checkpoint, restore  # noqa: E402
from amulett_agents.model import make_model  # noqa: E402
from amulett_agents.run import Run  # noqa: E402
from amulett_agents.validation import torch_threads  # noqa: E402
from amulett_gym.cli import main  # noqa: E402
from amulett_gym.errors import AmulettError  # noqa: E402
from amulett_gym.laws.bundle import read_bundle  # noqa: E402
from amulett_gym.profile import load_profile  # noqa: E402
from amulett_gym.settings import merge  # noqa: E402
from amulett_gym.storage import lock  # noqa: E402
from amulett_gym.storage.lock import LOCK, locked_folder  # noqa: E402
from amulett_gym.storage.provenance import read_provenance  # noqa: E402
from amulett_gym.storage.reading import read_arrays  # noqa: E402

KILLS = int(os.environ.get("AMULETT_KILLS", "3"))
SMALL = [
    "num_envs=16",
    "total_steps=5120",
    "network.hidden=[16]",
    "ppo.n_steps=32",
    "ppo.batch_size=128",
    "ppo.n_epochs=2",
    "ppo.gamma=0.99",
    "env.max_episode_steps=75",
    "validation.every_steps=700",
    "validation.episodes=4",
    "checkpoint_seconds=0",
    "checkpoint=true",
]
PLAIN: list[str] = []
SMOOTH = [
    "ppo.use_sde=true",
    "ppo.sde_sample_freq=-1",
    "ppo.final_std=0.1",
    "ppo.critic_steps=1500",
    "env.observation_noise=0.01",
    "env.suite=reach",
    "env.history=3",
    "env.privileged=true",
    "seed=3",
]
REPLAYED = [
    "algorithm=sac",
    "sac.train_freq=32",  # rollouts as long as PPO's
    "sac.gradient_steps=4",
    "sac.batch_size=64",
    "sac.buffer_size=1600",  # filled, and begun anew
    "sac.learning_starts=800",
    "sac.anneal=true",
    "env.history=2",
]
DRIVES = ["env.id=Amulett/Drives-v0", "env.tension_range=[0, 15]"]
RECIPES = {"plain": PLAIN, "smooth": SMOOTH, "replayed": REPLAYED, "drives": DRIVES}
ROLLOUTS = 10

processes = forkserver()


@pytest.fixture(autouse=True)
def one_thread():
    with torch_threads(1):
        yield


def recipe(changes=()):
    return load_train_config(None, [*SMALL, *changes])


def live(out: Path, changes: list[str], die_at: float = float("inf")) -> None:
    """Begin the run or go on with it, in a process of its own, and die at the given operation on its files."""
    operations = 0

    def is_the_last() -> bool:
        nonlocal operations
        operations += 1
        return operations >= die_at

    def watch(event, arguments):
        if event not in ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir"):
            return
        # Of the run, or by a name relative to an open folder, as shutil.rmtree removes files: not numba's cache.
        path = str(arguments[0])
        if (path.startswith(str(out)) or (event != "open" and not path.startswith("/"))) and is_the_last():
            os.kill(os.getpid(), signal.SIGKILL)

    write = Path.write_bytes

    def write_half(self, data):
        if not is_the_last():
            return write(self, data)
        with self.open("wb") as file:
            file.write(data[: len(data) // 2])
        return os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    Path.write_bytes = write_half
    Path.write_text = lambda self, text, encoding: write_half(self, text.encode(encoding))
    if (out / "config.yaml").is_file():
        resume(out, progress=False)
    else:
        train(recipe(changes), out, progress=False)
    out.with_name("operations").write_bytes(str(operations).encode())


def started(target, *arguments) -> multiprocessing.Process:
    process = processes.Process(target=target, args=arguments)
    process.start()
    return process


def wait_for_checkpoint(process, out: Path, at_least: int = 0) -> None:
    while process.is_alive() and not any(
        path.name.isdecimal() and int(path.name) >= at_least for path in (out / "checkpoints").glob("*")
    ):
        time.sleep(0.002)


def outcome(out: Path) -> dict:
    """Return all numbers that a run leaves but times: networks, optimiser, bundles with their scores, validations."""
    is_sac = load_train_config(out / "config.yaml").algorithm == "sac"
    model = (SAC if is_sac else PPO).load(out / "last_sb3.zip", device="cpu")
    rows = list(csv.reader((out / "evaluations.csv").read_text().splitlines()))
    numbers = {
        "validations": [[value for name, value in zip(rows[0], row, strict=True) if name != "seconds"] for row in rows]
    }
    for name, tensor in model.policy.state_dict().items():
        numbers[name] = tensor.numpy().tobytes()
    if is_sac:
        optimizers = [model.actor.optimizer, model.critic.optimizer, model.ent_coef_optimizer]
        numbers["entropy coefficient"] = model.log_ent_coef.item()
    else:
        optimizers = [model.policy.optimizer]
    for number, optimizer in enumerate(optimizers):
        for index, moments in optimizer.state_dict()["state"].items():
            for name, tensor in moments.items():
                numbers[f"optimizer {number} {index} {name}"] = tensor.numpy().tobytes()
    for name in ("best", "last"):
        bundle = read_bundle(out / name)
        numbers[f"{name} weights"] = [array.tobytes() for layer in bundle.layers for array in layer]
        scores = bundle.provenance["validation"]
        numbers[f"{name} scores"] = {key: value for key, value in scores.items() if key != "seconds"}
    result = json.loads((out / "finished.json").read_text())
    numbers["result"] = {name: value for name, value in result.items() if name != "seconds"}
    assert not (out / "checkpoints").exists()
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [
            "best",
            "last",
            "command.json",
            "config.yaml",
            "evaluations.csv",
            "finished.json",
            "last_sb3.zip",
            "tensorboard",
        ]
    )
    return numbers


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """Return what runs of the recipes leave that nobody disturbs, and how often the first touches its files."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    process = started(live, folder / "plain", PLAIN)
    process.join()
    for name in ("smooth", "replayed", "drives"):
        train(recipe(RECIPES[name]), folder / name, progress=False)
    operations = int((folder / "operations").read_text())
    kept = {name: outcome(folder / name) for name in RECIPES}
    return {**kept, "folder": folder, "operations": operations}


class Died(Exception):
    """In the place of a kill: nothing after it is done."""


def break_off(out: Path, changes: list[str]) -> None:
    """Train until a run stops dead after its fifth checkpoint, before its fifth rollout."""
    write, written = module.write_checkpoint, []

    def write_and_die(*arguments):
        written.append(write(*arguments))
        if len(written) == 5:
            raise Died

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "write_checkpoint", write_and_die)
        with pytest.raises(Died):
            train(recipe(changes), out, progress=False, command=["amulett", "train"])


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Return the folders of runs that stopped dead, one of each recipe, made when it is first asked for."""
    folder = tmp_path_factory.mktemp("stopped")

    def of(name: str) -> Path:
        if not (folder / name).exists():
            break_off(folder / name, RECIPES[name])
        return folder / name

    return of


@pytest.fixture
def broken_off(tmp_path, stopped, request):
    """Return a copy of the folder of a run that stopped dead."""
    return shutil.copytree(stopped(getattr(request, "param", "plain")), tmp_path / "run")


# --- killed


@pytest.mark.parametrize(("name", "changes"), RECIPES.items())
def test_killed_at_random_moments_and_resumed_a_run_ends_with_the_same_bits(
    name, changes, uninterrupted, tmp_path, faults
):
    generator = np.random.default_rng()
    out = tmp_path / "run"
    killed = 0
    while killed < KILLS:
        if (out / "finished.json").exists():  # with many kills one run does not last
            assert outcome(out) == uninterrupted[name]
            out = tmp_path / f"run-{killed}"
        process = started(live, out, changes)
        first = max((int(path.name) for path in (out / "checkpoints").glob("[0-9]*")), default=0)
        wait_for_checkpoint(process, out, first + 512 * int(generator.integers(0, 3)))
        time.sleep(generator.uniform(0.0, 0.1))
        process.kill()
        process.join()
        killed += process.exitcode == -signal.SIGKILL
    resume(out, progress=False)
    assert outcome(out) == uninterrupted[name]
    faults("survived (kills)", killed)


@pytest.mark.parametrize("moment", ["first", "at the fourth", "five before the last", "last", *range(KILLS)])
def test_killed_between_or_within_operations_on_its_files_it_does_too(moment, uninterrupted, tmp_path, faults):
    out = tmp_path / "run"
    generator, operations = np.random.default_rng(), uninterrupted["operations"]
    named = {"first": 1, "at the fourth": 4, "five before the last": operations - 5, "last": operations}
    die_at = named.get(moment, int(generator.integers(1, operations)))
    process = started(live, out, PLAIN, die_at)
    process.join()
    assert process.exitcode == -signal.SIGKILL
    if (out / "config.yaml").exists() and moment not in named:
        again = int(generator.integers(1, 60))  # where what was written is brought back to the checkpoint
        process = started(live, out, PLAIN, again)
        process.join()
        die_at = die_at, again
    if (out / "config.yaml").exists():
        resume(out, progress=False)
    else:  # it died before it wrote down its recipe: there is nothing to resume, and nothing in the way
        train(recipe(), out, progress=False)
    assert outcome(out) == uninterrupted["plain"], die_at
    faults("survived (kills)", 2 if isinstance(die_at, tuple) else 1)


def test_killed_before_it_wrote_its_command_a_run_still_tells_what_it_is(uninterrupted, tmp_path):
    out = tmp_path / "run"

    def dies(*arguments):
        raise Died

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Died):
        patch.setattr(run_folder, "write_provenance", dies)
        train(recipe(), out, progress=False)
    assert (out / "config.yaml").is_file() and not (out / "command.json").exists()
    resume(out, progress=False)
    assert outcome(out) == uninterrupted["plain"]
    assert read_provenance(out).seeds == [0]


@pytest.mark.parametrize("half", [ARRAYS, STATE, MANIFEST])
def test_killed_in_the_middle_of_a_checkpoint_the_one_before_it_counts(half, uninterrupted, broken_off, faults):
    steps = newest_checkpoint(broken_off).content.model.steps
    unfinished = broken_off / "checkpoints" / f".{steps + 512:012d}"
    unfinished.mkdir()
    (unfinished / half).write_bytes(b"{")
    assert newest_checkpoint(broken_off).content.model.steps == steps
    resume(broken_off, progress=False)
    assert outcome(broken_off) == uninterrupted["plain"]
    faults("survived", 1)


def test_a_checkpoint_that_cannot_be_written_leaves_the_last_one_whole(uninterrupted, broken_off, monkeypatch, faults):
    before = newest_checkpoint(broken_off).folder

    def full(*arguments):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("amulett_agents.checkpoint.shutil.copytree", full)
        patch.setattr(module, "put_back", lambda *arguments: None)
        with pytest.raises(AmulettError, match="cannot write checkpoint .*: No space left on device"):
            resume(broken_off, progress=False)
    assert newest_checkpoint(broken_off).folder == before
    assert [path for path in (broken_off / "checkpoints").iterdir() if path.name.startswith(".")] == []
    resume(broken_off, progress=False)
    assert outcome(broken_off) == uninterrupted["plain"]
    faults("survived", 1)


def test_tensorboard_shows_what_it_would_have_shown(uninterrupted, broken_off):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    def shown(out):
        log = EventAccumulator(str(out / "tensorboard"))
        log.Reload()
        tags = [tag for tag in log.Tags()["scalars"] if not tag.startswith("time/")]
        return {tag: [(event.step, event.value) for event in log.Scalars(tag)] for tag in tags}

    time.sleep(1.1)  # TensorBoard reads files in the order of the second in their names
    resume(broken_off, progress=False)
    expected = shown(uninterrupted["folder"] / "plain")
    assert {"rollout/ep_rew_mean", "train/value_loss", "validation/cost", "reward/effort"} <= set(expected)
    assert shown(broken_off) == expected


@pytest.mark.parametrize("broken_off", RECIPES, indirect=True)
def test_everything_that_is_kept_is_restored(broken_off):
    checkpoint = newest_checkpoint(broken_off)
    model = make_model(load_train_config(broken_off / "config.yaml"))

    class Look(BaseCallback):
        def _on_rollout_start(self):
            restore(self.model, checkpoint)
            self.seen = capture(self.model)
            raise Died

        def _on_step(self):
            return True

    look = Look()
    model.set_logger(Logger(None, []))
    with pytest.raises(Died):
        model.learn(5120, callback=look)
    state, arrays = look.seen
    assert state == checkpoint.content.model
    assert arrays.keys() == checkpoint.arrays.keys()
    assert all(arrays[name].tobytes() == kept.tobytes() for name, kept in checkpoint.arrays.items())


# --- interrupted


def command_line(words: list[str], result: Path) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that put pytest in the background had it ignored
    with result.open("w") as sys.stdout:
        code = main(words)
    raise SystemExit(code)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_it_at_the_next_rollout_and_the_command_resumes_it(number, uninterrupted, tmp_path):
    out = tmp_path / "run"
    told = tmp_path / "told"
    process = started(command_line, ["train", "--out", str(out), "--set", *SMALL, "validation.every_steps=700"], told)
    wait_for_checkpoint(process, out, 1024)
    os.kill(process.pid, number)
    process.join()
    assert process.exitcode == 130
    assert f"amulett train --resume {out}" in told.read_text()
    steps = newest_checkpoint(out).content.model.steps
    assert 1024 <= steps < 5120
    assert read_bundle(out / "last").provenance["steps"] == steps
    assert not (out / LOCK).exists()
    assert main(["train", "--resume", str(out)]) == 0
    assert outcome(out) == uninterrupted["plain"]


def test_a_finished_run_says_so_and_stays_as_it_is(uninterrupted, broken_off, capsys):
    first = resume(broken_off, progress=False)
    assert resume(broken_off, progress=False) == first
    assert main(["train", "--resume", str(broken_off)]) == 0
    assert "finished; there is nothing to resume" in capsys.readouterr().out
    assert outcome(broken_off) == uninterrupted["plain"]


def test_time_before_the_interruption_counts(tmp_path, broken_off):
    spent = newest_checkpoint(broken_off).content.run.seconds
    result = resume(broken_off, progress=False)
    seconds = [float(row["seconds"]) for row in csv.DictReader((broken_off / "evaluations.csv").open())]
    assert seconds == sorted(seconds)
    assert result.seconds > seconds[-1] > spent > 0


# --- two at once


def test_a_second_run_in_the_folder_is_told_who_has_it(tmp_path):
    out = tmp_path / "run"
    process = started(live, out, ["total_steps=100000000"])
    wait_for_checkpoint(process, out)
    owner = f"'{out}' is in use by process {process.pid} on {re.escape(socket.gethostname())}, since 20"
    for begin in (lambda: train(recipe(), out, progress=False, overwrite=True), lambda: resume(out, progress=False)):
        with pytest.raises(AmulettError, match=owner):
            begin()
    process.kill()
    process.join()
    assert (out / LOCK).exists()
    with locked_folder(out):  # of a dead process: taken over
        assert json.loads((out / LOCK).read_text())["pid"] == os.getpid()
        with pytest.raises(AmulettError, match=f"process {os.getpid()}"), locked_folder(out):
            pass
    assert not (out / LOCK).exists()


ABOUT_TO_START = """
import os, signal, sys, time
from amulett_gym.storage.lock import locked_folder

with locked_folder(sys.argv[1]):
    if os.fork() == 0:
        time.sleep(0.5)
        os._exit(0)
    os.kill(os.getpid(), signal.SIGKILL)
"""
"""Is killed while a child of it has its handles for a while, as between a fork and the begin of another program."""


@pytest.mark.parametrize("patience", [5.0, 0.0])
def test_the_lock_of_a_dead_process_is_awaited_while_its_child_has_it(tmp_path, monkeypatch, patience):
    monkeypatch.setattr(lock, "_PATIENCE", patience)
    dead = subprocess.Popen([sys.executable, "-c", ABOUT_TO_START, tmp_path])
    assert dead.wait() == -signal.SIGKILL
    refused = pytest.raises(AmulettError, match=f"process {dead.pid}") if patience == 0.0 else nullcontext()
    with refused, locked_folder(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()


def test_where_files_cannot_be_locked_the_owner_is_looked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "fcntl", None)
    dead = started(int)
    dead.join()
    here = socket.gethostname()
    for owner in ({"pid": dead.pid, "host": here}, {"pid": -1, "host": here}, {}, []):
        (tmp_path / LOCK).write_text(json.dumps(owner))
        with locked_folder(tmp_path):
            pass
    (tmp_path / LOCK).write_text("{")
    with locked_folder(tmp_path):
        pass
    for owner in ({"pid": os.getpid(), "host": here}, {"pid": dead.pid, "host": f"not-{here}"}):
        (tmp_path / LOCK).write_text(json.dumps(owner))
        with pytest.raises(AmulettError, match=f"process {owner['pid']} on {owner['host']}"), locked_folder(tmp_path):
            pass


def test_a_run_whose_folder_vanishes_says_so_and_makes_no_new_one(tmp_path, monkeypatch, faults):
    out, write = tmp_path / "run", module.write_checkpoint
    written = []

    def write_and_lose(*arguments):
        written.append(write(*arguments))
        if len(written) == 3:
            out.rename(tmp_path / "elsewhere")

    monkeypatch.setattr(module, "write_checkpoint", write_and_lose)
    with pytest.raises(AmulettError, match="the run's folder .* has vanished"):
        train(recipe(), out, progress=False)
    assert not out.exists()
    newest_checkpoint(tmp_path / "elsewhere")
    faults("survived", 1)


# --- damaged


def damage(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("name", [ARRAYS, STATE, MANIFEST, "best/weights.safetensors"])
def test_a_damaged_checkpoint_is_named_and_the_one_before_it_taken(name, uninterrupted, broken_off, faults):
    newest = newest_checkpoint(broken_off).folder
    damage(newest / name)
    with pytest.warns(UserWarning, match=f"{newest}.*resuming from the one before it, .*{1536:012d}"):
        resume(broken_off, progress=False)
    assert outcome(broken_off) == uninterrupted["plain"]
    faults("survived", 1)


def test_if_all_are_damaged_the_error_names_them(broken_off):
    older, newer = sorted((broken_off / "checkpoints").iterdir())
    (newer / STATE).unlink()
    (older / "more.txt").write_text("")
    with pytest.raises(AmulettError, match=rf"{newer}.*'{STATE}' is missing.*{older}.*'more.txt' is not listed"):
        resume(broken_off, progress=False)


def test_hidden_files_are_no_part_of_a_checkpoint(uninterrupted, broken_off):
    for folder in [broken_off / "checkpoints", *(broken_off / "checkpoints").iterdir()]:
        (folder / ".DS_Store").write_bytes(b"\0")
        (folder / "._state.json").write_bytes(b"\0")
    resume(broken_off, progress=False)
    assert outcome(broken_off) == uninterrupted["plain"]


def test_a_checkpoint_holds_no_code(broken_off):
    for folder in (broken_off / "checkpoints").iterdir():
        names = {path.suffix for path in folder.rglob("*") if path.is_file()}
        assert names == {".json", ".md", ".npz", ".safetensors"}
        for critic in folder.rglob("*.npz"):
            assert all(values.dtype.kind in "fiU" for values in read_arrays(critic, "critic").values())  # no objects


@pytest.mark.parametrize("length", np.linspace(0, 0.9, 10))
def test_a_truncated_checkpoint_is_refused(length, broken_off, faults):
    folder = newest_checkpoint(broken_off).folder
    for name in (ARRAYS, STATE, MANIFEST):
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(length * len(content))])
        with pytest.raises(AmulettError, match=name):
            read_checkpoint(folder)
        (folder / name).write_bytes(content)
        faults("refused", 1)
    read_checkpoint(folder)


def test_a_manifest_without_end_is_not_read(broken_off, faults):
    folder = newest_checkpoint(broken_off).folder
    with (folder / MANIFEST).open("r+b") as file:
        file.truncate(10**12)  # of which the disk holds nothing
    with pytest.raises(AmulettError, match=f"{MANIFEST}' has {10**12} bytes; at most"):
        read_checkpoint(folder)
    faults("refused", 1)


@pytest.mark.parametrize(("key", "value"), [("version", 2), ("amulett_gym", "0.0.9")])
def test_a_checkpoint_of_another_version_is_refused(key, value, broken_off):
    path = newest_checkpoint(broken_off).folder / MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(AmulettError, match=rf"was written by .*{value}.*; this is .*resume with the version"):
        resume(broken_off, progress=False)


# --- other things that do not fit


def test_a_changed_recipe_is_refused(broken_off):
    path = broken_off / "config.yaml"
    path.write_text(
        path.read_text().replace("gamma: 0.99", "gamma: 0.9", 1).replace("seed: 0\nthreads", "seed: 1\nthreads")
    )
    with pytest.raises(
        AmulettError, match=r"recipe was changed.*ppo\.gamma was 0\.99 and is 0\.9; seed was 0 and is 1;"
    ):
        resume(broken_off, progress=False)


def test_a_run_is_resumed_and_run_again_without_the_files_of_its_device(tmp_path, monkeypatch, capsys):
    """The profile, with its measured curve, is kept by content: relative paths mean nothing elsewhere."""
    (tmp_path / "dev").mkdir()
    curve = "deflection_m,force_N\n0,0\n0.01,5\n0.02,12\n0.04,40\n"
    (tmp_path / "dev" / "curve.csv").write_text(curve)
    (tmp_path / "dev" / "mine.yaml").write_text("{name: mine, base: testbed, spring: {measured_curve: curve.csv}}")
    monkeypatch.chdir(tmp_path)
    config = recipe(["env.profile=dev/mine.yaml", "total_steps=1024"])
    train(config, tmp_path / "whole", progress=False)

    def die(*arguments):
        raise Died

    with monkeypatch.context() as patch:
        patch.setattr(Run, "_validate", die)
        with pytest.raises(Died):
            train(config, tmp_path / "run", progress=False)
    shutil.rmtree(tmp_path / "dev")
    monkeypatch.chdir("/")
    resume(tmp_path / "run", progress=False)
    weights = [(tmp_path / run / "last" / "weights.safetensors").read_bytes() for run in ("run", "whole")]
    assert weights[0] == weights[1]
    assert main(["rerun", str(tmp_path / "whole"), "--out", str(tmp_path / "again")]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    for own in (config.env.profile, read_bundle(tmp_path / "run" / "last").env.keywords["profile"]):
        assert load_profile(own).spring.measured_curve.force_N == [0.0, 5.0, 12.0, 40.0]


def change_state(out, group, **values):
    """Change a group of the newest checkpoint's state as if it had been written so."""
    path = newest_checkpoint(out).folder
    state = json.loads((path / STATE).read_text())
    state[group] = merge(state[group], values)
    (path / STATE).write_text(json.dumps(state))
    manifest = json.loads((path / MANIFEST).read_text())
    manifest["sha256"][STATE] = hashlib.sha256((path / STATE).read_bytes()).hexdigest()
    (path / MANIFEST).write_text(json.dumps(manifest))


def test_devices_with_other_fields_are_refused(broken_off):
    """As those of a version before a quantity was added."""
    name = "devices.venv.episodes.simulation.states"
    assert name in newest_checkpoint(broken_off).content.model.devices
    change_state(broken_off, "model", devices={name: "0" * 64})
    with pytest.raises(AmulettError, match=rf"'{name}' has other fields .*resume with the version that began the run"):
        resume(broken_off, progress=False)


def test_a_shipped_profile_of_another_version_is_refused(broken_off):
    change_state(broken_off, "profile", loop={"offset_deg": 25.5})
    with pytest.raises(AmulettError, match=r"profile 'testbed' was changed .*loop\.offset_deg was 25\.5 and is"):
        resume(broken_off, progress=False)


def test_other_software_is_warned_of(broken_off):
    path = broken_off / "command.json"
    about = json.loads(path.read_text())
    about["versions"]["torch"] = "1.0"
    path.write_text(json.dumps(about))
    with pytest.warns(UserWarning, match=r"other software.*torch was '1\.0'"):
        resume(broken_off, progress=False)
    assert read_bundle(broken_off / "last").provenance["command"] == ["amulett", "train"]


def test_folders_without_a_run_or_a_checkpoint_are_refused(tmp_path, broken_off):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(AmulettError, match="holds no training run"):
            resume(folder)
    (broken_off / "checkpoints").rename(tmp_path / "elsewhere")
    with pytest.raises(AmulettError, match="holds no checkpoint"):
        resume(broken_off)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--out DIR for a new run, or --resume DIR"),
        (["--resume", "x", "--out", "y"], "leave out --out"),
        (["--resume", "x", "--seed", "1", "--set", "seed=1"], "leave out --set, --seed"),
        (["--resume", "x"], "'x' holds no training run"),
    ],
)
def test_the_command_says_what_goes_together(words, message, capsys):
    assert main(["train", *words]) == 2
    assert message in capsys.readouterr().err
