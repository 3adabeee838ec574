"""Training with several seeds: each has its own run, as if it was trained alone, with any number of workers."""

import json
from unittest.mock import Mock

import pytest
from helpers import SMALL_RECIPE, fork_processes

pytest.importorskip("stable_baselines3")

from amulett_agents.config import load_train_config
from amulett_agents.training import SEEDS, resume_seeds, train, train_seeds
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.workers.call import Workers

CONFIG = load_train_config(None, SMALL_RECIPE)


def _weights(folder):
    return {name: (folder / name / "weights.safetensors").read_bytes() for name in ("best", "last")}


def _costs(folder):
    rows = (folder / "evaluations.csv").read_text().splitlines()
    return [row.split(",")[:1] + row.split(",")[2:] for row in rows]  # without seconds


def test_a_seed_is_trained_as_alone_by_any_number_of_workers(tmp_path, monkeypatch):
    fork_processes(monkeypatch)
    alone = train(CONFIG.model_copy(update={"seed": 5}), tmp_path / "alone", progress=False, command=["amulett"])
    for name, workers in (("one", Workers()), ("two", Workers(2))):
        found = train_seeds(CONFIG, [3, 5], tmp_path / name, workers, progress=False, command=["amulett"])
        assert [result.seed for result in found] == [3, 5] and found[1].best_cost == alone.best_cost
        assert _weights(tmp_path / name / "seed-5") == _weights(tmp_path / "alone")
        assert _costs(tmp_path / name / "seed-5") == _costs(tmp_path / "alone")
        assert (tmp_path / name / "seed-5" / "config.yaml").read_text() == (
            tmp_path / "alone" / "config.yaml"
        ).read_text()
    assert _weights(tmp_path / "one" / "seed-3") == _weights(tmp_path / "two" / "seed-3")
    assert _weights(tmp_path / "one" / "seed-3") != _weights(tmp_path / "one" / "seed-5")


def test_the_command_trains_prints_a_table_and_resumes(tmp_path, monkeypatch, capsys):
    fork_processes(monkeypatch)
    out = tmp_path / "runs"
    words = ["train", "--set", *SMALL_RECIPE, "--seeds", "0", "1", "--out", str(out)]
    assert main([*words, "--workers", "2"]) == 0
    printed = capsys.readouterr().out
    assert "best: mean" in printed and {path.name for path in out.glob("seed-*")} == {"seed-0", "seed-1"}
    assert main(words) == 2
    assert "holds training runs already" in capsys.readouterr().err
    assert main(["rerun", str(out), "--out", str(tmp_path / "again")]) == 0
    weights = _weights(out / "seed-1")
    for path in sorted((out / "seed-1").rglob("*"), reverse=True):  # as if it was killed before this seed was begun
        path.unlink() if path.is_file() else path.rmdir()
    finished = (out / "seed-0" / "finished.json").read_bytes()
    capsys.readouterr()
    assert main(["train", "--resume", str(out), "--json"]) == 0
    assert [result["seed"] for result in json.loads(capsys.readouterr().out)] == [0, 1]
    assert _weights(out / "seed-1") == weights and (out / "seed-0" / "finished.json").read_bytes() == finished


def test_overwriting_leaves_no_run_of_the_earlier_recipe(tmp_path, monkeypatch):
    out, killed = tmp_path / "runs", RuntimeError("killed")
    train_seeds(CONFIG, [0, 1, 2], out, progress=False)
    other = load_train_config(None, [*SMALL_RECIPE, "ppo.gamma=0.9"])
    with monkeypatch.context() as patch:
        patch.setattr("amulett_agents.training.begin", Mock(side_effect=killed))
        with pytest.raises(RuntimeError, match="killed"):
            train_seeds(other, [0, 1], out, progress=False, overwrite=True)
    assert list(out.glob("seed-*")) == []
    found = resume_seeds(out, progress=False)
    assert [result.seed for result in found] == [0, 1]
    assert load_train_config(out / "seed-1" / "config.yaml").ppo.gamma == 0.9


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--seeds", "1", "1", "--out", "x"], "seeds are [1, 1]; they have to differ"),
        (["--seeds", "-1", "--out", "x"], "seeds are [-1]; they have to differ and be from 0"),
        (["--seeds", "1", "--seed", "1", "--out", "x"], "--seed and --seeds are both given"),
        (["--seeds", "1", "--resume", "x"], "leave out --seeds"),
        (["--workers", "2", "--out", "x"], "--workers is for runs with several seeds"),
        (["--seeds", "1", "2", "--workers", "0", "--out", "x"], "--workers is 0"),
        (["--seeds", "1", "2"], "train needs --out DIR"),
        (["--seeds", "1", "--set", "ppo.batch_size=7", "--out", "x"], "ppo.batch_size"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *words]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_file_of_seeds_is_named(tmp_path):
    (tmp_path / SEEDS).write_text("{}")
    with pytest.raises(AmulettError, match=r"seeds.json' is damaged"):
        resume_seeds(tmp_path)
