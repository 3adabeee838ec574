"""Pictures and videos of the arm: with a display or without one, and what they show."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import warnings
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from helpers import keep_network
from PIL import Image

import amulett_gym
from amulett_gym.cli import play
from amulett_gym.envs.rendering.frame import STRIP_SECONDS, frame_of
from amulett_gym.envs.rendering.window import Renderer
from amulett_gym.envs.transition import OBSERVATIONS
from amulett_gym.errors import AmulettError
from amulett_gym.model.spring import build_tables
from amulett_gym.notebook import png_of, register
from amulett_gym.profile import load_profile
from amulett_gym.simulation.batch import Simulation

SCALING = amulett_gym.ENV_IDS[0]
SHAPE = (560, 720, 3)
ACTION = np.zeros(1, dtype=np.float32)
RED = np.array([204, 36, 48])
STRING_AT = (192, 150)  # row and column of a point on the biceps' string
NEEDS_FFMPEG = pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None, reason="needs imageio-ffmpeg")


@pytest.fixture
def env():
    env = gym.make(SCALING, suite="paper-step", render_mode="rgb_array")
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture
def rest(env):
    return frame_of(env.unwrapped.episodes, 0)


def picture(*frames):
    renderer = Renderer("rgb_array", fps=50)
    return [renderer.draw(frame) for frame in frames][-1]


def red_pixels(image):
    return int((np.abs(image.astype(int) - RED).max(axis=-1) < 8).sum())


def run_without_display(script, cwd=None):
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")
    variables = {name: value for name, value in os.environ.items() if name not in hidden}
    return subprocess.run(
        [sys.executable, "-c", script], env=variables, cwd=cwd, capture_output=True, text=True, check=False
    )


def play_command(*words):
    parser = argparse.ArgumentParser()
    play.add_arguments(parser)
    return play.run(parser.parse_args([str(word) for word in words]))


# What a picture shows


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
def test_a_picture_is_an_array_of_bytes_that_changes_as_the_arm_moves(env_id):
    suite = "assembly" if env_id == amulett_gym.WORN_ID else "paper-step"
    with gym.make(env_id, suite=suite, render_mode="rgb_array") as env:
        env.reset(seed=0)
        before = env.render()
        for _ in range(60):
            env.step(np.full(env.action_space.shape, ACTION[0]))
        after = env.render()
    for image in (before, after):
        assert image.shape == SHAPE
        assert image.dtype == np.uint8
    assert (before != after).any(axis=-1).sum() > 1000


def test_a_frame_is_the_truth_of_the_state():
    with gym.make(SCALING, suite="hold-push", profile="simulation") as env:
        env.reset(seed=1)
        for _ in range(90):
            info = env.step(ACTION)[-1]
        frame = frame_of(env.unwrapped.episodes, 0)
    assert frame.time == pytest.approx(info["time"])
    assert np.degrees(frame.joint_angle) == pytest.approx(info["joint_angle"])
    for name in ("force_biceps", "force_triceps", "tension_setpoint", "push_torque", "contact_torque"):
        assert getattr(frame, name) == info[name]
    assert frame.joint_stiffness == info["joint_stiffness"]
    assert 0 < frame.joint_stiffness < frame.max_stiffness


def test_the_stiffness_of_a_frame_ends_where_both_springs_are_steepest():
    simulation = Simulation(load_profile("testbed"))
    tables = build_tables(simulation.profile.spring)
    radius = simulation.profile.plant.joint_pulley_radius
    steepest = max(tables.stiffness_at(stretch) for stretch in np.linspace(0.0, tables.max_deflection, 2000))
    assert simulation.max_stiffness == pytest.approx(2 * radius**2 * steepest, rel=1e-3)


def test_a_string_of_a_varied_device_is_drawn_as_stretched_as_it_is():
    with gym.make(SCALING) as env:
        env.reset(options={"scenario": {"initial_angle_deg": 60.0, "device": {"pulley_biceps": 1.2}}})
        frame = frame_of(env.unwrapped.episodes, 0)
    radius = 1.2 * frame.drive_radius
    stretch = frame.drive_biceps * radius - frame.joint_angle * frame.joint_radius
    assert frame.deflection_biceps == pytest.approx(stretch, rel=1e-6) and stretch > 0


def test_equal_frames_give_equal_pictures(rest):
    np.testing.assert_array_equal(picture(rest), picture(rest))


@pytest.mark.parametrize(
    "change",
    [
        {"joint_angle": 0.3},
        {"joint_angle": -2.5},
        {"joint_stiffness": 3.0},
        {"setpoint": 0.3},
        {"time": 0.02},
        {"drive_biceps": 1.0},
        {"agonist": -1.0},
        {"agonist": None, "tension_setpoint": None},
        {"force_triceps": 0.0, "deflection_triceps": -0.002},
        {"obstacle_angle": 0.5, "obstacle_side": 1.0},
        {"payload_mass": 0.3},
        {"push_torque": 0.1},
        {"push_torque": -0.1},
        {"failure": "joint angle limit"},
    ],
)
def test_every_part_of_a_frame_shows(rest, change):
    rest = replace(rest, agonist=1.0)
    assert (picture(rest) != picture(replace(rest, **change))).any()


def test_external_torques_are_drawn_in_red(rest):
    blocked = replace(rest, joint_angle=0.6, obstacle_angle=0.6, obstacle_side=1.0)
    assert red_pixels(picture(blocked)) == 0
    assert red_pixels(picture(replace(blocked, contact_torque=-0.1))) > 50
    assert red_pixels(picture(replace(blocked, push_torque=0.1))) > 50


def test_a_longer_arrow_means_a_stronger_push(rest):
    weak, strong = (red_pixels(picture(replace(rest, push_torque=torque))) for torque in (0.05, 0.45))
    assert strong > weak + 100


def test_a_string_grows_darker_with_its_tension(rest):
    forces = np.linspace(0.05, 1.0, 8) * rest.max_force
    brightness = [int(picture(replace(rest, force_biceps=force))[STRING_AT].sum()) for force in forces]
    assert brightness == sorted(brightness, reverse=True)
    assert len(set(brightness)) == len(brightness)


def test_an_obstacle_and_a_payload_of_the_scenario_are_drawn(env):
    scenario = {"obstacle": {"angle_deg": 30.0, "stiffness": 2.0}, "payload": {"mass": 0.1, "arm": 0.1}}
    env.reset(options={"scenario": scenario})
    frame = frame_of(env.unwrapped.episodes, 0)
    assert np.degrees(frame.obstacle_angle) == pytest.approx(30.0)
    assert (frame.obstacle_side, frame.payload_mass) == (1.0, 0.1)
    env.reset(options={"scenario": {}})
    assert frame_of(env.unwrapped.episodes, 0).obstacle_angle is None


def test_position_only_control_has_no_tension_setpoint():
    with gym.make(SCALING, control="position-only") as env:
        env.reset(seed=0)
        frame = frame_of(env.unwrapped.episodes, 0)
    assert frame.tension_setpoint is None
    assert frame.agonist is None


# The strip of the last seconds


def test_a_reset_clears_the_strip(env):
    fresh = env.render()
    for _ in range(40):
        env.step(ACTION)
        env.render()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), fresh)


def test_an_episode_that_restarts_by_itself_clears_the_strip(rest):
    later = [replace(rest, time=0.02 * k, joint_angle=0.01 * k) for k in range(50)]
    np.testing.assert_array_equal(picture(*later, rest), picture(rest))


def test_the_strip_forgets_what_left_it(rest):
    frames = [replace(rest, time=0.2 * k, joint_angle=np.sin(0.2 * k)) for k in range(round(12 * STRIP_SECONDS))]
    recent = [frame for frame in frames if frame.time > frames[-1].time - STRIP_SECONDS - 0.25]
    np.testing.assert_array_equal(picture(*frames), picture(*recent))


def test_a_vector_environment_draws_each_of_its_arms():
    envs = gym.make_vec(SCALING, num_envs=10, render_mode="rgb_array")
    envs.reset(seed=3)
    pictures = envs.render()
    assert isinstance(pictures, tuple)
    assert [image.shape for image in pictures] == [SHAPE] * 10
    envs.close()
    with gym.make(SCALING, render_mode="rgb_array") as single:
        single.reset(seed=3 + 9)
        np.testing.assert_array_equal(single.render(), pictures[9])


def test_several_arms_stand_side_by_side(rest):
    other = replace(rest, joint_angle=0.6)
    both = Renderer("rgb_array", 50, "one", "two")
    for left, right in ((rest, other), (replace(rest, time=0.5), replace(other, time=0.5))):
        picture = both.draw(left, right)
    assert picture.shape == (560, 1440, 3)
    for columns, title, frame in ((slice(720), "one", rest), (slice(720, None), "two", other)):
        alone = Renderer("rgb_array", 50, title)
        alone.draw(frame)
        np.testing.assert_array_equal(picture[:, columns], alone.draw(replace(frame, time=0.5)))
    assert Renderer("rgb_array", 50, "one", "two", "three").draw(rest, other, rest).shape == (1120, 1440, 3)


# Displays


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a display without saying so")
def test_an_array_needs_no_display_and_a_window_without_one_is_drawn_unseen():
    script = (
        "import gymnasium as gym, amulett_gym, sys\n"
        "env = gym.make('Amulett/Scaling-v0', render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "assert 'pygame' not in sys.modules, 'pygame is loaded before it is needed'\n"
        "assert env.render().any()\n"
        "import pygame\n"
        "assert not pygame.display.get_init()\n"
        "env = gym.make('Amulett/Scaling-v0', render_mode='human')\n"
        "env.reset(seed=0)\n"
        "assert pygame.display.get_driver() == 'dummy'\n"
    )
    result = run_without_display(script)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a display without saying so")
def test_play_without_a_display_says_so_and_writes_a_video_only_if_asked(tmp_path):
    words = ["play", "constant:8", "--suite", "hold-push", "--steps", "4", "--json"]
    script = "from amulett_gym.cli import main; raise SystemExit(main({}))"
    result = run_without_display(script.format(words), cwd=tmp_path)
    message = "amulett: error: there is no display for a window; --video FILE writes a video (.gif, .webp, .png, .mp4)"
    assert (result.returncode, result.stdout, result.stderr) == (2, "", f"{message}\n")
    assert list(tmp_path.iterdir()) == []
    result = run_without_display(script.format([*words, "--video", "x.gif"]), cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    printed = json.loads(result.stdout)
    assert printed["video"] == {"file": "x.gif", "frames": 3, "seconds": pytest.approx(0.12)}
    (episode,) = printed["episodes"]
    assert episode["steps"] == 4
    assert episode["failure"] == ""
    assert episode["metrics"]["rise_time"] is None


def test_a_window_that_is_closed_stays_closed_and_harms_nobody():
    import pygame

    env = gym.make(SCALING, render_mode="human", agent_period=0.005)
    env.reset(seed=0)
    env.step(ACTION)
    assert env.render() is None
    assert pygame.display.get_init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(3):
        env.step(ACTION)
    assert not pygame.display.get_init()
    env.reset()
    env.close()
    env.close()


def test_a_window_survives_an_environment_that_quits_pygame(rest):
    import pygame

    renderer, window = Renderer("rgb_array", fps=50), Renderer("human", fps=50)
    before = renderer.draw(rest)
    window.draw(rest)
    pygame.quit()
    pygame.font.init()
    np.testing.assert_array_equal(renderer.draw(rest), before)
    assert renderer.draw(replace(rest, time=1234.56)).shape == SHAPE
    window.draw(rest)
    assert not window.is_open
    window.close()
    renderer.close()
    renderer.close()


def test_an_unknown_mode_is_refused():
    with pytest.raises(AmulettError, match=r"'rgb_arra'.*did you mean 'rgb_array'"):
        Renderer("rgb_arra", fps=50)


@pytest.mark.parametrize("env_id", amulett_gym.ENV_IDS)
@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_gymnasiums_checker_is_content_with_rendering(env_id, mode):
    with warnings.catch_warnings(), gym.make(env_id, render_mode=mode, disable_env_checker=True) as env:
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=False)


def test_record_video(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.make(SCALING, max_episode_steps=5, render_mode="rgb_array")
    with gym.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda number: True) as recorded:
        recorded.reset(seed=0)
        for _ in range(5):
            recorded.step(ACTION)
    assert list(tmp_path.glob("*.mp4"))


# amulett play


@pytest.mark.parametrize("policy", ["eq6", "constant:8", "position-only"])
def test_play_writes_a_gif_with_a_frame_for_the_start_and_every_second_step(tmp_path, policy, capsys):
    path = tmp_path / "new" / "video.gif"
    assert play_command(policy, "--steps", 10, "--episodes", 2, "--video", path) == 0
    with Image.open(path) as video:
        assert video.n_frames == 11  # of 2 * (1 + 10) pictures at 50 a second, 25 a second
        assert video.info["duration"] == 40
        assert (video.height, video.width) == SHAPE[:2]
    assert "11 frames" in capsys.readouterr().out
    assert [entry.name for entry in path.parent.iterdir()] == ["video.gif"]


@pytest.mark.parametrize("name", ["video.webp", "video.png"])
def test_play_writes_other_animated_images(tmp_path, name):
    play_command("eq6", "--steps", 6, "--fps", 50, "--video", tmp_path / name)
    with Image.open(tmp_path / name) as video:
        assert video.n_frames == 7


@NEEDS_FFMPEG
def test_play_writes_an_mp4(tmp_path):
    import imageio_ffmpeg

    path = tmp_path / "video.mp4"
    play_command("eq6", "--steps", 20, "--fps", 50, "--video", path)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 21
    assert seconds == pytest.approx(21 / 50, abs=0.02)


def test_play_replays_a_scenario(tmp_path):
    scenario = tmp_path / "hold.json"
    scenario.write_text(json.dumps({"initial_angle_deg": 80.0, "noise_seed": 1}))
    for name, seed in (("a.png", 0), ("b.png", 1)):
        play_command("eq6", "--scenario", scenario, "--seed", seed, "--steps", 2, "--video", tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_play_gives_a_trained_policy_the_period_it_was_trained_with(tmp_path):
    layers = [(np.zeros((1, len(OBSERVATIONS)), np.float32), np.zeros(1, np.float32))]
    folder = keep_network(tmp_path / "policy", layers, tension_range=[5.0, 9.0], agent_period=0.1)
    play_command(folder, "--steps", 4, "--video", tmp_path / "video.gif")
    with Image.open(tmp_path / "video.gif") as video:
        assert (video.n_frames, video.info["duration"]) == (5, 100)


def test_play_shows_several_policies_in_one_scenario_each_at_its_own_period(tmp_path, capsys):
    layers = [(np.zeros((1, len(OBSERVATIONS)), np.float32), np.zeros(1, np.float32))]
    slow = str(keep_network(tmp_path / "slow", layers, agent_period=0.1))
    play_command("eq6", slow, "eq6", "--steps", 4, "--video", tmp_path / "both.png", "--fps", 50, "--json")
    both = json.loads(capsys.readouterr().out)
    assert [(entry["policy"], entry["episodes"][0]["steps"]) for entry in both["policies"]] == [("eq6", 4), (slow, 4)]
    assert both["video"]["frames"] == 21  # at the pace of the faster one, until the slower one has taken its steps
    with Image.open(tmp_path / "both.png") as video:
        assert video.size == (1440, 560)
        video.seek(video.n_frames - 1)
        last = np.asarray(video.convert("RGB"))
    for entry, columns in zip(both["policies"], (slice(720), slice(720, None)), strict=True):
        play_command(entry["policy"], "--steps", 4, "--video", tmp_path / "one.png", "--fps", 50, "--json")
        alone = json.loads(capsys.readouterr().out)
        assert alone["episodes"] == entry["episodes"]
        with Image.open(tmp_path / "one.png") as video:
            video.seek(video.n_frames - 1)
            np.testing.assert_array_equal(np.asarray(video.convert("RGB")), last[:, columns])


def test_play_shows_a_law_of_the_users_own(tmp_path, capsys):
    law = tmp_path / "mine.py"
    law.write_text("def mine(observations): return observations[:, 99]\n")
    with pytest.raises(AmulettError, match=r"mine\.py:mine' raised IndexError in line 1"):
        play_command(f"{law}:mine", "--steps", 2, "--video", tmp_path / "video.png")
    law.write_text("def mine(observations): return observations[:, 0]\n")
    play_command(f"{law}:mine", "--steps", 2, "--video", tmp_path / "video.png")
    with Image.open(tmp_path / "video.png") as video:
        assert video.size == (720, 560)


def test_play_opens_a_window_where_there_is_a_display():
    assert play_command("eq6", "--steps", 3) == 0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["eq6", "--video", "video.avi"], r"'video\.avi' has to end with \.gif, .* or \.mp4"),
        (["eq6", "--video", "video"], r"has to end with"),
        (["eq7", "--video", "video.gif"], r"'eq7'.*did you mean 'eq6'"),
        (["eq6", "--suite", "stepz", "--video", "video.gif"], r"'stepz'.*did you mean 'steps'"),
        (["eq6", "--scenario", "missing.json", "--video", "video.gif"], r"cannot read scenario 'missing.json'"),
        (["eq6", "--video", "/dev/null/video.gif"], r"cannot write '/dev/null/video.gif'"),
        (["mine.zip", "--video", "video.gif"], r"--trust-pickle"),
        (["eq6", "--steps", "0", "--video", "video.gif"], r"--steps is 0; it has to be at least 1"),
    ],
)
def test_play_refuses_what_it_cannot_do_and_leaves_nothing_behind(tmp_path, monkeypatch, words, complaint):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AmulettError, match=complaint):
        play_command(*words)
    assert list(tmp_path.iterdir()) == []


def test_play_says_what_an_mp4_needs(tmp_path, monkeypatch):
    monkeypatch.setattr("amulett_gym.envs.rendering.video.find_spec", lambda name: None)
    with pytest.raises(AmulettError, match=r"pip install imageio-ffmpeg.*\.gif"):
        play_command("eq6", "--video", tmp_path / "video.mp4")


@pytest.mark.parametrize("name", ["video.gif", pytest.param("video.mp4", marks=NEEDS_FFMPEG)])
def test_an_interrupted_video_leaves_nothing_behind(tmp_path, monkeypatch, name):
    calls = iter(range(5))

    def policy(observations):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return ACTION[None]

    monkeypatch.setattr("amulett_gym.evaluation.runner.load_contender", lambda contender, env: policy)
    with pytest.raises(KeyboardInterrupt):
        play_command("constant:8", "--steps", 20, "--fps", 50, "--video", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_notebooks_picture_is_that_of_render():
    env = gym.make(SCALING, render_mode="rgb_array")
    env.reset(seed=0)
    with Image.open(BytesIO(env.unwrapped._repr_png_())) as picture:
        assert np.array_equal(np.asarray(picture), env.render())
    unstarted = gym.make(SCALING).unwrapped
    assert unstarted._repr_png_() == env.unwrapped._repr_png_()
    assert not unstarted.episodes.started[0]


class Sketch(gym.Wrapper):
    """A user's wrapper with a picture of its own."""

    def _repr_png_(self):
        return b"sketch"


def test_a_notebook_shows_a_users_own_picture(monkeypatch):
    env = gym.make(SCALING)
    assert png_of(env) == env.unwrapped._repr_png_()
    assert png_of(gym.wrappers.TimeAwareObservation(Sketch(env))) == b"sketch"
    formatter = Formatter()
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"image/png": formatter}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    register()
    assert formatter.printers == {gym.Wrapper: png_of}
    formatter.printers = {gym.Wrapper: str}
    register()
    assert formatter.printers == {gym.Wrapper: str}


class Formatter:
    """What of IPython's PNGFormatter is used: printers by type."""

    def __init__(self):
        self.printers = {}

    def lookup_by_type(self, kind):
        return self.printers[kind]

    def for_type(self, kind, printer):
        self.printers[kind] = printer
