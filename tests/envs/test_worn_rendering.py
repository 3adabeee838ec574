"""Pictures of a worn device: what they show of the wearer."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from amulett_gym import WORN_ID
from amulett_gym.envs.rendering.canvas import EXTERNAL, FOREARM, INK, polar
from amulett_gym.envs.rendering.frame import frame_of
from amulett_gym.envs.rendering.wearer import CUFF_RANGE, ELBOW, HAND, INTENTION, cuff_color
from amulett_gym.envs.rendering.window import Renderer

DOCS = Path(__file__).parents[2] / "docs"
SHAPE = (560, 720, 3)
LOADED = {
    "initial_angle_deg": 20.0,
    "orientation": "vertical",
    "payload": {"mass": 0.3, "arm": 0.3},
    "wearer": {"payload_time": 0.3},
}


@pytest.fixture(scope="module")
def env():
    env = gym.make(WORN_ID, render_mode="rgb_array").unwrapped
    yield env
    env.close()


@pytest.fixture(scope="module")
def rest(env):
    """Return a frame in which the wearer's arm, its intention and the device's link are apart."""
    frame = begun(env, {"initial_angle_deg": 40.0})
    return replace(
        frame, setpoint=-0.2, wearer=replace(frame.wearer, elbow_angle=0.8, intention=1.4, flexor=0.4, cuff_torque=0.3)
    )


def begun(env, scenario):
    env.reset(seed=0, options={"scenario": scenario})
    return frame_of(env.episodes, 0)


def picture(frame):
    return Renderer("rgb_array", 50).draw(frame)


def with_arm(frame, **changes):
    return replace(frame, wearer=replace(frame.wearer, **changes))


def places_of(image, color):
    return np.argwhere(np.abs(image.astype(int) - color).max(axis=-1) < 8)


def at(image, along, angle):
    x, y = polar(along, angle)
    return image[round(y), round(x)].astype(int)


def test_a_frame_is_the_truth_of_the_wearers_arm(env):
    env.reset(seed=1)
    for _ in range(80):
        *_, info = env.step(np.array([0.2, 0.5], dtype=np.float32))
    arm = frame_of(env.episodes, 0).wearer
    assert np.degrees(arm.elbow_angle) == pytest.approx(info["elbow_angle"])
    assert np.degrees(arm.intention) == pytest.approx(info["intention"])
    for name in ("flexor", "extensor", "cuff_torque", "assistance"):
        assert getattr(arm, name) == info[name] != 0.0


def test_a_device_that_is_not_worn_has_no_wearer():
    with gym.make("Amulett/Scaling-v0") as bare:
        bare.reset(seed=0)
        assert frame_of(bare.unwrapped.episodes, 0).wearer is None


@pytest.mark.parametrize(
    "change",
    [
        {"elbow_angle": 0.9},
        {"intention": 1.2},
        {"intention": None},
        {"flexor": 0.8},
        {"extensor": 0.8},
        {"cuff_torque": -0.3},
        {"cuff_torque": None},
        {"assistance": 1.0},
    ],
)
def test_every_part_of_a_wearer_shows(rest, change):
    assert (picture(rest) != picture(with_arm(rest, **change))).any()


def test_forearm_and_ghost_stand_where_elbow_and_intention_are(rest):
    image = picture(rest)
    skin, ghost = at(image, HAND, 0.8), at(image, HAND, 1.4)
    for angle, color in ((0.5, skin), (1.2, skin), (0.5, ghost), (1.2, ghost)):
        assert (at(image, HAND, angle) != color).any()
    moved = picture(with_arm(rest, elbow_angle=0.5, intention=1.2))
    np.testing.assert_array_equal(at(moved, HAND, 0.5), skin)
    np.testing.assert_array_equal(at(moved, HAND, 1.2), ghost)


def test_the_ghost_is_translucent(rest):
    backward = picture(with_arm(rest, intention=np.pi))  # over the upper arm, whose colour is seen through it
    before, behind = picture(with_arm(rest, intention=None)), at(backward, 120.0, np.pi)
    assert np.abs(behind - at(before, 120.0, np.pi)).max() > 10
    assert np.abs(behind - at(picture(rest), HAND, 1.4)).max() > 10


def test_cuffs_are_blue_if_they_flex_and_orange_if_they_extend_and_grow_darker():
    none = cuff_color(0.0)
    assert max(none) - min(none) == 0
    for side, strongest in ((1.0, 2), (-1.0, 0)):
        colors = [cuff_color(side * torque) for torque in np.linspace(0.1, 1.0, 10) * CUFF_RANGE]
        assert all(color[strongest] == max(color) for color in colors)
        brightness = [sum(color) for color in colors]
        assert brightness == sorted(brightness, reverse=True) and len(set(brightness)) == len(brightness)
        assert cuff_color(side * 2.0 * CUFF_RANGE) == colors[-1]


def test_cuffs_have_the_colour_of_their_torque(rest):
    for torque in (-0.8, 0.5):
        found = places_of(picture(with_arm(rest, cuff_torque=torque)), cuff_color(torque))
        x, y = polar(87.0, 0.75)
        assert (np.hypot(found[:, 1] - x, found[:, 0] - y) < 60.0).sum() > 300


def test_pushes_act_on_the_hand(rest):
    pushed = replace(rest, push_torque=1.0)
    for angle in (0.3, 1.1):
        red = places_of(picture(with_arm(pushed, elbow_angle=angle)), EXTERNAL)
        x, y = polar(HAND, angle)
        assert np.hypot(red[:, 1] - x, red[:, 0] - y).min() < 25.0


def test_a_payload_is_in_the_hand_from_its_time_on(env):
    assert begun(env, LOADED).payload_mass == 0.0
    for _ in range(20):
        env.step(np.array([0.2, 0.5], dtype=np.float32))
    frame = frame_of(env.episodes, 0)
    assert frame.payload_mass == 0.3
    dark, angle = places_of(picture(frame), INK), frame.wearer.elbow_angle
    x, y = polar(HAND, angle)
    assert (np.hypot(dark[:, 1] - x, dark[:, 0] - y) < 18.0).sum() > 400


def test_a_guided_arm_is_relaxed_and_has_no_intention(env, rest):
    arm = begun(env, {"wearer": {"guided": True}}).wearer
    assert arm.intention is None and arm.cuff_torque is not None
    relaxed = picture(with_arm(rest, intention=None))
    tag = (slice(62, 82), slice(76, 150))
    assert places_of(relaxed[tag], ELBOW).size > 300 > places_of(picture(rest)[tag], ELBOW).size
    assert places_of(relaxed, INTENTION).size == 0 < places_of(picture(rest), INTENTION).size


def test_an_arm_outside_the_device_has_no_cuffs(env, rest):
    assert begun(env, {"wearer": {"worn": False}}).wearer.cuff_torque is None
    doffed = with_arm(rest, cuff_torque=None)
    assert places_of(picture(doffed), cuff_color(0.3)).size < places_of(picture(rest), cuff_color(0.3)).size
    assert places_of(picture(doffed), FOREARM).size > 0


def test_many_wearers_are_drawn_one_by_one():
    envs = gym.make_vec(WORN_ID, num_envs=9, render_mode="rgb_array")
    envs.reset(seed=3)
    pictures = envs.render()
    envs.close()
    assert [image.shape for image in pictures] == [SHAPE] * 9
    with gym.make(WORN_ID, render_mode="rgb_array") as single:
        single.reset(seed=3 + 8)
        np.testing.assert_array_equal(single.render(), pictures[8])


def test_the_documents_picture_is_made_by_the_code_below_it(tmp_path, monkeypatch):
    page = (DOCS / "environments.md").read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "worn.png" in block)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    with Image.open("worn.png") as made, Image.open(DOCS / "images" / "worn.png") as shown:
        assert made.size == shown.size == (720, 560)
        changed = np.abs(np.asarray(made).astype(int) - np.asarray(shown)).max(axis=-1) > 40
    assert changed[:340].mean() < 0.05  # the arm, which may move a little with the device's constants
    assert (DOCS / "images" / "worn.png").stat().st_size < 60_000
