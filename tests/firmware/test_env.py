"""The environment whose loop is a firmware's equals the one whose loop is the simulation's."""

from __future__ import annotations

import gc
import inspect
import json
import weakref
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from firmware.boards import hex_or_skip
from gymnasium.utils.env_checker import check_env

from amulett_gym.envs.action import tension_to_action
from amulett_gym.envs.episodes import Episodes
from amulett_gym.envs.single import TensionEnv
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import HardwareEnv
from amulett_gym.firmware import env as env_module
from amulett_gym.firmware.description import read_description
from amulett_gym.firmware.loops import Sample
from amulett_gym.firmware.protocol import MODES, REASONS, BoardError, Report


def play(env: Any, action: Any, steps: int, **reset: Any) -> list[Any]:
    """Return observations, rewards and infos without the board's part."""
    observation, info = env.reset(**reset)
    rows = [(observation.tolist(), without_board(info))]
    for _ in range(steps):
        observation, reward, terminated, _, info = env.step(action)
        rows.append((observation.tolist(), reward, terminated, without_board(info)))
    return rows


def without_board(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info without the board's part."""
    return {key: value for key, value in info.items() if not key.startswith("board_")}


@pytest.mark.parametrize(
    ("law", "profile", "split"),
    [
        *(("eq6", "testbed", "shifted"), ("constant:8", "testbed", "train"), ("eq6", "simulation", "train")),
        *(("feedforward-feedback/eq6", "testbed", "shifted"), ("feedback-linearisation/eq6", "testbed", "train")),
    ],
)
def test_the_host_equals_the_simulation_to_the_last_bit(firmware, law: str, profile: str, split: str):
    made = firmware(law, profile)
    keywords = {"suite": "mixed", "split": split}
    env = HardwareEnv(made.folder, **keywords)
    other = TensionEnv(**{**read_description(made.folder).keywords, **keywords})
    tension = 8.0 if law == "constant:8" else 10.0
    action = np.atleast_1d(tension_to_action(tension, other.tension_range)).astype(np.float32)
    for seed in range(3):
        assert play(env, action, 40, seed=seed) == play(other, action, 40, seed=seed)
    assert env.scenario == other.scenario
    env.close()


def test_late_ticks_equal_the_simulation(firmware):
    made = firmware("eq6")
    scenario = {"moves": [{"time": 0.1, "angle_deg": 60.0}], "device": {"late_probability": 0.3}}
    env, other = HardwareEnv(made.folder), TensionEnv(**read_description(made.folder).keywords)
    options = {"scenario": scenario}
    action = np.zeros(1, dtype=np.float32)
    assert play(env, action, 40, seed=1, options=options) == play(other, action, 40, seed=1, options=options)
    env.close()


def test_a_reward_of_ones_own_gets_the_same_costs(firmware):
    made = firmware("eq6")

    def reward(costs: dict[str, Any], terms: dict[str, Any]) -> Any:
        return -costs["position"] - 0.01 * costs["effort"]

    env = HardwareEnv(made.folder, reward_fn=reward)
    other = TensionEnv(**read_description(made.folder).keywords, reward_fn=reward)
    assert play(env, np.zeros(1), 10, seed=3) == play(other, np.zeros(1), 10, seed=3)
    env.close()


@pytest.mark.filterwarnings("ignore:.*not having a spec")
@pytest.mark.parametrize("transport", ["host", "chip"])
def test_it_conforms_to_gymnasium(firmware, transport: str, tmp_path: Path):
    if transport == "chip":
        hex_or_skip(tmp_path)
    with closing(HardwareEnv(firmware("eq6").folder, transport, render_mode="rgb_array")) as env:
        check_env(env, skip_render_check=False)


@pytest.mark.parametrize("transport", ["host", "chip"])
def test_a_seed_chooses_the_episodes(firmware, transport: str, tmp_path: Path):
    if transport == "chip":
        hex_or_skip(tmp_path)

    def episodes(seed: int) -> list[Any]:
        seen = [env.reset(seed=seed)[0].tolist()]
        for _ in range(2):
            observation, _, _, _, info = env.step(np.zeros(1))
            seen.append((observation.tolist(), info))
        return [*seen, env.reset()[0].tolist()]

    with closing(HardwareEnv(firmware("eq6").folder, transport, suite="mixed")) as env:
        first, other, again = episodes(0), episodes(1), episodes(0)
    assert first == again
    assert first[0] != other[0]
    assert first[-1] not in (first[0], other[-1])


@pytest.mark.parametrize("transport", ["host", "host-float", "chip"])
def test_it_can_be_closed_twice_and_the_error_of_a_block_is_kept(firmware, transport: str, tmp_path: Path):
    if transport == "chip":
        hex_or_skip(tmp_path)
    with pytest.raises(ZeroDivisionError), HardwareEnv(firmware("eq6").folder, transport) as env:
        env.reset(seed=0)
        raise ZeroDivisionError
    env.close()


def test_the_simulation_is_made_once_and_no_board_is_left_by_a_wrong_keyword(firmware, monkeypatch):
    made, opened = [], []
    make, open_loop = Episodes.__init__, env_module.open_loop
    monkeypatch.setattr(Episodes, "__init__", lambda self, *args: made.append(1) or make(self, *args))
    monkeypatch.setattr(env_module, "open_loop", lambda *place: opened.append(1) or open_loop(*place))
    HardwareEnv(firmware("eq6").folder).close()
    assert (len(made), len(opened)) == (1, 1)
    for wrong in ({"suite": "none"}, {"render_mode": "x"}, {"nothing": 1}):
        with pytest.raises(AmulettError):
            HardwareEnv(firmware("eq6").folder, **wrong)
    assert len(opened) == 1


def test_what_it_holds_is_freed_with_it(firmware):
    env = HardwareEnv(firmware("eq6").folder)
    env.reset(seed=0)
    env.step(np.zeros(1, dtype=np.float32))
    held = weakref.ref(env.episodes), weakref.ref(env.loop)
    gc.disable()
    try:
        del env
        assert [one() for one in held] == [None, None]
    finally:
        gc.enable()


def test_the_info_has_the_boards_state(firmware):
    env = HardwareEnv(firmware("eq6").folder)
    env.reset(seed=0)
    info = env.step(np.zeros(1))[-1]
    assert {key: value for key, value in info.items() if key.startswith("board_")} == {
        "board_status": 0,
        "board_mode": MODES.index("lock step"),
        "board_reason": REASONS.index(""),
        "board_cycles": 0,
    }
    env.close()


def test_a_step_before_the_reset_raises_as_ever(firmware):
    env = HardwareEnv(firmware("eq6").folder)
    with pytest.raises(Exception, match="call reset"):
        env.step(np.zeros(1))
    env.close()


def test_what_the_firmware_fixes_cannot_be_set(firmware):
    for key, value in (("control", "torque"), ("profile", "simulation"), ("agent_period", 0.04)):
        with pytest.raises(AmulettError, match=f"'{key}' is that of the firmware in .*; export another firmware"):
            HardwareEnv(firmware("eq6").folder, **{key: value})
    with pytest.raises(AmulettError, match="integrals, which a firmware does not report"):
        HardwareEnv(firmware("eq6").folder, privileged=True)


def test_unknown_transports_are_refused(firmware):
    with pytest.raises(AmulettError, match="unknown transport 'chips'; .*; did you mean 'chip'"):
        HardwareEnv(firmware("eq6").folder, "chips")
    with pytest.raises(AmulettError, match="'serial:' names no port"):
        HardwareEnv(firmware("eq6").folder, "serial:")


def test_a_snapshot_is_refused(firmware):
    env = HardwareEnv(firmware("eq6").folder)
    with pytest.raises(AmulettError, match="a firmware's memory is not known"):
        env.get_state()
    env.close()


def test_the_signature_is_the_environments_own():
    assert list(inspect.signature(HardwareEnv).parameters) == ["folder", "transport", "keywords"]


@pytest.mark.parametrize("content", ["[]", "{", '{"law": 3}', "null"])
def test_a_description_that_is_none_is_refused(tmp_path: Path, content: str):
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(AmulettError, match=r"manifest\.json' (is not valid JSON|has to have the keys law, control)"):
        read_description(tmp_path)


def test_a_hostile_description_is_refused(firmware, tmp_path: Path):
    content = json.loads((firmware("eq6").folder / "manifest.json").read_text())
    wrong = ("control", "decentralized; rm"), ("profile", {"plant": 1}), ("keywords", {"agent_period": -1})
    for key, value in wrong:
        (tmp_path / "manifest.json").write_text(json.dumps({**content, key: value}))
        with pytest.raises(AmulettError):
            read_description(tmp_path)


class LettingGo:
    """A loop whose board stops after some ticks."""

    label = "a board that stops"
    retries = 0

    def __init__(self, inner: Any, ticks: int) -> None:
        self.inner, self.left = inner, ticks

    def start(self, begin: dict[str, Any]) -> None:
        self.inner.start(begin)

    def tick(self, sample: Sample) -> Report:
        self.left -= 1
        if self.left < 0:
            raise BoardError("the board on nowhere is gone")
        return self.inner.tick(sample)

    def measure(self) -> None:
        return None

    def close(self) -> None:
        self.inner.close()


def test_a_board_that_is_gone_ends_the_step_and_a_reset_goes_on(firmware):
    env = HardwareEnv(firmware("eq6").folder)
    expected = play(env, np.zeros(1), 5, seed=2)
    inner = env.episodes.loop
    env.episodes.loop = LettingGo(inner, 13)
    env.reset(seed=2)
    env.step(np.zeros(1))
    with pytest.raises(BoardError, match="^the board on nowhere is gone$"):
        env.step(np.zeros(1))
    env.episodes.loop = inner
    assert play(env, np.zeros(1), 5, seed=2) == expected
    env.close()


def test_the_chip_follows_the_simulation(firmware, tmp_path: Path):
    hex_or_skip(tmp_path)
    made = firmware("eq6")
    env, other = HardwareEnv(made.folder, "chip"), TensionEnv(**read_description(made.folder).keywords)
    found, expected = (play(each, np.zeros(1), 15, seed=4) for each in (env, other))
    np.testing.assert_allclose(found[-1][0], expected[-1][0], atol=2e-3)
    measured = env.loop.measure()
    assert measured.ticks == 15 * 8
    assert measured.most < 0.8 * 40_000  # cycles of a control period, with 20 % to spare
    assert measured.memory < 6000
    assert measured.flash < 200_000
    env.close()


def test_the_chip_has_to_have_the_folders_firmware(firmware, tmp_path: Path):
    hex_or_skip(tmp_path)
    from amulett_gym.firmware.board import Board
    from amulett_gym.firmware.chip import Chip
    from amulett_gym.firmware.loops import BoardLoop

    chip = Chip(tmp_path / "build" / "firmware.hex")
    with pytest.raises(BoardError, match="has the firmware 12345678, .* program the board"):
        BoardLoop(Board(chip), firmware("eq6").folder)
