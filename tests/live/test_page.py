"""The page of the live twin in a real browser: what it asks for, what a person does with it, and what it refuses."""

from __future__ import annotations

import base64
import csv
import io
import json
import math
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from live.browser import MISSING, Page, chromium, has_browser

from amulett_gym.cli import main
from amulett_gym.fleet import load_fleet
from amulett_gym.laws.parametric import tuned_vector
from amulett_gym.live.core.data import device_data
from amulett_gym.live.core.hex import FIRMWARE
from amulett_gym.live.page import build_page
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import CONTROLS, LOOPS

needs_browser = pytest.mark.skipif(not has_browser(), reason=MISSING)


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("live") / "live.html"
    path.write_text(build_page(), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def driver():
    with chromium() as driver:
        yield driver


@pytest.fixture
def page(driver, file) -> Page:
    """Open the page anew, paused, with no task."""
    page = Page(driver, file)
    page.resize(1440, 900)
    page.open()
    page.run("app.choose({ task: 'free' })")
    page.requests(), page.errors()
    return page


def state(page: Page) -> dict[str, Any]:
    """Return both arms' whole states."""
    return page.run("return { ...run.state, tick: run.tick }")


def give(page: Page, tmp_path: Path, **files: str | bytes) -> None:
    """Open files as a person does; ``__`` in a name is a dot."""
    paths = []
    for name, content in files.items():
        path = tmp_path / name.replace("__", ".")
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        paths.append(str(path))
    page.run("document.getElementById('messages').replaceChildren()")
    page.find("#open-files").send_keys("\n".join(paths))
    page.wait("return document.getElementById('messages').children.length > 0")


@needs_browser
def test_it_asks_for_nothing_from_elsewhere_and_reports_no_error(driver, file):
    page = Page(driver, file)
    page.requests(), page.errors()
    page.open(still=False)
    page.wait("return run.time > 1")
    assert {url for url in page.requests() if not url.startswith(("data:", "about:"))} == {file.resolve().as_uri()}
    assert page.errors() == []
    assert page.run("return Number(document.getElementById('mine-cost').textContent)") > 0


@needs_browser
def test_its_policy_forbids_scripts_and_requests_that_are_not_its_own(page):
    page.run("""
        const script = document.createElement("script");
        script.textContent = "globalThis.pwned = 1";
        document.body.append(script);
    """)
    assert page.run("return globalThis.pwned") is None
    assert "error" in page.promise("fetch('https://example.org/')")
    assert all("Content Security Policy" in error for error in page.errors())


@needs_browser
def test_it_waits_for_readers_who_want_little_motion(page):
    before = page.run("return run.tick")
    time.sleep(0.3)
    assert page.run("return run.tick") == before
    assert page.find("#play").text.endswith("Run")


@needs_browser
def test_the_button_says_what_it_does_and_no_state_that_contradicts_it(page):
    button = page.find("#play")
    for word in ("Run", "Pause", "Run"):
        assert button.text.endswith(word) and button.get_attribute("aria-pressed") is None
        assert page.run("return app.playing") == (word == "Pause")
        button.click()


@needs_browser
def test_the_setpoint_is_dragged_with_the_mouse(page):
    from selenium.webdriver import ActionChains

    canvas = page.find("#mine-canvas")
    start, end = page.place(0.0, 190.0), page.place(math.radians(50.0), 190.0)
    actions = ActionChains(page.driver, duration=20).move_to_element_with_offset(canvas, *start).click_and_hold()
    actions.move_to_element_with_offset(canvas, *end).release().perform()
    page.find("#step").click()
    found = state(page)
    assert math.degrees(found["mine"]["setpoint"]) == pytest.approx(50.0, abs=1.5)
    assert found["twin"]["setpoint"] == found["mine"]["setpoint"]


@needs_browser
@pytest.mark.parametrize("kind", ["mouse", "touch"])
def test_the_forearm_is_pushed_with_mouse_and_finger(page, kind):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.pointer_input import PointerInput

    page.find("#play").click()
    canvas, hold = page.find("#mine-canvas"), page.place(0.0, 150.0)
    actions = ActionChains(page.driver, duration=20, devices=[PointerInput(kind, kind)])
    actions.move_to_element_with_offset(canvas, *hold).click_and_hold().move_by_offset(0, -60).pause(
        0.3
    ).release().perform()
    page.wait("return run.state.mine.push === 0 && run.events.length > 1")
    pushes = page.run("return run.events.filter((each) => each.kind === 'push').map((each) => each.value)")
    assert max(pushes) > 0.2 and pushes[-1] == 0.0
    assert page.run("return [...run.events].every((each) => each.kind === 'push')"), "the setpoint stays"
    moved = page.run("""
        let most = 0;
        run.samples.mine.each("angle", 0, (time, angle) => { most = Math.max(most, angle); });
        return most;
    """)
    assert moved > 0.01


@needs_browser
@pytest.mark.parametrize("loop", (*CONTROLS, FIRMWARE))
def test_every_loop_can_be_played(page, loop):
    page.run("app.choose({ loop: arguments[0] })", loop)
    assert page.run("return app.settings.loop") == loop
    page.run("app.input('setpoint', 0.7); run.advance(run.tick + 400)")
    mine = state(page)["mine"]
    assert mine["failed"] is None and mine["angle"] == pytest.approx(0.7, abs=0.2)
    assert page.run("return [run.state.mine.cost, run.state.twin.cost]") == page.run(
        "return [run.arms.mine, run.arms.twin].map((arm) => arm.read()[arguments[0]])",
        "controlCost" if loop in LOOPS else "cost",
    )
    assert page.errors() == []


@needs_browser
def test_laws_devices_and_tasks_are_switched(page):
    for kind in ("laws", "devices", "tasks"):
        for name in page.run("return app.data[arguments[0]].map((each) => each.id)", kind):
            if kind == "laws":
                page.run("app.chooseLaw(arguments[0])", name)
            else:
                page.run("app.choose({ [arguments[0].slice(0, -1)]: arguments[1] })", kind, name)
            page.run("run.advance(run.tick + 300)")
            chosen = page.run(
                "const { device, task, law } = app.settings; return { devices: device, tasks: task, laws: law.name }"
            )
            assert chosen[kind] == name
            found = state(page)
            numbers = [found[arm][key] for arm in ("mine", "twin") for key in ("angle", "stiffness", "cost")]
            assert np.isfinite(numbers).all(), (name, numbers)
    assert page.errors() == []


@needs_browser
def test_laws_make_a_difference_and_eq6_none(page):
    for law, differs in (("eq6", False), ("constant", True), ("pretrained", True)):
        page.run("app.restart(); app.chooseLaw(arguments[0]); app.input('setpoint', 0.8); run.advance(400)", law)
        found = state(page)
        assert (found["mine"] != found["twin"]) == differs, law


@needs_browser
def test_a_parameter_changes_what_its_law_asks_for(page):
    page.run("app.chooseLaw('constant')")
    for tension in (5.0, 12.0):
        page.run("app.setParameter('tension', arguments[0]); run.advance(run.tick + 40)", tension)
        assert state(page)["mine"]["tensionSetpoint"] == pytest.approx(tension, abs=1e-5)


@needs_browser
def test_a_refused_parameter_leaves_the_last_one(page):
    page.run("app.chooseLaw('eq6'); app.setParameter('minimum_tension', 9); app.setParameter('nominal_tension', 6)")
    assert "nominal_tension" in page.messages() or "minimum_tension" in page.messages()
    assert page.run("return app.settings.law.parameters.nominal_tension") == 10.0
    page.run("run.advance(run.tick + 10)")
    assert page.errors() == []


@needs_browser
def test_an_obstacle_stops_the_arm_and_a_payload_changes_its_motion(page):
    def move(before: str, ticks: int) -> dict[str, Any]:
        page.run(
            f"app.restart(); app.chooseLaw('constant'); {before}; app.input('setpoint', 1.0); run.advance({ticks})"
        )
        return state(page)["mine"]

    blocked = move("app.input('obstacle', { angle: 0.5, side: 1, stiffness: 30 })", 400)
    assert blocked["angle"] < 0.6 < move("", 400)["angle"] and blocked["contact"] < 0
    loaded = move("app.input('payload', 1.5)", 100)
    assert loaded["payload"] == 1.5 and abs(loaded["angle"] - move("", 100)["angle"]) > 1e-3


@needs_browser
def test_keys_alone_do_everything(page):
    from selenium.webdriver import ActionChains, Keys

    def press(*keys: str) -> None:
        for key in keys:
            ActionChains(page.driver).send_keys(key).perform()

    press("6", ".")
    assert math.degrees(state(page)["mine"]["setpoint"]) == pytest.approx(60.0)
    press(Keys.ARROW_LEFT, ".")
    assert math.degrees(state(page)["mine"]["setpoint"]) == pytest.approx(55.0)
    ActionChains(page.driver).key_down("f").perform()
    press(".")
    assert state(page)["mine"]["push"] > 0
    ActionChains(page.driver).key_up("f").perform()
    press(".")
    assert state(page)["mine"]["push"] == 0
    press("o", "p", ".")
    assert state(page)["mine"]["obstacle"] is not None and state(page)["mine"]["payload"] == 0.5
    press("o", "p", ".")
    assert state(page)["mine"]["obstacle"] is None and state(page)["mine"]["payload"] == 0
    law = page.run("return app.settings.law.name")
    press("]")
    assert page.run("return app.settings.law.name") != law
    press("[")
    assert page.run("return app.settings.law.name") == law
    press("s")
    assert page.find("#speed").get_attribute("value") == "0.5"
    inputs = page.run("return run.events.filter((each) => each.kind !== 'law').length")
    press("y")
    assert page.run("return app.playing && run.events.length") == inputs > 5
    press(" ")
    assert not page.run("return app.playing")
    press("r")
    assert page.run("return run.events.length") == 0
    press("?")
    assert page.run("return document.getElementById('help').open")
    press(Keys.ESCAPE)
    assert not page.run("return document.getElementById('help').open")
    press("l")
    assert page.wait("return location.hash.length > 10")
    assert page.errors() == []


@needs_browser
def test_tab_reaches_every_control_and_each_has_a_name(page):
    from selenium.webdriver import ActionChains, Keys

    controls = """
        return [...document.querySelectorAll("button, select, input, summary, a[href]")].filter((each) =>
            each.checkVisibility() && !each.disabled && !each.closest("dialog"))
            .map((each, k) => { each.dataset.k = k; return k; })
    """
    wanted = set(page.run(controls))
    reached = set()
    for _ in range(len(wanted) + 5):
        ActionChains(page.driver).send_keys(Keys.TAB).perform()
        reached.add(page.run("const k = document.activeElement.dataset.k; return k === undefined ? -1 : Number(k)"))
    assert wanted - reached == set()
    nameless = page.run("""
        return [...document.querySelectorAll("button, select, input, canvas")].filter((each) =>
            !(each.textContent.trim() || each.getAttribute("aria-label") || (each.labels && each.labels.length)))
            .map((each) => each.outerHTML)
    """)
    assert nameless == []


@needs_browser
def test_the_link_that_skips_to_the_controls_is_no_link_to_a_moment(page):
    page.find(".skip").send_keys("\n")
    page.wait("return location.hash === '#controls'")
    time.sleep(0.2)
    assert page.messages() == "" and page.errors() == []


@needs_browser
def test_letters_can_be_switched_off(page):
    from selenium.webdriver import ActionChains

    page.run("document.getElementById('keys-on').checked = false")
    ActionChains(page.driver).send_keys("6").perform()
    page.find("#step").click()
    assert state(page)["mine"]["setpoint"] == 0.0


PLAYED = """
    app.chooseLaw("pretrained"); app.input("setpoint", 0.9); run.advance(300);
    app.input("push", 0.3); run.advance(360); app.input("push", 0); run.advance(500);
    app.chooseLaw("constant"); app.setParameter("tension", 7.25);
    app.input("obstacle", { angle: 1.1, side: 1, stiffness: 12 }); app.input("setpoint", 1.2); run.advance(777);
"""


@needs_browser
def test_a_link_gives_the_same_state_to_the_last_bit(page):
    page.run(PLAYED)
    before, link = state(page), page.promise("app.link()")["value"]
    assert page.run("return location.hash.slice(1)") == link
    page.open("#" + link)
    assert state(page) == before
    page.run("run.advance(run.tick + 500)")
    after = state(page)
    page.open("#" + link)
    page.run("run.advance(run.tick + 500)")
    assert state(page) == after
    assert page.run("return [app.settings.law.name, app.settings.law.parameters.tension]") == ["constant", 7.25]


@needs_browser
def test_going_back_in_time_gives_the_same_states(page):
    page.run(PLAYED)
    end = state(page)
    page.run("run.seek(333)")
    middle = state(page)
    page.run("run.seek(777)")
    assert state(page) == end
    page.run("run.seek(10); run.seek(333)")
    assert state(page) == middle and middle["tick"] == 333


@needs_browser
def test_going_back_in_time_shows_the_law_that_acts(page):
    page.run(PLAYED)
    shown = "return [app.settings.law.name, document.getElementById('law').value]"
    assert page.run(shown) == ["constant", "constant"]
    page.run("""
        document.getElementById("time").value = "333";
        document.getElementById("time").dispatchEvent(new Event("input"));
    """)
    page.wait("return app.settings.law.name === 'pretrained'")
    assert page.run(shown) == ["pretrained", "pretrained"]
    page.run("app.input('setpoint', 0.2); run.advance(800)")  # takes over from there: with the law that is shown
    assert page.run(shown) == ["pretrained", "pretrained"] == [page.run("return run.law.name")] * 2


@needs_browser
def test_inputs_add_up_while_it_is_paused(page):
    from selenium.webdriver import ActionChains, Keys

    ActionChains(page.driver).send_keys(Keys.ARROW_UP, Keys.ARROW_UP, Keys.ARROW_UP).perform()
    page.find("#push").send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    page.find("#step").click()
    mine = state(page)["mine"]
    assert math.degrees(mine["setpoint"]) == pytest.approx(15.0) and mine["push"] == pytest.approx(0.03)


@needs_browser
def test_a_push_ends_with_its_pull_while_it_is_paused(page):
    from selenium.webdriver import ActionChains

    canvas, hold = page.find("#mine-canvas"), page.place(0.0, 150.0)
    actions = ActionChains(page.driver, duration=20).move_to_element_with_offset(canvas, *hold).click_and_hold()
    actions.move_by_offset(0, -60).perform()
    assert page.run("return run.asked.push") > 0.2
    ActionChains(page.driver).release().perform()
    page.find("#step").click()
    assert state(page)["mine"]["push"] == 0.0


def strip_pictures(page: Page) -> list[np.ndarray]:
    """Return the strips' pixels, each of shape (height, width, 3)."""
    taken = page.run("""
        Live.strips.draw(run.samples, run.time, false);
        return [...document.querySelectorAll(".strip canvas")].map((each) => [each.height, each.width,
            btoa(Array.from(each.getContext("2d").getImageData(0, 0, each.width, each.height).data,
                (value) => String.fromCharCode(value)).join(""))]);
    """)
    pictures = (np.frombuffer(base64.b64decode(data), np.uint8).reshape(high, wide, 4) for high, wide, data in taken)
    return [picture[..., :3].astype(float) for picture in pictures]


def coloured(picture: np.ndarray) -> np.ndarray:
    """Return how many pixels of each column are of a curve: lines and texts of the ground are grey."""
    return (np.ptp(picture, axis=2) > 60).sum(axis=0)


@needs_browser
def test_curves_that_grew_with_time_are_those_drawn_at_once(page):
    page.run("app.chooseLaw('constant'); app.input('push', 0.1); app.input('setpoint', 0.6)")
    for until in (5.0, 11.0, 20.0):  # s: in the first window, after it, and after their canvas was moved to the left
        page.run(
            """
            while (run.time < arguments[0]) {
                if (run.tick % 350 === 0) app.input("setpoint", 0.6 + 0.15 * Math.sin(run.tick));
                run.advance(run.tick + 7);
                Live.strips.draw(run.samples, run.time, false);
            }
            """,
            until,
        )
        grown = strip_pictures(page)
        page.run("const now = run.tick; run.seek(0); run.seek(now)")  # begins the curves anew
        for k, (one, other) in enumerate(zip(grown, strip_pictures(page), strict=True)):
            if k in (2, 3, 5):  # no dashes; pieces of two curves that cross may lie upon each other in another order
                assert np.mean(np.abs(one - other) > 64) < 0.003, (until, k)
            assert np.array_equal(coloured(one) > 0, coloured(other) > 0), (until, k, "there is a gap")
            assert np.mean(coloured(one) > 0) > 0.3, (until, k)


@needs_browser
def test_no_frame_is_asked_for_while_there_is_nothing_to_do(page):
    time.sleep(0.3)
    page.run("app.durations.length = 0")
    time.sleep(0.3)
    assert page.run("return app.durations.length") == 0
    page.find("#play").click()
    page.wait("return app.durations.length > 3")


@needs_browser
def test_a_picture_that_cannot_be_drawn_is_reported_once_and_ends_the_run(page):
    page.run("""
        globalThis.draw = Live.arm.draw;
        Live.arm.draw = () => { throw new Error("no picture"); };
    """)
    page.find("#play").click()
    page.wait("return document.getElementById('messages').children.length > 0 && !app.playing")
    time.sleep(0.3)
    assert page.messages().count("no picture") == 1
    assert page.find("#play").text.endswith("Run") and any("no picture" in error for error in page.errors())
    page.run("Live.arm.draw = globalThis.draw; document.getElementById('play').click()")
    page.wait("return run.time > 0.2")


@needs_browser
def test_an_arm_that_failed_is_not_called_the_cheaper_one(page):
    page.run("app.chooseLaw('constant'); app.input('setpoint', 2.4); app.input('payload', 2); app.input('push', 0.8)")
    page.run("run.advance(4000)")
    found = state(page)
    assert found["mine"]["failed"] or found["twin"]["failed"]
    page.find("#step").click()
    assert page.wait("return document.getElementById('verdict').textContent.endsWith('failed')")
    times = read_table(page.run("return app.table()"))["time_s"]
    assert times == sorted(set(times)) and len(times) == page.run("return run.tick") + 1


@needs_browser
def test_a_replay_has_the_same_inputs_with_another_law(page):
    page.run(PLAYED)
    twin = state(page)["twin"]
    page.run("app.chooseLaw('eq6'); app.replay(false); run.advance(777)")
    found = state(page)
    assert found["twin"] == twin == found["mine"]


WRONG_LINKS = (
    ({"device": "testbet"}, "did you mean 'testbed'"),
    ({"device": "own:<img src=x onerror=alert(1)>"}, "drop its files"),
    ({"loop": 3}, "loop"),
    ({"law": {"name": "constant", "parameters": {"tension": 1e9}}}, "tension"),
    ({"law": {"name": "constant", "parameters": {}}}, "'tension' is missing"),
    ({"law": {"name": "constant", "parameters": {"tension": 8, "__proto__x": 1}}}, "unknown key"),
    ({"tick": 1e12}, "tick"),
    ({"tick": 5, "end": 4}, "tick"),
    ({"end": 10**8, "tick": 0}, "longer than 600 s"),
    ({"events": [[10**8, "push", 0]]}, "'end' is 100; it has to be at least 100000000"),
    ({"events": [[0, "setpoint", None]]}, "events.0.2"),
    ({"events": [[0, "setpoint", 1e308]]}, "events.0.2"),
    ({"events": [[-1, "push", 0]]}, "events.0.0"),
    ({"events": [[0, "constructor", 0]]}, "events.0.1"),
    ({"events": [[0, "obstacle", {"angle": 0, "side": 2, "stiffness": 5}]]}, "side"),
    ({"events": "x"}, "events"),
    ({"version": 99}, "version 1"),
    ({"extra": 1}, "unknown key"),
    ({"hashes": {}}, "'hashes'"),
    ({"task": "mixed"}, "task 'mixed' is another one than that of this page"),
)
"""What is changed in a link, and what the error has to say."""

DAMAGED_LINKS = ("x", "z", "zAAAA", "z%%%", "z" + "A" * 500_000, "<script>alert(1)</script>")


@needs_browser
def test_a_wrong_link_is_refused_by_its_key_and_changes_nothing(page):
    page.run("app.input('setpoint', 0.5); run.advance(100)")
    before = state(page)
    for change, said in WRONG_LINKS:
        page.run("document.getElementById('messages').replaceChildren()")
        link = "Live.link.pack({ version: 1, ...app.moment(), events: [], ...arguments[0] })"
        page.promise("app.open('#' + arguments[0])", page.promise(link, change)["value"])
        assert said in page.messages(), (change, page.messages())
        assert state(page) == before, change
    assert page.errors() == []


@needs_browser
def test_a_link_waits_for_the_very_file_that_it_was_made_with(page, tmp_path):
    device, other = "name: mine\nbase: testbed\nsensors: {encoder_bits: 12}\n", "name: mine\nbase: testbed\n"
    law = {
        "format": "amulett-tuned-law",
        "recipe": {"law": "eq6-tuned"},
        "parameters": {
            "nominal_tension": {"value": 9.0},
            "minimum_tension": {"value": 5.0},
            "error_offset": {"value": 20.0},
            "exponent": {"value": 3.0},
        },
    }
    give(page, tmp_path, mine__yaml=device, law__json=json.dumps(law))
    page.wait("return app.settings.law.name === 'own:law.json'")
    page.run("app.input('setpoint', 0.8); run.advance(300)")
    before, link = state(page), page.promise("app.link()")["value"]
    page.open("#" + link)
    assert "drop its files on this page" in page.messages() and state(page)["tick"] < 300
    give(page, tmp_path, mine__yaml=other, law__json=json.dumps(law))
    page.wait("return document.getElementById('messages').innerText.includes('another one')")
    assert "the link's device 'mine' is another one" in page.messages() and state(page) != before
    page.run("document.getElementById('messages').replaceChildren()")
    page.promise("app.open('#' + arguments[0])", link)  # once more, with a device of that name on the page
    assert "of the same name" in page.messages() and state(page) != before
    give(page, tmp_path, mine__yaml=device)
    page.wait("return run.tick === 300")
    assert state(page) == before, page.messages()
    page.run("document.getElementById('messages').replaceChildren()")
    law["parameters"]["exponent"]["value"] = 4.0
    give(page, tmp_path, law__json=json.dumps(law))
    page.promise("app.open('#' + arguments[0])", link)
    assert "the link's law 'law.json' is another one" in page.messages()
    assert page.errors() == []


@needs_browser
def test_a_link_of_another_simulation_is_refused(page):
    link = "Live.link.pack({ version: 1, ...app.moment(), hashes: { ...app.moment().hashes, simulation: 'x' } })"
    page.promise("app.open('#' + arguments[0])", page.promise(link)["value"])
    assert "another one" in page.messages() and "amulett.wasm" in page.messages()


@needs_browser
def test_eq6_begins_with_the_values_of_the_device(page, tmp_path):
    shown = """
        const { parameters } = app.settings.law;
        return app.parameters().map(({ name, low, high }) => [name, parameters[name], low, high]);
    """
    page.run("app.chooseLaw('eq6')")
    assert [row[1] for row in page.run(shown)] == pytest.approx([10.0, 4.0, 30.0])
    page.run("app.setParameter('nominal_tension', 12)")
    own = {"nominal_tension": 18.0, "minimum_tension": 3.0, "error_offset_deg": 25.0}
    give(page, tmp_path, mine__yaml=yaml.safe_dump({"name": "mine", "base": "testbed", "variable_stiffness": own}))
    found = {name: (value, low, high) for name, value, low, high in page.run(shown)}
    assert {name: row[0] for name, row in found.items()} == pytest.approx(own)
    assert found["nominal_tension"][2] == 18.0 and found["minimum_tension"][1] == 3.0
    page.run("app.input('setpoint', 0.8); run.advance(400)")
    both = state(page)
    assert both["mine"] == both["twin"]  # the other arm has the device's eq. 6, too
    link = page.promise("app.link()")["value"]
    page.promise("app.open('#' + arguments[0])", link)
    assert state(page) == both, page.messages()
    page.run("app.choose({ device: 'testbed' })")
    assert page.run("return app.settings.law.parameters.nominal_tension") == 12.0  # which was set there


@needs_browser
def test_a_tuned_law_begins_with_the_values_of_the_device(page):
    for name in ("simulation", "testbed"):
        page.run("app.choose({ device: arguments[0] }); app.chooseLaw('eq6-tuned')", name)
        wanted = device_data(load_profile(name))["laws"]["eq6-tuned"]
        assert page.run("return app.settings.law.parameters") == pytest.approx(wanted)
    page.run("delete app.data.devices.find((each) => each.id === 'testbed').content.laws['eq6-tuned']")
    page.run("app.chooseLaw('eq6-tuned', true)")  # a device without its own has those of the page
    assert page.run("return app.settings.law.parameters") == pytest.approx(wanted)


@needs_browser
def test_several_laws_within_a_tick_are_recorded_as_they_act(page):
    page.run("""
        app.chooseLaw("pretrained"); app.input("setpoint", 0.9); run.advance(303);
        app.chooseLaw("eq6"); app.chooseLaw("constant"); app.setParameter("tension", 7.25); app.chooseLaw("parametric");
        app.input("setpoint", 0.2); app.input("push", 0.1); app.input("setpoint", 0.4); run.advance(600);
    """)
    before, link = state(page), page.promise("app.link()")["value"]
    assert page.run("return run.events.filter((each) => each.tick === 303).map((each) => each.kind)") == [
        "law",
        "push",
        "setpoint",
    ]
    page.run("run.seek(0); run.advance(600)")
    assert state(page) == before
    page.open("#" + link)
    assert state(page) == before


@needs_browser
def test_an_input_that_is_refused_leaves_everything_as_it_was(page):
    page.run("app.input('setpoint', 0.5); run.advance(100); app.input('payload', 1); app.input('setpoint', 0.7)")
    before, events = state(page), page.run("return run.events")
    page.run("app.input('obstacle', { angle: 0.2, side: 1, stiffness: 1e9 })")
    assert "stiffness" in page.messages() and state(page) == before and page.run("return run.events") == events
    page.run("app.input('payload', 99)")
    assert state(page) == before and page.run("return run.events") == events


@needs_browser
def test_an_input_that_is_refused_in_a_replay_leaves_the_record(page):
    page.run("""
        const obstacle = { angle: 0.2, side: 1, stiffness: 1e9 };
        run.script([{ tick: 0, kind: "setpoint", value: 0.5 }, { tick: 120, kind: "obstacle", value: obstacle },
            { tick: 150, kind: "setpoint", value: 0.1 }], 200);
    """)
    assert "stiffness" in page.promise("app.run.advance(200)")["error"]
    page.run("run.advance(200)")
    assert page.run("return run.events.map((each) => each.kind)") == ["setpoint", "setpoint"]
    assert math.degrees(state(page)["mine"]["setpoint"]) == pytest.approx(math.degrees(0.1))


@needs_browser
def test_the_damping_of_a_scenarios_obstacle_stays_when_it_is_moved(page, tmp_path):
    obstacle = {"angle_deg": 40.0, "stiffness": 12.0, "damping": 0.05}
    give(page, tmp_path, mine__json=json.dumps({"obstacle": obstacle}))
    page.find("#step").click()
    page.wait("return document.getElementById('obstacle').checked")
    page.run("""
        const slider = document.querySelector(".inner input");
        slider.value = "45";
        slider.dispatchEvent(new Event("input"));
    """)
    page.find("#step").click()
    found = state(page)["mine"]["obstacle"]
    assert math.degrees(found["angle"]) == pytest.approx(45.0)
    assert found["damping"] == pytest.approx(0.05) and found["stiffness"] == pytest.approx(12.0)
    link = page.promise("app.link()")["value"]
    before = state(page)
    page.promise("app.open('#' + arguments[0])", link)
    assert state(page) == before, page.messages()


@needs_browser
def test_curves_of_an_arm_that_failed_end_and_the_panel_follows_the_other_one(page):
    page.run("app.chooseLaw('constant'); app.input('setpoint', 2.4); app.input('payload', 2); app.input('push', 0.8)")
    page.run("run.advance(1200); app.input('setpoint', 0.5); app.input('push', -0.4); run.advance(1300)")
    found = state(page)
    assert found["mine"]["failed"] and not found["twin"]["failed"]
    ends = "return ['time', 'setpoint', 'push'].map((name) => run.samples.mine.last(name))"
    assert page.run(ends) == [found["mine"][name] for name in ("time", "setpoint", "push")]
    assert page.run(ends)[1:] == [2.4, 0.8]  # at its end, not what the other arm has now
    assert page.run("return run.asked.setpoint") == found["twin"]["setpoint"] == 0.5


@needs_browser
def test_a_damaged_link_is_refused(page):
    before = state(page)
    for text in DAMAGED_LINKS:
        page.run("document.getElementById('messages').replaceChildren()")
        page.promise("app.open('#' + arguments[0])", text)
        assert "link" in page.messages(), text[:20]
    assert state(page) == before and page.errors() == []


@needs_browser
def test_a_link_that_unpacks_to_too_much_is_refused(page):
    bomb = """(async () => {
        const stream = new Blob([new Uint8Array(3e7)]).stream().pipeThrough(new CompressionStream("deflate-raw"));
        const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
        return "z" + btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
    })()"""
    text = page.promise(bomb)["value"]
    page.promise("app.open('#' + arguments[0])", text)
    assert "unpacks to more than" in page.messages()


GARBAGE = {
    "broken__json": "{",
    "empty__json": "",
    "list__json": "[1, 2]",
    "nan__json": '{"moves": [{"time": NaN}]}',
    "huge__json": '{"moves": [{"time": 1e400, "angle_deg": 1e300}]}',
    "far__json": '{"moves": [{"time": 0, "angle_deg": 1e300}]}',
    "null__json": "null",
    "deep__json": "[" * 100_000,
    "deep2__json": '{"moves": ' + "[" * 50_000 + "]" * 50_000 + "}",
    "html__json": '{"<img src=x onerror=globalThis.pwned=1>": 1}',
    "moves__json": '{"moves": "<img src=x onerror=globalThis.pwned=1>"}',
    "unknown__json": '{"moves": [], "obstacel": null}',
    "proto__json": '{"moves": [], "__proto__": {"polluted": 1}, "constructor": 2}',
    "law__json": '{"format": "amulett-tuned-law", "recipe": {"law": "constant"}, "parameters": {"tension": 1}}',
    "law2__json": '{"format": "amulett-tuned-law", "recipe": {"law": "__proto__"}}',
    "page__html": "<script>globalThis.pwned = 1</script>",
    "binary__bin": bytes(range(256)) * 50,
    "binary__yaml": bytes(range(128, 256)) * 50,
    "tag__yaml": "a: !!js/function 'function () { globalThis.pwned = 1 }'",
    "laughs__yaml": "x0: &x0 [x, x]\n"
    + "".join(f"x{k + 1}: &x{k + 1} [{', '.join([f'*x{k}'] * 10)}]\n" for k in range(12))
    + "name: *x12\n",
    "device__yaml": "name: mine\nbase: testbed\nplant: {drive_pulley_radius: -1}\n",
    "device2__yaml": "name: mine\nbase: testbed\nsprings: {}\n",
    "device3__yaml": "name: mine\nbase: nobody\n",
    "device4__yaml": "name: mine\nbase: testbed\ndrives: {lag: .nan}\n",
    "device5__yaml": "name: mine\nbase: testbed\ndrives: {lag: 1.0e+300}\n",
    "live__json": json.dumps(
        {"format": "amulett-live-device", "name": "x", "unfit": {}, "parameters": {}, "prices": {}}
    ),
    "weights__safetensors": b"\xff" * 100,
    "policy__json": "{}",
}


@needs_browser
def test_garbage_is_refused_with_words_and_changes_nothing(page, tmp_path):
    page.run("app.input('setpoint', 0.5); run.advance(100)")
    count = """
        const { settings, data } = app, elements = document.querySelectorAll("img, script, iframe").length;
        const counts = [data.devices.length, data.laws.length, data.tasks.length, elements];
        return [settings, counts, globalThis.pwned, ({}).polluted];
    """
    before, choices = state(page), page.run(count)
    for name, content in GARBAGE.items():
        give(page, tmp_path, **{name: content})
        said = page.messages()
        assert page.run("return document.querySelector('.messages .error') !== null"), (name, said)
        assert len(said) > 30 and "undefined" not in said and "[object" not in said, (name, said)
        assert page.run(count) == choices, name
        assert state(page) == before, name
    assert page.errors() == []


@needs_browser
def test_too_many_and_too_large_files_are_refused(page, tmp_path):
    give(page, tmp_path, **{f"f{k}__json": "{}" for k in range(21)})
    assert "21 files are too many" in page.messages()
    give(page, tmp_path, large__json=b" " * 16_000_001)
    assert "16000001 bytes" in page.messages()


@needs_browser
def test_files_can_be_dropped(page):
    page.run("""
        const data = new DataTransfer();
        data.items.add(new File(['{"moves": [{"time": 0.1, "angle_deg": 40}]}'], "mine.json"));
        const event = (type) => new DragEvent(type, { dataTransfer: data, bubbles: true, cancelable: true });
        document.body.dispatchEvent(event("dragenter"));
        globalThis.shaded = !document.getElementById("drop").hidden;
        document.body.dispatchEvent(event("drop"));
    """)
    page.wait("return app.settings.task === 'own:mine.json'")
    page.run("run.advance(400)")
    assert page.run("return globalThis.shaded && document.getElementById('drop').hidden")
    assert math.degrees(state(page)["mine"]["setpoint"]) == pytest.approx(40.0)


@needs_browser
def test_a_policy_bundle_of_ones_own_acts_as_the_shipped_one(page):
    from amulett_gym.laws.contenders import bundle_folder

    page.run("app.chooseLaw('pretrained:testbed'); app.input('setpoint', 0.8); run.advance(400)")
    shipped = state(page)
    page.run("app.choose({ task: 'free' })")
    folder = bundle_folder("pretrained:testbed")
    page.find("#open-files").send_keys("\n".join(str(path) for path in sorted(folder.iterdir())))
    page.wait("return app.settings.law.name.startsWith('own:')")
    page.run("app.restart(false); app.input('setpoint', 0.8); run.advance(400)")
    assert state(page) == shipped


@needs_browser
def test_a_changed_bundle_is_refused_by_its_file(page, tmp_path):
    from amulett_gym.laws.contenders import bundle_folder

    files = {path.name: path.read_bytes() for path in bundle_folder("pretrained:testbed").iterdir()}
    weights = bytearray(files["weights.safetensors"])
    weights[-1] ^= 1
    give(
        page,
        tmp_path,
        **{
            name.replace(".", "__"): content
            for name, content in {**files, "weights.safetensors": bytes(weights)}.items()
        },
    )
    assert "'weights.safetensors' was changed or damaged" in page.messages()
    del files["manifest.json"]
    give(page, tmp_path, **{name.replace(".", "__"): content for name, content in files.items()})
    assert "manifest.json" in page.messages()


@needs_browser
def test_a_tuned_law_of_ones_own_acts_as_the_shipped_one(page, tmp_path):
    import amulett_gym

    tuned = Path(amulett_gym.__file__).parent / "laws" / "tuned" / "testbed" / "parametric-mixed.json"
    page.run("app.chooseLaw('parametric'); app.input('setpoint', 0.8); run.advance(400)")
    shipped = state(page)
    give(page, tmp_path, mine__json=tuned.read_text())
    assert page.run("return app.settings.law.name") == "own:mine.json"
    page.run("app.restart(false); app.input('setpoint', 0.8); run.advance(400)")
    assert state(page) == shipped


@needs_browser
def test_a_law_that_was_tuned_in_another_loop_has_its_tensions(page, tmp_path):
    import amulett_gym

    tuned = Path(amulett_gym.__file__).parent / "laws" / "tuned" / "testbed" / "parametric-mixed.json"
    content = json.loads(tuned.read_text())
    content["recipe"]["control"] = "computed-torque"
    give(page, tmp_path, mine__json=json.dumps(content))
    assert page.run("return [app.settings.loop, app.settings.law.name]") == ["computed-torque", "own:mine.json"]
    path = tmp_path / "mine.json"
    law, _ = tuned_vector(str(path), load_profile("testbed"))
    assert page.run("return app.law().content.range") == list(law.range) == [0.0, 15.0]


@needs_browser
def test_a_scenario_of_samples_alone_is_taken(page, tmp_path):
    give(page, tmp_path, mine__json='{"setpoint": {"time": [0, 0.2], "angle_deg": [10, 30]}}')
    page.run("run.advance(200)")
    assert math.degrees(state(page)["mine"]["setpoint"]) == pytest.approx(30.0), page.messages()


@needs_browser
def test_the_table_holds_the_numbers_of_the_kernel(driver, tmp_path):
    scenario = tmp_path / "mine.json"
    moves = [{"time": 0.2, "angle_deg": 45.0}, {"time": 1.0, "angle_deg": 20.0, "duration": 0.4}]
    scenario.write_text(
        json.dumps({"moves": moves, "pushes": [{"time": 0.7, "duration": 0.1, "torque": 0.2}], "noise_seed": 7})
    )
    out, live, saved = tmp_path / "kernel.csv", tmp_path / "live.html", tmp_path / "saved"
    saved.mkdir()
    assert main(["simulate", "--law", "eq6", "--scenario", str(scenario), "--duration", "1.6", "--out", str(out)]) == 0
    assert main(["live", "--policy", "eq6", "--scenario", str(scenario), "--out", str(live), "--no-open"]) == 0
    page = Page(driver, live)
    page.open()
    page.run("run.advance(Math.round(1.6 / run.period))")
    page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(saved)})
    page.find("#save-csv").click()
    deadline = time.monotonic() + 60
    while not list(saved.glob("*.csv")) and time.monotonic() < deadline:
        time.sleep(0.05)
    (file,) = saved.glob("*.csv")
    table, kernel = read_table(file.read_text()), read_table(out.read_text())
    assert len(table["time_s"]) == len(kernel["time_s"]) == round(1.6 / 0.0025) + 1
    shared = [name for name in table if name in kernel]
    assert {"joint_angle_deg", "force_biceps_N", "command_triceps_deg", "joint_stiffness_Nm_per_rad"} <= set(shared)
    for name in shared:
        assert table[name] == pytest.approx(kernel[name], rel=1e-8, abs=1e-8), name
    assert table["eq6_joint_angle_deg"] == table["joint_angle_deg"]  # your law is eq. 6, too


