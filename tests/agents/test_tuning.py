"""A study that is killed comes to the same trials as one that is not, and does none of them twice."""

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import fork_processes, forkserver

torch = pytest.importorskip("torch")
pytest.importorskip("optuna")

from amulett_agents import load_train_config, tuning  # noqa: E402
from amulett_agents.bundles import save_policy  # noqa: E402
from amulett_agents.model import make_model  # noqa: E402
from amulett_agents.tuning import Trial, _propose, best_of, load_space, stored_study, tune  # noqa: E402
from amulett_agents.validation import torch_threads  # noqa: E402
from amulett_gym.cli import main  # noqa: E402
from amulett_gym.errors import AmulettError  # noqa: E402
from amulett_gym.laws.bundle import read_bundle  # noqa: E402
from amulett_gym.laws.copies import FOLDER  # noqa: E402
from amulett_gym.storage.lock import locked_folder  # noqa: E402
from amulett_gym.storage.provenance import read_provenance  # noqa: E402
from amulett_gym.workers.call import Workers  # noqa: E402

SMALL = [
    "num_envs=16",
    "total_steps=1024",
    "network.hidden=[8]",
    "ppo.n_steps=32",
    "ppo.batch_size=128",
    "ppo.n_epochs=1",
    "ppo.gamma=0.99",
    "env.max_episode_steps=75",
    "validation.every_steps=512",
    "validation.episodes=2",
    "checkpoint_seconds=0",
]
SPACE = {
    "ppo.learning_rate": {"low": 1e-3, "high": 1e-1, "log": True},
    "ppo.n_epochs": {"low": 1, "high": 3},
    "network.hidden": {"choices": [[8], [16]]},
    "ppo.final_std": {"choices": [None, 0.05]},
}
TRIALS = 4

processes = forkserver()


@pytest.fixture(autouse=True)
def one_thread():
    with torch_threads(1):
        yield


@pytest.fixture
def space_file(tmp_path):
    path = tmp_path / "space.yaml"
    path.write_text(yaml.safe_dump(SPACE))
    return path


def study(out: Path, space_file: Path, trials: int = TRIALS) -> None:
    config = load_train_config(None, SMALL)
    tune(config, load_space(space_file, config), trials, out)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("uninterrupted")
    (folder / "space.yaml").write_text(yaml.safe_dump(SPACE))
    study(folder / "study", folder / "space.yaml")
    return folder / "study"


def wait_for_the_lock(folder: Path) -> None:
    """Wait for a killed process's child, which has its lock until it has become git."""
    for place in (folder, *folder.glob("trials/*/*")):
        while place.is_dir():
            try:
                with locked_folder(place):
                    break
            except AmulettError:
                time.sleep(0.01)


def finished(out: Path) -> dict[str, int]:
    return {str(path.relative_to(out)): path.stat().st_mtime_ns for path in out.glob("trials/*/*/finished.json")}


def test_killed_at_random_moments_it_comes_to_the_same_trials_and_does_none_twice(
    uninterrupted, space_file, tmp_path, faults
):
    out, generator, done = tmp_path / "study", np.random.default_rng(), {}
    killed = 0
    for _ in range(4):
        process = processes.Process(target=study, args=(out, space_file))
        process.start()
        target = len(done) + int(generator.integers(0, 2))
        while process.is_alive() and len(finished(out)) < target:
            time.sleep(0.005)
        time.sleep(generator.uniform(0.0, 0.3))
        process.kill()
        process.join()
        assert process.exitcode in (-signal.SIGKILL, 0)
        killed += process.exitcode == -signal.SIGKILL
        wait_for_the_lock(out)
        now = finished(out)
        assert done.items() <= now.items()
        done = now
    study(out, space_file)
    assert done.items() <= finished(out).items()
    for name in ("trials.json", "best.yaml"):
        assert (out / name).read_text() == (uninterrupted / name).read_text()
    faults("survived (kills)", killed)


def test_it_keeps_what_was_tried_and_the_best_recipe(uninterrupted):
    trials = json.loads((uninterrupted / "trials.json").read_text())
    assert [trial["number"] for trial in trials] == list(range(TRIALS))
    best = min(trials, key=lambda trial: trial["cost"])
    recipe = load_train_config(uninterrupted / "best.yaml")
    assert recipe.ppo.learning_rate == best["changes"]["ppo.learning_rate"]
    assert recipe.network.hidden == best["changes"]["network.hidden"]
    assert recipe.num_envs == 16
    result = json.loads((uninterrupted / f"trials/{best['number']:04d}/0/finished.json").read_text())
    assert best["costs"] == [result["best_cost"]]
    note = read_provenance(uninterrupted)
    assert (note.kind, note.seeds, set(note.config["space"])) == ("tune", [0, 0], set(SPACE))
    assert len({trial["changes"]["ppo.learning_rate"] for trial in trials}) == TRIALS


