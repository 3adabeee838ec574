"""The simulation in a browser: node runs the very WebAssembly and scripts, and gives the kernel's numbers."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import subprocess
from importlib import util
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from amulett_gym import FAILURES, load_policy
from amulett_gym.c.build import NO_COMPILER as C_COMPILER
from amulett_gym.c.build import find_compiler
from amulett_gym.envs.transition import OBSERVATION_SCALES, OBSERVATIONS
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.laws.bundle import PolicyDescription, TrainingEnv, write_bundle
from amulett_gym.laws.features import FEATURES, features
from amulett_gym.laws.memory import MEMORY, SPANS, Memory
from amulett_gym.live.core import script
from amulett_gym.live.core.bench import measure
from amulett_gym.live.core.build import NO_COMPILER, WASM, build, description, read_wasm, with_section
from amulett_gym.live.core.data import device_data, policy_data, scenario_data
from amulett_gym.live.core.hex import HEX, read_hex
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.layout import CONTROLS
from amulett_gym.tasks.scenario import Scenario, pack, pack_path, unpack
from amulett_gym.tasks.suites import SUITES, episode_keys, sample

PROFILES = ("testbed", "simulation")
PLAY = Path(__file__).with_name("play.js")

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no node found: apt-get install -y nodejs")

STATE = {
    "angle": "angle",
    "velocity": "velocity",
    "setpoint": "setpoint",
    "tension.0": "force_biceps",
    "tension.1": "force_triceps",
    "commands.0": "command_biceps",
    "commands.1": "command_triceps",
    "driveAngles.0": "drive_biceps",
    "driveAngles.1": "drive_triceps",
    "measured.tension.0": "estimate_biceps",
    "measured.tension.1": "estimate_triceps",
    "agonist": "agonist",
    "contact": "contact_torque",
    "push": "push_torque",
    "positionIse": "position_ise",
    "tensionIse": "tension_ise",
    "isav.0": "isav_biceps",
    "effort.1": "effort_triceps",
    "driveEffort": "drive_effort",
}
"""What an arm reads -> the kernel's name of it."""


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """Return a function that runs a job in node (`play.js`)."""
    folder = tmp_path_factory.mktemp("node")
    (folder / "core.js").write_text(script(), encoding="utf-8")
    (folder / WASM).write_bytes(read_wasm())
    (folder / HEX).write_text(read_hex(), encoding="ascii")

    def run(**job: Any) -> dict[str, Any]:
        command = ["node", str(PLAY), str(folder / "core.js"), str(folder / WASM), str(folder / HEX)]
        result = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr[-3000:]
        return json.loads(result.stdout)

    return run


@pytest.fixture(scope="module")
def devices():
    return {name: device_data(load_profile(name)) for name in PROFILES}


def value_of(row: dict[str, Any], path: str) -> float:
    found: Any = row
    for key in path.split("."):
        found = found[int(key)] if key.isdigit() else found[key]
    return float(found)


def kernel_rows(simulation: Simulation, ticks: int, every: int) -> list[dict[str, float]]:
    rows = []
    for tick in range(0, ticks + 1, every):
        live = simulation.live(0)
        rows.append({path: float(live[name]) for path, name in STATE.items()})
        if tick < ticks:
            simulation.advance(every)
    return rows


def apart(rows: list[dict[str, Any]], wanted: list[dict[str, float]]) -> float:
    """Return by how much a quantity of `STATE` differs at most, relative to its largest value or to 1."""
    ours = np.array([[value_of(row, path) for path in STATE] for row in rows])
    theirs = np.array([[row[path] for path in STATE] for row in wanted])
    return float((np.abs(ours - theirs).max(axis=0) / np.maximum(np.abs(theirs).max(axis=0), 1.0)).max())