def read_table(text: str) -> dict[str, list[float]]:
    header, *rows = csv.reader(io.StringIO(text))
    return {name: [float(row[k] or "nan") for row in rows] for k, name in enumerate(header)}


SIZES = ((1440, 900), (1280, 720), (1024, 768), (960, 700), (760, 1000), (390, 844), (320, 568), (3000, 1600))


@needs_browser
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_it_fits_every_screen(page, dark):
    page.open(dark=dark)
    page.run("run.advance(200)")
    for width, height in SIZES:
        page.resize(width, height, 2.0 if width < 600 else 1.0)
        page.find("#step").click()
        sharp = """
            return [...document.querySelectorAll("canvas")].every((each) =>
                Math.abs(each.width - each.clientWidth * devicePixelRatio) < 1.5)
        """
        assert page.wait(sharp), (width, "its pictures have the screen's pixels")
        assert page.run("return document.documentElement.scrollWidth <= innerWidth"), (width, "it scrolls sideways")
        cut = """
            const texts = document.querySelectorAll("button, .readings dd, .cost b, h1, .verdict");
            return [...texts].filter((each) => each.checkVisibility() && each.scrollWidth > each.clientWidth + 1)
                .map((each) => each.textContent)
        """
        assert page.run(cut) == [], (width, "texts are cut")
    assert page.errors() == []