def test_workers_make_the_same_trials_and_a_batch_other_ones(space_file, tmp_path, monkeypatch):
    fork_processes(monkeypatch)
    monkeypatch.setattr(tuning, "RANDOM_TRIALS", 2)
    config = load_train_config(None, SMALL)
    space, trials = load_space(space_file, config), {}
    for name, how in {"one": {}, "two": {"workers": Workers(2)}, "all": {"workers": Workers(2), "batch": 3}}.items():
        tune(config, space, 5, tmp_path / name, seeds=2, **how)
        trials[name] = json.loads((tmp_path / name / "trials.json").read_text())
    assert [trial["number"] for trial in trials["all"]] == [0, 1, 2, 3, 4]
    assert trials["one"] == trials["two"]
    assert trials["one"][:3] == trials["all"][:3] and trials["one"][3:] != trials["all"][3:]
    with pytest.raises(AmulettError, match="batch was 3 and is 1"):
        tune(config, space, 5, tmp_path / "all", seeds=2)


def test_a_longer_study_begins_with_the_trials_of_a_shorter_one(uninterrupted, space_file, tmp_path):
    study(tmp_path / "study", space_file, 1)
    before = finished(tmp_path / "study")
    study(tmp_path / "study", space_file, 2)
    assert before.items() <= finished(tmp_path / "study").items()
    expected = json.loads((uninterrupted / "trials.json").read_text())
    assert json.loads((tmp_path / "study" / "trials.json").read_text()) == expected[:2]


def test_what_is_tried_depends_on_seed_number_and_costs_alone():
    config = load_train_config(None, SMALL)
    space = {key: value for key, value in _space(config).items() if key.startswith("ppo")}
    done: list[Trial] = []
    for number in range(12):
        changes = _propose(space, done, 3, number)
        done.append(Trial(number, changes, [abs(np.log10(changes["ppo.learning_rate"]) + 2)]))
    assert _propose(space, done, 3, 12) == _propose(space, done, 3, 12)
    assert _propose(space, done, 3, 12) != _propose(space, done, 4, 12)
    other = [Trial(trial.number, trial.changes, [-trial.costs[0]]) for trial in done]
    assert _propose(space, done, 3, 12) != _propose(space, other, 3, 12)
    later = [_propose(space, done, 3, number)["ppo.learning_rate"] for number in range(12, 32)]
    assert np.median(np.abs(np.log10(later) + 2)) < np.median([trial.costs[0] for trial in done[:8]])


def _space(config):
    from amulett_agents.tuning import Choice, Range

    return {key: (Choice if "choices" in value else Range).model_validate(value) for key, value in SPACE.items()}


def test_each_trial_is_run_with_each_seed(tmp_path):
    config = load_train_config(None, [*SMALL, "total_steps=512", "seed=5"])
    [trial] = tune(config, _space(config), 1, tmp_path / "study", seeds=2)
    runs = sorted((tmp_path / "study").glob("trials/0000/*/finished.json"))
    results = [json.loads(path.read_text()) for path in runs]
    assert [result["seed"] for result in results] == [5, 6]
    assert trial.costs == [result["best_cost"] for result in results]
    assert trial.cost == pytest.approx(np.mean(trial.costs))


def test_a_refused_recipe_is_a_trial_that_failed(tmp_path):
    config = load_train_config(None, [*SMALL, "total_steps=512"])
    path = tmp_path / "space.yaml"
    path.write_text("ppo.batch_size: {choices: [100, 200]}\n")  # neither divides a rollout
    trials = tune(config, load_space(path, config), 2, tmp_path / "study")
    assert best_of(trials) is None
    assert all("has to divide" in trial.error for trial in trials)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "names no key"),
        ("ppo.learing_rate: {low: 1.0e-4, high: 1.0e-3}", "did you mean 'learning_rate'"),
        ("ppo.gamma: {low: 0.9, high: 1.1}", r"'ppo\.gamma' is 1\.1"),
        ("ppo.gamma: {low: 0.9}", "high"),
        ("ppo.gamma: {low: 0.99, high: 0.9}", "low < high"),
        ("ppo.learning_rate: {low: 0.0, high: 1.0, log: true}", "above 0"),
        ("ppo.gamma: {choices: [0.9]}", "choices"),
        ("ppo.gamma.more: {choices: [0.9, 0.8]}", "'gamma' is a value"),
        ("ppo.gamma: 0.9", "gamma"),
    ],
)
def test_a_wrong_space_is_refused(text, message, tmp_path):
    (tmp_path / "space.yaml").write_text(text)
    with pytest.raises(AmulettError, match=message):
        load_space(tmp_path / "space.yaml", load_train_config(None, SMALL))


def test_the_shipped_space_fits_the_shipped_recipe():
    configs = Path(__file__).parents[2] / "configs"
    assert load_space(configs / "tune.yaml", load_train_config(configs / "ppo.yaml"))


