"""Laws of the user's own: functions, given in Python or by the name of their file."""

from __future__ import annotations

import os

import gymnasium as gym
import numpy as np
import pytest

import amulett_gym
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol, evaluate
from amulett_gym.laws.contenders import Own, parse_contender, python_file
from amulett_gym.laws.own import load_own
from amulett_gym.laws.policies import load_policy
from amulett_gym.profile import load_profile

LAW = """
import numpy as np
from neighbour import LOWEST

def softer(observations):
    return np.maximum(1.0 - 4.0 * np.abs(observations[:, 0]), LOWEST)

def broken(observations):
    return observations[:, 99]

def pair(observations, more): ...
softer.env_keywords = {"agent_period": 0.04}
NUMBER = 3

class Counting:
    def reset(self, count): self.steps, self.count = 0, count
    def __call__(self, observations):
        assert len(observations) == self.count
        self.steps += 1
        return np.full(self.count, -1.0 if self.steps <= 5 else 1.0)

counting = Counting()
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "neighbour.py").write_text("LOWEST = -0.5\n")
    path = tmp_path / "mylaw.py"
    path.write_text(LAW)
    return path


@pytest.fixture
def env():
    with gym.make(amulett_gym.ENV_IDS[0]) as env:
        env.reset(seed=0)
        yield env


def test_a_function_of_a_file_is_a_contender_with_what_its_environment_needs(file):
    own = load_own(f"{file}:softer")
    assert (own.name, own.env_keywords) == (f"{file}:softer", {"agent_period": 0.04})
    observations = np.zeros((3, 13), dtype=np.float32)
    observations[:, 0] = [0.0, 0.25, 1.0]
    np.testing.assert_allclose(own.act(observations), [1.0, 0.0, -0.5])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mylaw.py:sofetr", r"unknown function of '.*mylaw\.py' 'sofetr'.*did you mean 'softer'"),
        ("mylaw.py:NUMBER", "unknown function of .* 'NUMBER'"),
        ("mylaw.py:", r"names no function of a Python file; write .*mylaw\.py:function, .*:softer or .*:broken$"),
        ("mylaw.py:pair", r"takes \(observations, more\); it has to take one argument"),
        ("other.py:softer", r"cannot read Python file '.*other\.py': there is no such file"),
        ("wrong.py:softer", r"'.*wrong\.py' raised ZeroDivisionError in line 2: division by zero"),
        ("typo.py:softer", r"'.*typo\.py' raised SyntaxError in line 1"),
        ("leaves.py:softer", r"'.*leaves\.py' raised SystemExit in line 1: 3"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(file, name, message):
    for other, text in (("wrong", "\n1 / 0"), ("typo", "def softer(:"), ("leaves", "raise SystemExit(3)")):
        (file.parent / f"{other}.py").write_text(text)
    with pytest.raises(AmulettError, match=message):
        load_own(f"{file.parent}/{name}")


@pytest.mark.parametrize(
    ("text", "ending"),
    [
        ("def one(seen, gain=2): ...\ndef pair(a, b): ...\ndef _own(a): ...\n", "; did you mean '{0}:one'?"),
        ("def one(*seen): ...\ndef two(seen): ...\n", ", {0}:one or {0}:two"),
        ("def none(): ...\ndef more(seen, *, gain): ...\n", ""),
        ("def wrong(:", ""),
        (None, ""),
    ],
)
def test_a_file_without_a_function_names_the_form_and_its_functions_and_is_not_run(text, ending, tmp_path, capsys):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(f"raise AssertionError('this file ran')\n{text}")
    for command in (["evaluate", "--policies"], ["simulate", "--law"]):
        assert main([*command, str(path)]) == 2
        message = f"'{path}' names no function of a Python file; write {path}:function{ending.format(path)}\n"
        assert capsys.readouterr().err.endswith(message)


def test_an_error_in_a_function_names_its_file_and_line(file, env):
    policy = load_policy(load_own(f"{file}:broken").act, env)
    with pytest.raises(AmulettError, match=r"mylaw\.py:broken' raised IndexError in line 9: index 99 is out of bounds"):
        policy(env.observation_space.sample())


def test_an_edit_within_a_second_counts_even_if_the_length_stays(tmp_path):
    path = tmp_path / "quick.py"
    for value in ("0.25", "0.75"):
        path.write_text(f"def act(observations): return [{value}] * len(observations)\n")
        os.utime(path, (1e9, 1e9))
        assert load_own(f"{path}:act").act(np.zeros((2, 13))) == [float(value)] * 2


def test_a_name_alone_runs_no_file(file, env):
    """Names stand in bundles, recipes and notes, too: only the loader of the user's own word runs code."""
    file.write_text("raise AssertionError('this file ran')")
    assert python_file(f"{file}:softer") == file
    assert python_file("constant:5") is python_file(str(file)) is python_file("eq6") is None
    for take in (parse_contender, lambda name: load_policy(name, env), lambda name: evaluate([name], episodes=1)):
        with pytest.raises(AmulettError, match="is code; evaluate, simulate and play run it"):
            take(f"{file}:softer")


def test_a_callable_is_a_policy_of_one_or_many(env):
    policy = load_policy(lambda observations: observations[:, 0], env)
    one = env.observation_space.sample()
    assert policy(one).shape == (1,) and policy(one)[0] == one[0]
    assert policy(np.stack([one, one])).shape == (2, 1)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda observations: observations, r"returned actions of shape \(1, 13\) .* has to be \(1, 1\) or \(1,\)"),
        (lambda observations: None, "returned None; it has to return 1 numbers"),
        (lambda observations: "tight", "returned 'tight'; it has to return 1 numbers"),
        (lambda observations: [np.nan], "returned NaN"),
    ],
)
def test_wrong_actions_are_refused(env, act, message):
    with pytest.raises(AmulettError, match=message):
        load_policy(act, env)(env.observation_space.sample())


def test_an_own_law_competes_as_the_named_law_that_it_imitates():
    constant = Own("mine", act=lambda observations: np.full(len(observations), 2.0 * (8.0 - 4.0) / 11.0 - 1.0))
    results = evaluate([constant, "constant:8"], episodes=3, duration=2.0)
    for metric, values in results.values["mine"].items():
        np.testing.assert_array_equal(values, results.values["constant:8"][metric])


def test_a_law_that_remembers_forgets_between_runs(file):
    """It pulls with 4 N for five steps, then with 15 N; the run that measures pushes begins anew."""
    own = load_own(f"{file}:counting")
    results = evaluate([own], episodes=2, duration=1.0)
    assert own.act.reset.__self__.steps == 50  # of the push run alone
    alone = evaluate([load_own(f"{file}:counting")], suite="hold-push", episodes=2, duration=1.0)
    pushed = [run.values[own.name]["push_deflection"] for run in (results, alone)]
    np.testing.assert_array_equal(*pushed)


def test_an_own_law_can_be_recorded(file):
    protocol = Protocol(load_profile("testbed"), duration=0.4)
    setpoint = record_episode(load_own(f"{file}:counting"), protocol).trajectory["tension_setpoint"]
    assert setpoint[round(0.1 / 0.0025)] == pytest.approx(4.0) and setpoint[-1] == pytest.approx(15.0)