@needs_browser
def test_it_survives_changes_of_size_while_it_runs(page):
    page.find("#play").click()
    for width, height in ((700, 500), (320, 480), (1600, 900), (50, 50), (1440, 900)):
        page.resize(width, height)
        before = page.run("return run.tick")
        page.wait("return run.tick > arguments[0]", before)
    assert page.errors() == []


def test_text_is_readable_on_its_background_in_both_themes():
    css = (Path(__file__).parents[2] / "amulett_gym" / "live" / "page" / "style.css").read_text()
    themes = [
        dict(re.findall(r"--(\w+): (#[0-9a-f]{6})\b", block))
        for block in re.findall(r":root \{(.*?)\}", css, re.DOTALL)
    ]
    assert len(themes) == 2
    for theme in themes:
        for name in ("ink", "muted", "accent", "biceps", "triceps", "setpoint", "external", "twin"):
            assert contrast(theme[name], theme["card"]) >= 4.5, (name, theme[name])
        assert contrast(theme["on-accent"] if "on-accent" in theme else theme["card"], theme["accent"]) >= 4.5


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours (WCAG 2.2)."""

    def luminance(colour: str) -> float:
        channels = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_curves_of_one_strip_differ_by_more_than_their_colour():
    script = (Path(__file__).parents[2] / "amulett_gym" / "live" / "page" / "strips.js").read_text()
    strips = re.findall(r"curves: \[(.*?)\n    \] \}", script, re.DOTALL)
    assert len(strips) == 6
    for strip in strips:
        shapes = re.findall(r'shape: "(\w+)"', strip)
        assert len(shapes) == len(set(shapes)) >= 2


PROFILES = (
    {"name": "a", "base": "testbed", "spring": {"beyond": "continued"}, "plant": {"orientation": "vertical"}},
    {"name": "b", "base": "simulation", "spring": {"beyond": "hard-stop", "stop_stiffness": 4e4}},
    {
        "name": "c",
        "base": "testbed",
        "loops": {"torque_stiffness": {"angle_weight": 30.0}},
        "sensors": {"encoder_bits": 12},
    },
    {"name": "d", "base": "testbed", "spring": {"free_length": 0.0}, "drives": {"stall_torque": 0.3}},
    {**load_fleet("plausible-held-out")[0].model_dump(mode="json"), "name": "e"},
)


@needs_browser
@pytest.mark.parametrize("content", PROFILES, ids=lambda content: content["name"])
def test_a_dropped_device_is_packed_as_python_packs_it(page, tmp_path, content):
    give(page, tmp_path, mine__yaml=yaml.safe_dump(content))
    assert page.run("return app.settings.device") == f"own:{content['name']}", page.messages()
    found = page.run("return app.data.devices.find((each) => each.id === app.settings.device).content")
    wanted = device_data(load_profile(content))
    assert set(wanted["unfit"]) == set(found["unfit"])
    for key in ("laws", "prices", "unfit"):  # its costs are in the base's units
        del wanted[key], found[key]
    tables, packed = wanted.pop("tables"), found.pop("tables")
    for name, table in tables.items():
        mine, theirs = (np.frombuffer(base64.b64decode(text)) for text in (packed[name], table))
        np.testing.assert_allclose(mine, theirs, rtol=1e-11, atol=1e-11 * abs(theirs).max(), err_msg=name)
    assert_same(found, wanted, "")
    page.run("app.input('setpoint', 0.5); run.advance(run.tick + 200)")
    assert np.isfinite(state(page)["mine"]["angle"]) and page.errors() == []


def assert_same(found: Any, wanted: Any, path: str) -> None:
    if isinstance(wanted, dict):
        assert set(found) == set(wanted), path
        for key in wanted:
            assert_same(found[key], wanted[key], f"{path}.{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), path
        for k, (mine, theirs) in enumerate(zip(found, wanted, strict=True)):
            assert_same(mine, theirs, f"{path}.{k}")
    else:
        assert found == (wanted if isinstance(wanted, str) else pytest.approx(wanted, rel=1e-11)), path


def test_the_command_puts_what_is_ones_own_first(tmp_path, capsys):
    profile, scenario, out = tmp_path / "mine.yaml", tmp_path / "task.json", tmp_path / "live.html"
    profile.write_text("name: </script><script>alert(1)</script>\nbase: testbed\nsensors: {encoder_bits: 12}\n")
    scenario.write_text('{"moves": [{"time": 0.1, "angle_deg": 40}]}')
    words = ["--profile", str(profile), "--scenario", str(scenario), "--policy", "computed-torque/constant:3"]
    assert main(["live", *words, "--out", str(out), "--no-open", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["loop"] == "computed-torque" and shown["law"] == "constant:3" and not shown["opened"]
    text = out.read_text()
    assert shown["bytes"] == out.stat().st_size and text.count("<script") == 2 and text.count("</script") == 2
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text).group(1))
    assert data["start"]["device"] == data["devices"][0]["id"] == "</script><script>alert(1)</script>"
    assert data["tasks"][0]["title"] == "task" and data["start"]["law"]["parameters"] == {"tension": 3.0}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--no-open"], "give --out FILE.html"),
        (["--no-open", "--out", "x.txt"], "has to end in .html or .htm"),
        (["--no-open", "--out", "x.html", "--loop", "torqe"], "did you mean 'torque'"),
        (["--no-open", "--out", "x.html", "--policy", "constnt:8"], "did you mean 'constant:<N>'"),
        (["--no-open", "--out", "x.html", "--policy", "eq6-held-printed"], "the page does not show 'eq6-held-printed'"),
        (["--no-open", "--out", "x.html", "--scenario", "nothing.json"], "nothing.json"),
    ],
)
def test_the_command_refuses_wrong_words(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["live", *words]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command_opens_the_page_and_says_where_it_is_if_it_cannot(tmp_path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("webbrowser.open", lambda address: asked.append(address) or len(asked) == 1)
    for opened in (True, False):
        assert main(["live", "--out", str(tmp_path / "live.html")]) == 0
        assert asked[-1] == (tmp_path / "live.html").as_uri()
        assert ("Open this address" in capsys.readouterr().out) is not opened