@needs_node
@pytest.mark.parametrize("name", PROFILES)
def test_the_papers_step_equals_the_kernels(node, devices, name):
    scenario = Scenario(moves=[{"time": 1.0, "angle_deg": 60.0}], noise_seed=3)
    ticks, period = 2000, devices[name]["parameters"]["control_period"]
    options = {"device": devices[name], "law": {"name": "eq6"}, "scenario": scenario_data(scenario)}
    [rows] = node(arms=[{"options": options, "ticks": ticks, "every": 1}])["arms"]
    simulation = Simulation(load_profile(name), tension_law="eq6")
    simulation.reset(pack(scenario, load_profile(name)))
    assert apart(rows, kernel_rows(simulation, ticks, 1)) < 1e-9
    assert rows[-1]["time"] == pytest.approx(ticks * period)
    assert np.degrees(rows[-1]["angle"]) == pytest.approx(60.0, abs=3.0)


ALL_AT_ONCE = Scenario(
    initial_angle_deg=20.0,
    initial_tension=7.0,
    moves=[{"time": 0.3, "angle_deg": 60.0}, {"time": 1.2, "angle_deg": 30.0, "duration": 0.6}],
    wave={"amplitude_deg": 4.0, "frequency": 1.5, "chirp": 0.5, "time": 0.5, "duration": 2.0},
    pushes=[{"time": 0.8, "duration": 0.1, "torque": 0.2}, {"time": 2.0, "duration": 0.8, "torque": -0.2, "rise": 0.3}],
    shake={"rms": 0.05, "bandwidth": 3.0, "time": 0.2, "duration": 2.5},
    obstacle={"angle_deg": 55.0, "stiffness": 20.0, "damping": 0.05},
    payload={"mass": 0.2, "arm": 0.15},
    orientation="vertical",
    device={
        "spring_biceps": 1.1,
        "pulley_triceps": 0.95,
        "inertia": 1.2,
        "damping": 0.8,
        "noise": 2.0,
        "encoder_bias_deg": 1.0,
        "slider_bias_biceps": 2e-4,
        "late_probability": 0.2,
    },
    measure_from=0.25,
    noise_seed=2**63 + 11,
)
SAMPLED = Scenario(
    setpoint={"time": [0.2, 0.5, 0.5, 1.4, 2.0], "angle_deg": [5.0, 30.0, 45.0, 10.0, 12.5]}, noise_seed=5
)
HELD = Scenario(setpoint={**SAMPLED.setpoint.model_dump(), "interpolation": "hold"}, noise_seed=6)
MANY_MOVES = Scenario(
    moves=[{"time": 0.2 * k, "angle_deg": 10.0 * (k % 3), "duration": 0.1 * (k % 2)} for k in range(14)], noise_seed=7
)


def drawn(profile: Profile, suite: str, split: str, seed: int) -> Scenario:
    seeds = np.array([seed], dtype=np.uint64)
    return unpack(sample(suite, episode_keys(seeds, np.zeros_like(seeds), split), profile, split=split)[0])