def test_another_study_is_left_alone(uninterrupted, space_file):
    config = load_train_config(None, [*SMALL, "ppo.gamma=0.9"])
    with pytest.raises(AmulettError, match=r"holds another study.*ppo\.gamma was 0\.99 and is 0\.9"):
        tune(config, load_space(space_file, config), TRIALS, uninterrupted)
    limited = load_train_config(None, [*SMALL, "max_seconds=10"])
    with pytest.raises(AmulettError, match="max_seconds"):
        tune(limited, load_space(space_file, limited), TRIALS, uninterrupted)


def command(words: list[str]) -> None:
    raise SystemExit(main(words))


def test_the_command_stops_in_good_order_goes_on_and_prints_a_table(uninterrupted, space_file, tmp_path, capsys):
    out = tmp_path / "study"
    words = ["tune", "--space", str(space_file), "--trials", str(TRIALS), "--out", str(out), "--set", *SMALL]
    process = processes.Process(target=command, args=(words,))
    process.start()
    while process.is_alive() and not finished(out):
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGTERM)
    process.join()
    assert process.exitcode in (130, -signal.SIGTERM)  # between two runs nobody listens; nothing is lost either way
    before = finished(out)
    assert 0 < len(before) < TRIALS
    wait_for_the_lock(out)
    assert main(words) == 0
    assert before.items() <= finished(out).items()
    assert (out / "trials.json").read_text() == (uninterrupted / "trials.json").read_text()
    printed = capsys.readouterr().out
    assert f"best recipe is in {out / 'best.yaml'}" in " ".join(printed.split())
    header = next(line for line in printed.splitlines() if line.lstrip().startswith("trial  "))
    assert sorted(header.split()) == sorted(["trial", "cost", *SPACE])


def test_it_is_done_again_with_the_same_numbers_without_its_files(space_file, tmp_path, capsys):
    """Also a repetition is repeated."""
    words = ["tune", "--space", str(space_file), "--trials", "1", "--out", str(tmp_path / "study"), "--set", *SMALL]
    assert main(words) == 0
    space_file.unlink()
    assert main(["rerun", str(tmp_path / "study"), "--out", str(tmp_path / "again")]) == 0
    assert main(["rerun", str(tmp_path / "again"), "--out", str(tmp_path / "third")]) == 0
    assert capsys.readouterr().out.count("numbers are the same") == 2


def test_bundles_that_trials_start_from_are_kept(tmp_path, monkeypatch, capsys):
    small = [*SMALL, "total_steps=512", "network.features=false"]
    for name, seed in (("one", 1), ("two", 2)):
        save_policy(make_model(load_train_config(None, [*small, f"seed={seed}"])), tmp_path / name)
    (tmp_path / "space.yaml").write_text("{network.start: {choices: [two, one, ./two]}}")
    (tmp_path / "recipe.yaml").write_text(yaml.safe_dump({"network": {"start": "one"}}))
    words = ["tune", "--config", str(tmp_path / "recipe.yaml"), "--space", str(tmp_path / "space.yaml")]
    words += ["--out", str(tmp_path / "study"), "--set", *small]
    monkeypatch.chdir(tmp_path)
    assert main([*words, "--trials", "2"]) == 0
    kept = tmp_path / "study" / FOLDER
    assert [read_bundle(path).provenance["seed"] for path in sorted(kept.iterdir())] == [1, 2]
    shutil.rmtree(kept)  # as if killed before they were written
    monkeypatch.chdir("/")
    with pytest.raises(AmulettError, match=r"another study: kept\.one"):
        tune(*stored_study(read_provenance(tmp_path / "study").config), 2, tmp_path / "study")
    monkeypatch.chdir(tmp_path)
    assert main([*words, "--trials", "2"]) == 0
    for name in ("one", "two"):
        shutil.rmtree(tmp_path / name)
    monkeypatch.chdir("/")
    assert main([*words, "--trials", "4"]) == 0
    trials = json.loads((tmp_path / "study" / "trials.json").read_text())
    assert len({trial["changes"]["network.start"] for trial in trials if trial["costs"]}) > 1
    recipe = load_train_config(tmp_path / "study" / "best.yaml")
    assert Path(recipe.network.start).parent == kept
    (tmp_path / "space.yaml").unlink(), (tmp_path / "recipe.yaml").unlink()
    assert main(["rerun", str(tmp_path / "study"), "--out", str(tmp_path / "again")]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    (kept / "0" / "env.json").open("a").write(" ")
    assert main(["rerun", str(tmp_path / "study"), "--out", str(tmp_path / "third")]) == 2
    assert "kept copy of policy 'one', '" in capsys.readouterr().err


@pytest.mark.parametrize("content", [{}, {"config": {}, "space": 3}, {"config": {"gamma": 1}, "space": {}}])
def test_damaged_settings_of_a_study_are_refused(content):
    with pytest.raises(AmulettError, match="study's"):
        stored_study(content)
