"""The firmware as a loop of the page: the hex file in node and in the browser gives what it gives behind the host."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest
from live.browser import MISSING, Page, chromium, has_browser
from selenium.webdriver.common.action_chains import ActionChains

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.firmware.env import HardwareEnv
from amulett_gym.firmware.export import export
from amulett_gym.firmware.host import firmware_id
from amulett_gym.live.core import script
from amulett_gym.live.core.build import read_wasm
from amulett_gym.live.core.data import device_data, scenario_data
from amulett_gym.live.core.hex import DEVICE, FIRMWARE, HEX, LAW, OTHER_DEVICE, read_hex
from amulett_gym.live.page import build_page
from amulett_gym.profile import load_profile
from amulett_gym.tasks.scenario import Scenario

TICKS = 1600
SCENARIO = Scenario(
    moves=[{"time": 0.5, "angle_deg": 60.0}, {"time": 2.0, "angle_deg": 10.0, "duration": 0.5}],
    pushes=[{"time": 1.2, "torque": 0.2, "duration": 0.3}],
    device={"late_probability": 0.02},
    noise_seed=3,
)

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node found: apt-get install -y nodejs")
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason=NO_COMPILER)
needs_browser = pytest.mark.skipif(not has_browser(), reason=MISSING)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("firmware") / "exported"
    export(LAW, DEVICE, None, folder)
    return folder


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """Return a function that runs a text in node, with `core` and an input in JSON, and returns what it returns."""
    folder = tmp_path_factory.mktemp("node")
    (folder / "amulett.wasm").write_bytes(read_wasm())
    (folder / HEX).write_text(read_hex(), encoding="ascii")

    def run(code: str, **given: Any) -> Any:
        text = f"""{script()}
            const fs = require("node:fs"), input = JSON.parse(fs.readFileSync(0, "utf8"));
            const step = (arm, ticks) => {{
              const rows = [];
              for (let k = 0; k < ticks; k++) {{ arm.step(1); rows.push(arm.read()); }}
              return rows.map((read) => [
                ...read.commands, read.tensionSetpoint, read.agonist, read.angle, read.positionIse, ...read.effort,
              ]);
            }};
            Amulett.load(fs.readFileSync("amulett.wasm"), fs.readFileSync("{HEX}", "utf8"))
              .then((core) => {{ {code} }})
              .then((found) => process.stdout.write(JSON.stringify(found)));
        """
        (folder / "run.js").write_text(text, encoding="utf-8")
        result = subprocess.run(
            ["node", "run.js"], cwd=folder, input=json.dumps(given), capture_output=True, text=True, check=False
        )
        assert result.returncode == 0, result.stderr[-3000:]
        return json.loads(result.stdout)

    return run


@pytest.fixture(scope="module")
def options() -> dict[str, Any]:
    return {"device": device_data(load_profile(DEVICE)), "loop": FIRMWARE, "scenario": scenario_data(SCENARIO)}


@needs_node
@needs_compiler
def test_the_hex_file_is_that_of_the_packages_texts(node, folder):
    wanted = firmware_id((folder / "device.h").read_text(encoding="utf-8"))
    renew = "python -m amulett_gym.live.core.hex"
    assert node("return Amulett.firmware.make(core.hex).id;") == wanted, f"the firmware has changed: {renew}"


@needs_node
@needs_compiler
@pytest.mark.parametrize("transport", ["host-float", "chip"])
def test_a_run_is_that_of_the_firmware_behind_its_host(node, folder, options, transport):
    if transport == "chip" and any(shutil.which(tool) is None for tool in ("avr-gcc", "simavr")):
        pytest.skip("needs avr-gcc and simavr")
    ours = np.array(node("return step(core.arm(input.options), input.ticks);", options=options, ticks=TICKS))
    names = ("command_biceps", "command_triceps", "tension_setpoint", "agonist")
    names += ("angle", "position_ise", "effort_biceps", "effort_triceps")
    theirs = []
    with contextlib.closing(HardwareEnv(folder, transport)) as env:
        env.reset(seed=0, options={"scenario": SCENARIO})
        for _ in range(TICKS):
            env.episodes.tick()
            live = env.episodes.simulation.live(0)
            theirs.append([float(live[name]) for name in names])
    assert np.array_equal(ours[:, :4], np.array(theirs)[:, :4])  # what the chip answers
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    assert set(ours[:, 3]) == {-1.0, 1.0} and np.ptp(ours[:, 4]) > 0.9


@needs_node
def test_a_snapshot_holds_the_chip(node, options):
    first, again, other = node(
        """
        const arm = core.arm(input.options);
        step(arm, 300);
        const bytes = arm.snapshot(), first = step(arm, 400);
        arm.restore(bytes);
        const again = step(arm, 400), other = core.arm(input.options);
        other.restore(bytes);
        return [first, again, step(other, 400)];
        """,
        options=options,
    )
    assert first == again == other


@needs_node
def test_a_damaged_snapshot_of_the_chip_changes_nothing(node, options):
    first, again, errors = node(
        """
        const arm = core.arm(input.options), errors = [];
        step(arm, 100);
        const bytes = arm.snapshot(), size = Amulett.firmware.make(core.hex).size;
        const first = step(arm, 50);
        arm.restore(bytes);
        const moved = bytes.slice();
        moved[bytes.length - size + 1 + 16] ^= 2; // its program counter
        for (const wrong of [moved, bytes.slice(0, -1), bytes.slice(0, -size)]) {
          try { arm.restore(wrong); } catch (error) { errors.push(error.message); }
        }
        return [first, step(arm, 50), errors];
        """,
        options=options,
    )
    assert first == again
    assert ["chip is not at rest" in errors[0], *("another length" in error for error in errors[1:])] == [True] * 3


@needs_node
def test_another_device_and_another_law_are_refused(node, options):
    other = device_data(load_profile("simulation"))
    assert other["unfit"][FIRMWARE] == OTHER_DEVICE and FIRMWARE not in options["device"]["unfit"]
    wrong = [{**options, "device": other}]
    wrong += [
        {**options, "law": law} for law in ({"name": "eq6-held"}, {"name": "eq6", "parameters": {"nominal_tension": 9}})
    ]
    errors = node(
        """
        return input.wrong.map((options) => {
          try { core.arm(options); } catch (error) { return error.message; }
        });
        """,
        wrong=wrong,
    )
    assert OTHER_DEVICE in errors[0]
    assert all("the firmware has its own law" in error for error in errors[1:])


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "live.html"
    path.write_text(build_page(loop=FIRMWARE), encoding="utf-8")
    with chromium() as driver:
        page = Page(driver, path)
        page.resize(1440, 900)
        yield page


STATE = "return { ...run.state, tick: run.tick }"


@needs_browser
def test_the_page_plays_it_and_finds_every_moment_again(page):
    page.open()
    page.run("app.choose({ task: 'free' })")
    page.requests(), page.errors()
    assert not page.find("#law").is_enabled() and page.find("#mine-law").text == "eq. 6 on the chip"
    canvas, (x, y) = page.find("#mine-canvas"), page.place(0.0, 1.3)
    (u, v) = page.place(math.radians(50.0), 1.3)
    handle = page.run("return run.asked.setpoint")
    page.run("document.getElementById('play').click()")
    ActionChains(page.driver, duration=100).move_to_element_with_offset(canvas, x, y).click_and_hold().move_by_offset(
        u - x, v - y
    ).release().perform()
    page.wait("return run.time > 1")
    page.run("document.getElementById('play').click()")
    assert page.run("return run.events.length") > 0 and page.run("return run.asked.setpoint") != handle
    page.run("app.input('push', 0.2); run.advance(run.tick + 900); app.input('push', 0); run.advance(run.tick + 400)")
    end, middle = page.run(STATE), 900
    assert end["mine"]["failed"] is None and end["mine"] != end["twin"]
    page.run("run.seek(arguments[0])", middle)
    there = page.run(STATE)
    page.run("run.seek(arguments[0])", end["tick"])
    assert page.run(STATE) == end
    page.run("app.replay(false); run.advance(arguments[0])", middle)
    assert page.run(STATE) == there
    page.run("run.advance(arguments[0])", end["tick"])
    assert page.run(STATE) == end
    link = page.promise("app.link()")["value"]
    page.open(f"#{link}")
    assert page.run(STATE) == end
    assert page.run("return app.settings.loop") == FIRMWARE
    assert page.errors() == []


@needs_browser
def test_laws_and_other_devices_are_refused_with_the_reason(page):
    page.open()
    page.run("app.choose({ task: 'free' })")
    law = page.run("return app.settings.law")
    page.run("app.chooseLaw('constant')")
    assert "its own law" in page.messages() and page.run("return app.settings.law") == law
    page.run("app.choose({ device: 'simulation' })")
    assert page.run("return app.settings.loop") == "decentralized"
    assert page.find("#law").is_enabled()
    page.run("app.choose({ loop: arguments[0] })", FIRMWARE)
    assert OTHER_DEVICE in page.messages() and page.run("return app.settings.loop") == "decentralized"
    disabled = page.run("""
        const options = [...document.querySelectorAll("#loop option")];
        return options.filter((each) => each.disabled).map((each) => [each.value, each.title]);
    """)
    assert disabled == [[FIRMWARE, OTHER_DEVICE]]


@needs_browser
def test_it_says_that_it_cannot_keep_real_time(page):
    page.open()
    assert page.find("#pace").text == ""
    page.run("""
        const { advance } = app.run;
        app.run.advance = (tick) => {
          const end = performance.now() + 150;
          while (performance.now() < end) {}
          advance(tick);
        };
        document.getElementById("play").click();
    """)
    page.wait("return document.getElementById('pace').textContent.startsWith('slower than real time')")
    page.run("document.getElementById('play').click()")
    page.wait("return document.getElementById('pace').textContent === ''")