@needs_node
@pytest.mark.parametrize("name", PROFILES)
def test_all_loops_equal_the_kernels_in_all_scenarios(node, devices, name):
    profile = load_profile(name)
    ticks = round(3.0 / profile.loop.control_period)
    suites = [drawn(profile, suite, "shifted", 3) for suite in SUITES]
    scenarios = [ALL_AT_ONCE, SAMPLED, HELD, MANY_MOVES, *suites]
    played = [(loop, scenario) for loop in CONTROLS for scenario in scenarios]
    jobs = [
        {
            "options": {"device": devices[name], "loop": loop, "scenario": scenario_data(scenario)},
            "ticks": ticks,
            "every": ticks // 30,
        }
        for loop, scenario in played
    ]
    results = node(arms=jobs)["arms"]
    moved = 0.0
    for (loop, scenario), rows in zip(played, results, strict=True):
        simulation = Simulation(profile, control=loop, tension_law="eq6")
        simulation.reset(pack(scenario, profile), paths=[pack_path(scenario)])
        wanted = kernel_rows(simulation, ticks, ticks // 30)
        assert apart(rows, wanted) < 1e-9, (loop, scenario)
        assert (rows[-1]["failed"] or "") == FAILURES[int(simulation.read("failure")[0])]
        stiffness = float(simulation.read("stiffness_setpoint")[0])
        expected = None if np.isnan(stiffness) else pytest.approx(stiffness, rel=1e-9)
        assert rows[-1]["stiffnessSetpoint"] == expected
        moved = max(moved, np.ptp([row["angle"] for row in wanted]))
    assert moved > 0.5


LAWS = {
    "constant:10": {"name": "constant", "parameters": {"tension": 10.0}},
    "eq6": {"name": "eq6"},
    "eq6-printed": {"name": "eq6-printed"},
    "eq6-held": {"name": "eq6-held"},
    "eq6-held-printed": {"name": "eq6-held-printed"},
    "eq6-tuned": {"name": "eq6-tuned"},
    "parametric": {"name": "parametric"},
}
LEARNED = ("pretrained", "pretrained:testbed", "pretrained:device")


def contenders_of(name: str) -> dict[str, tuple[str, str]]:
    """Return contenders of a device: name -> loop and law."""
    learned = LEARNED if name == "testbed" else LEARNED[:1]
    laws = LAWS if name == "testbed" else {law: LAWS[law] for law in LAWS if law not in ("eq6-tuned", "parametric")}
    own = {law: ("decentralized", law) for law in (*laws, *learned)}
    loops = ("co-rotation", "torque-stiffness", "cascade")
    return own | {f"{loop}/{law}": (loop, law) for loop in loops for law in ("constant:10", "eq6", *learned[:1])}


@needs_node
@pytest.mark.parametrize("name", PROFILES)
def test_costs_of_all_laws_are_those_of_evaluate(node, devices, name):
    profile = load_profile(name)
    scenarios = [
        drawn(profile, "hold-push", "held-out", 1),
        drawn(profile, "steps", "held-out", 2),
        ALL_AT_ONCE.model_copy(update={"measure_from": 0.0, "payload": None}),
    ]
    duration, names = 4.0, contenders_of(name)
    results = evaluate(list(names), "mixed", profile, scenarios=scenarios, duration=duration)
    ticks = round(duration / profile.loop.control_period)
    jobs, files = [], {law: policy_data(law) for law in LEARNED}
    for loop, law in names.values():
        for scenario in scenarios:
            options = {"device": devices[name], "loop": loop, "scenario": scenario_data(scenario), "law": LAWS.get(law)}
            jobs.append({"options": options, "policy": files.get(law), "ticks": ticks, "every": ticks})
    rows = iter(played[-1] for played in node(arms=jobs)["arms"])
    for contender in names:
        values = results.values[contender]
        for k in range(len(scenarios)):
            row, metric = next(rows), {key: float(value[k]) for key, value in values.items()}
            assert row["failed"] is None and not results.failures[contender][k]
            assert row["cost"] == pytest.approx(metric["cost"], rel=1e-9), contender
            assert row["controlCost"] == pytest.approx(metric["control_cost"], rel=1e-9), contender
            assert row["costs"]["tension"] == pytest.approx(metric["cost_tension"], rel=1e-9, abs=1e-12)
            assert row["positionIse"] * np.degrees(1.0) ** 2 == pytest.approx(metric["position_ise"], rel=1e-9)


@needs_node
def test_an_agents_steps_are_those_of_the_environment(node, devices):
    keywords = {"profile": "testbed", "agent_period": 0.05, "action_delay": 7, "observation_noise": 0.01}
    env = gym.make("Amulett/Tension-v0", **keywords)
    policy, scenario = load_policy("eq6-held", env), ALL_AT_ONCE
    observation, _ = env.reset(options={"scenario": scenario})
    simulation, wanted = env.unwrapped.episodes.simulation, []
    for _ in range(60):
        wanted.append({path: float(simulation.live(0)[of]) for path, of in STATE.items()})
        observation, *_ = env.step(policy(observation))
    options = {"device": devices["testbed"], "scenario": scenario_data(scenario), "law": LAWS["eq6-held"]}
    options |= {"agentPeriod": 0.05, "actionDelay": 7, "observationNoise": 0.01}
    [rows] = node(arms=[{"options": options, "ticks": 59 * 20, "every": 20}])["arms"]
    assert apart(rows, wanted) < 1e-9


@needs_node
@pytest.mark.parametrize("shape", [("tanh", "tanh", 3, 0.3), ("relu", "clip", 1, 1.0)])
def test_a_bundle_of_ones_own_acts_as_in_the_environment(node, devices, tmp_path, shape):
    activation, output, history, share = shape
    size = history * (len(OBSERVATIONS) + len(FEATURES) + len(MEMORY))
    draw, sizes = np.random.default_rng(1), [size, 16, 1]
    layers = [
        (draw.normal(size=(n, m)).astype(np.float32) / np.sqrt(m), draw.normal(size=n).astype(np.float32) / 4)
        for m, n in pairwise(sizes)
    ]
    policy = PolicyDescription(
        network={"layers": sizes, "activation": activation, "output": output},
        observations=list(OBSERVATIONS),
        observation_scales=OBSERVATION_SCALES,
        features=list(FEATURES),
        memory=list(MEMORY),
        tension_range=[4.5, 12.0],
        agent_period=0.02,
        follow=share,
        history=history,
    )
    trained = TrainingEnv(id="Amulett/Tension-v0", keywords={"profile": "testbed"}, max_episode_steps=100)
    folder = write_bundle(tmp_path / "own", layers, policy, trained, {})
    env = gym.make("Amulett/Tension-v0", profile="testbed", tension_range=(4.5, 12.0))
    acts, simulation, wanted = load_policy(folder, env), env.unwrapped.episodes.simulation, []
    observation, _ = env.reset(options={"scenario": ALL_AT_ONCE})
    for _ in range(100):
        wanted.append({path: float(simulation.live(0)[of]) for path, of in STATE.items()})
        observation, *_ = env.step(acts(observation))
    options = {"device": devices["testbed"], "scenario": scenario_data(ALL_AT_ONCE)}
    [rows] = node(arms=[{"options": options, "policy": policy_data(folder), "ticks": 99 * 8, "every": 8}])["arms"]
    assert apart(rows, wanted) < 1e-9
    assert np.ptp([row["tensionSetpoint"] for row in rows]) > 0.5


@needs_node
def test_live_inputs_are_what_a_scenario_says(node, devices):
    """A setpoint that is set before a tick is a move at its end; a push acts from the tick on, an obstacle at once."""
    period = load_profile("testbed").loop.control_period
    scenario = Scenario(
        moves=[{"time": 41 * period, "angle_deg": 50.0}, {"time": 401 * period, "angle_deg": 20.0, "duration": 0.5}],
        pushes=[{"time": 200 * period, "duration": 40 * period, "torque": 0.25}],
        obstacle={"angle_deg": 45.0, "stiffness": 20.0},
        payload={"mass": 0.3, "arm": 0.13},
        noise_seed=1,
    )
    inputs = [
        [0, "setObstacle", {"angle": np.radians(45.0), "side": 1, "stiffness": 20.0}],
        [0, "setPayload", 0.3, 0.13],
        [40, "setSetpoint", np.radians(50.0)],
        [200, "setPush", 0.25],
        [240, "setPush", 0.0],
        [400, "setSetpoint", np.radians(20.0), 0.5],
    ]
    for loop in ("decentralized", "computed-torque"):
        common = {"device": devices["testbed"], "loop": loop, "law": LAWS["constant:10"]}
        written = {"options": {**common, "scenario": scenario_data(scenario)}, "ticks": 800, "every": 20}
        live = {"options": {**common, "scenario": {"noise_seed": 1, "family": "contact"}}, "ticks": 800, "every": 20}
        first, second = node(arms=[written, {**live, "inputs": inputs}])["arms"]
        wanted = [{path: value_of(row, path) for path in STATE} for row in first]
        assert apart(second, wanted) < 1e-9
        assert second[-1]["cost"] == pytest.approx(first[-1]["cost"], rel=1e-9)


@needs_node
def test_a_snapshot_gives_the_same_bits_again(node, devices):
    code = """
    const {arms, bytesOf} = input;
    const law = {name: "policy", policy: core.readPolicy(bytesOf(arms[0].policy))};
    const found = [];
    for (const {options} of arms) {
      const arm = core.arm({...options, law}), other = core.arm({...options, law: {name: "eq6"}});
      arm.setSetpoint(0.8); arm.step(333); arm.setPush(0.1); arm.step(50);
      const moment = arm.snapshot();
      arm.step(400); const first = arm.read();
      other.restore(moment); other.step(400); const second = other.read();
      arm.restore(moment); arm.step(400); const third = arm.read();
      found.push([first, second, third]);
    }
    return found;
    """
    jobs = [
        {
            "options": {"device": devices["testbed"], "loop": loop, "scenario": scenario_data(scenario)},
            "policy": policy_data("pretrained"),
            "ticks": 0,
        }
        for loop, scenario in (("decentralized", ALL_AT_ONCE), ("torque", SAMPLED))
    ]
    for first, second, third in node(arms=jobs, code=code)["returned"]:
        assert first == second == third


@needs_node
def test_a_damaged_snapshot_is_refused_and_changes_nothing(node, devices):
    code = """
    const {arms: [{options}]} = input, arm = core.arm(options);
    arm.setSetpoint(0.8); arm.step(100);
    const good = arm.snapshot(), before = JSON.stringify(arm.read()), texts = [];
    const refuse = (bytes) => {
      try { arm.restore(bytes); texts.push("taken"); } catch (error) {
        if (!(error instanceof Amulett.base.AmulettError)) throw error;
        texts.push(error.message);
      }
      if (JSON.stringify(arm.read()) !== before) texts.push("changed");
    };
    const length = new DataView(good.buffer).getUint32(0, true), {state, scenario} = core.layout.records;
    const altered = (at, value, set = "setFloat64") => {
      const bytes = good.slice();
      new DataView(bytes.buffer)[set](at, value, true);
      return bytes;
    };
    refuse(good.subarray(0, 100)); refuse(new Uint8Array(0)); refuse("text"); refuse(null);
    refuse(altered(0, 4e9, "setUint32"));
    refuse(altered(4 + length + state.fields.angle[1], NaN));
    refuse(altered(4 + length + state.fields.move[1], 1000n, "setBigInt64"));
    refuse(altered(4 + length + state.size + scenario.fields.push_count[1], 100, "setInt8"));
    refuse(new TextEncoder().encode("x".repeat(good.length)));
    const swapped = new TextDecoder("latin1").decode(good).replace('"phase":', '"phase":9');
    refuse(Uint8Array.from(swapped, (letter) => letter.charCodeAt(0)).subarray(0, good.length));
    arm.restore(good);
    return texts;
    """
    job = {"options": {"device": devices["testbed"], "law": LAWS["constant:10"], "seed": 1}, "ticks": 0}
    texts = node(arms=[job], code=code)["returned"]
    assert "taken" not in texts and "changed" not in texts
    assert len(texts) == 10 and all(text.startswith("the snapshot") for text in texts)


REFUSED = {
    "unknown loop 'cascad'; choose from .*cascade.*; did you mean 'cascade'": {"loop": "cascad"},
    "unknown law 'eq7'.*did you mean 'eq6'": {"law": {"name": "eq7"}},
    "unknown parameter 'tensoin' of 'constant'; did you mean 'tension'": {
        "law": {"name": "constant", "parameters": {"tensoin": 3}}
    },
    "a tension of 40 N: the actions in this loop reach from 4 to 15 N": {
        "law": {"name": "constant", "parameters": {"tension": 40}}
    },
    "'base' of 'parametric' .N. is 99; it has to be from": {"law": {"name": "parametric", "parameters": {"base": 99}}},
    "scenario: unknown key 'movs'; did you mean 'moves'": {"scenario": {"movs": []}},
    "scenario: 'pushes.0.torque' is 1000; it has to be at most 100": {
        "scenario": {"pushes": [{"time": 0, "duration": 1, "torque": 1000}]}
    },
    "scenario: 'moves.1' begins before": {
        "scenario": {"moves": [{"time": 1, "angle_deg": 1, "duration": 1}, {"time": 1.5, "angle_deg": 1}]}
    },
    "'initial_angle_deg' is 160; the device's limit": {"scenario": {"initial_angle_deg": 160}},
    "'wearer' is given": {"scenario": {"wearer": {}}},
    "cannot hold the arm where it begins": {"scenario": {"initial_tension": 5000}},
    "the seed is -1": {"seed": -1},
    "acts every 0.0213 s": {"agentPeriod": 0.0213, "law": {"name": "constant"}},
    "unknown option of an arm 'seeed'; .*did you mean 'seed'": {"seeed": 1},
}


@needs_node
def test_wrong_options_are_refused_by_name(node, devices):
    jobs = [{"options": {"device": devices["testbed"], **options}} for options in REFUSED.values()]
    wrong = {**devices["testbed"], "parameters": {**devices["testbed"]["parameters"], "joint_radius": "much"}}
    short = {**devices["testbed"], "tables": {**devices["testbed"]["tables"], "force_table": "AAAA"}}
    jobs += [{"options": {"device": device}} for device in (wrong, short, {"name": "x"}, 3)]
    texts = node(refused=jobs)["refused"]
    patterns = [*REFUSED, "'joint_radius' is 'much'; it has to be a finite number", "'force_table' has 3 bytes"]
    patterns += ["the device is {", "the device is 3"]
    for text, pattern in zip(texts, patterns, strict=True):
        assert text is not None and re.search(pattern, text), (pattern, text)


@needs_node
def test_a_loop_that_does_not_fit_says_why(node):
    profile = load_profile({"base": "testbed", "loops": {"feedback_linearisation": {"taut_force": 500.0}}})
    options = {"device": device_data(profile), "loop": "feedback-linearisation"}
    [text] = node(refused=[{"options": options}])["refused"]
    assert "does not fit the device" in text and "taut_force" in text


def broken(files: dict[str, bytes], name: str, change: Any, signed: bool = True) -> dict[str, str]:
    """Return a bundle's files in base64 with one changed, and with a manifest that fits it if `signed`."""
    found = {**files, name: change(files[name])}
    if signed and name != "manifest.json":
        manifest = json.loads(found["manifest.json"])
        manifest["sha256"][name] = hashlib.sha256(found[name]).hexdigest()
        found["manifest.json"] = json.dumps(manifest).encode()
    return {key: base64.b64encode(value).decode() for key, value in found.items()}


def edited(**changes: Any) -> Any:
    return lambda content: json.dumps({**json.loads(content), **changes}).encode()


@needs_node
def test_damaged_bundles_are_refused_by_file_and_key(node, devices):
    files = {name: base64.b64decode(text) for name, text in policy_data("pretrained:device").items()}
    weights = "weights.safetensors"
    infinite = files[weights][:-4] + np.float32(np.inf).tobytes()
    bad_network = {**json.loads(files["policy.json"])["network"], "activation": "x"}
    without_env = {key: text for key, text in policy_data("pretrained:device").items() if key != "env.json"}
    cases = [
        ("was changed or damaged", broken(files, weights, lambda content: content[:-1] + b"x", signed=False)),
        ("not a valid safetensors", broken(files, weights, lambda content: content[:-4])),
        ("not a valid safetensors", broken(files, weights, lambda content: b"\xff" * 40)),
        ("not finite", broken(files, weights, lambda content: infinite)),
        ("is no JSON", broken(files, "policy.json", lambda content: b"{")),
        ("'version' is 2; it has to be 1", broken(files, "policy.json", edited(version=2))),
        ("unknown key 'folow'; did you mean 'follow'", broken(files, "policy.json", edited(folow=1))),
        ("observations are not those", broken(files, "policy.json", edited(observations=["angle"]))),
        ("'tension_range' is", broken(files, "policy.json", edited(tension_range=[9, 4]))),
        ("it has to map 2 times", broken(files, "policy.json", edited(history=2))),
        ("Drives-v0", broken(files, "policy.json", edited(mean_angle_range=90.0))),
        ("'network.activation' is 'x'", broken(files, "policy.json", edited(network=bad_network))),
        ("'env.json' of the policy bundle is missing", without_env),
        ("is no file of a policy bundle", {**broken(files, weights, bytes), "virus.exe": "AAAA"}),
    ]
    texts = node(refused=[{"options": {"device": devices["testbed"]}, "policy": case} for _, case in cases])["refused"]
    for text, (pattern, _) in zip(texts, cases, strict=True):
        assert text is not None and pattern in text, (pattern, text)


@needs_node
def test_features_and_averaged_quantities_are_in_the_order_of_their_names(node):
    draw = np.random.default_rng(3)
    seen = draw.uniform(-1.0, 1.0, (40, len(OBSERVATIONS))).round(6)
    seen[:, OBSERVATIONS.index("agonist")] = np.sign(seen[:, OBSERVATIONS.index("agonist")])
    code = f"""
    const rows = {json.dumps(seen.tolist())}, {{features, quantities}} = Amulett.policy;
    const before = (k) => rows[Math.max(k - 1, 0)], of = core.layout;
    return rows.map((row, k) => [features(of, row, [4, 15]), quantities(of, row, before(k))]);
    """
    returned = node(code=code)["returned"]
    np.testing.assert_allclose([row[0] for row in returned], features(seen, (4.0, 15.0)), atol=1e-14)
    memory = Memory(1)
    memory.add(seen[:1])
    for k in range(1, 40):
        before = memory.means[0].copy()
        memory.add(seen[k : k + 1])
        shares = 1.0 / np.minimum(k + 1, np.repeat(SPANS, len(MEMORY) // len(SPANS)))
        averaged = before + shares * (np.tile(returned[k][1], len(SPANS)) - before)
        np.testing.assert_allclose(memory.means[0], averaged, atol=1e-13)


@pytest.mark.slow
@pytest.mark.skipif(util.find_spec("ziglang") is None, reason=NO_COMPILER)
def test_the_file_in_the_package_is_that_of_its_texts():
    assert build() == read_wasm(), "the C texts or the layout have changed: python -m amulett_gym.live.core.build"


@needs_node
@pytest.mark.slow
@pytest.mark.skipif(find_compiler() is None, reason=C_COMPILER)
def test_speeds_are_measured_of_all_loops():
    found = measure(load_profile("testbed"), ticks=2000, rounds=1)
    assert list(found) == list(CONTROLS)
    assert min(min(rates) for rates in found.values()) > 0.0


def test_the_files_layout_is_that_of_the_records():
    """Also without the compiler."""
    content = json.dumps(description()).encode()
    assert read_wasm().endswith(content), "a layout, name or key has changed: python -m amulett_gym.live.core.build"


def test_a_section_follows_the_format_of_webassembly():
    assert with_section(b"\0asm", "ab", b"c" * 200) == b"\0asm" + b"\0" + b"\xcb\x01" + b"\x02ab" + b"c" * 200
