"""What workers do ahead is in the files as the stages themselves would have written it."""

import pytest
from helpers import fork_processes, make_bundle

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import Protocol
from amulett_gym.laws.contenders import Contender, Own, parse_contender
from amulett_gym.profile import load_profile
from amulett_gym.studies.benchmark.ahead import play_ahead
from amulett_gym.studies.benchmark.episodes import Play
from amulett_gym.workers.call import ALONE, Workers

PROTOCOL = Protocol(load_profile("testbed"), "steps", "held-out", episodes=2, duration=1.0)


def _plays(folder, bundle):
    contenders = [parse_contender("eq6"), parse_contender("constant:8"), parse_contender(str(bundle))]
    own = Own("mine", act=lambda observations: observations[:, :1])
    return [Play(folder, f"{k}", PROTOCOL, each, True) for k, each in enumerate([*contenders, own])]


def test_episodes_are_kept_as_if_they_were_played_here(tmp_path, monkeypatch):
    fork_processes(monkeypatch)
    bundle = make_bundle(tmp_path / "bundle")
    here, there = _plays(tmp_path / "here", bundle), _plays(tmp_path / "there", bundle)
    play_ahead(there, ALONE, "plays")
    assert not (tmp_path / "there").exists()
    play_ahead(there, Workers(2), "plays")
    for play in here:
        play.run()
    files = [sorted(play.path.parent.iterdir()) for play in (here[0], there[0])]
    assert len(files[1]) == 3  # none of a callable
    assert [path.name for path in files[0]] == [path.name for path in files[1]]
    assert [path.read_bytes() for path in files[0]] == [path.read_bytes() for path in files[1]]
    times = [path.stat().st_mtime_ns for path in files[1]]
    play_ahead(there, Workers(2), "plays")
    assert [path.stat().st_mtime_ns for path in files[1]] == times


def test_an_error_names_what_was_played(tmp_path, monkeypatch):
    fork_processes(monkeypatch)
    wrong = Contender("wrong", {"agent_period": -1.0}, "constant:8")
    plays = [Play(tmp_path, name, PROTOCOL, wrong) for name in ("a", "b")]
    with pytest.raises(AmulettError, match=r"^[ab] on .*steps/[ab]\.npz: "):
        play_ahead(plays, Workers(2), "plays")
