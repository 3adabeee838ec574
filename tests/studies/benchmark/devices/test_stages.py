"""The benchmark over devices, end to end on a tiny description: what it measures, keeps and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from amulett_agents.config import ADAPTATION
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.evaluation.runner import evaluate
from amulett_gym.fleet import load_fleet
from amulett_gym.profile import load_profile
from amulett_gym.storage.provenance import read_provenance
from amulett_gym.studies.benchmark import episodes, runs
from amulett_gym.studies.benchmark.devices.description import (
    DevicesBenchmark,
    load_fleets,
    parse_devices_benchmark,
    quick,
)
from amulett_gym.studies.benchmark.devices.report import MARKS
from amulett_gym.studies.benchmark.devices.stages import check_devices_benchmark, run_devices_benchmark


def device(name, mass):
    return {"name": name, "base": "testbed", "plant": {"masses": [{"mass": mass, "arm": 0.13}]}}


JUDGED = [device("heavy", 0.3), device("light", 0.1), device("medium", 0.16)]
GAINS = {"name": "slow", "base": "testbed", "loop": {"position": {"kp": 0.02}}}
SHORT = [
    *("env.max_episode_steps=100", "network.hidden=[8]", "num_envs=16", "total_steps=512", "ppo.n_steps=16"),
    *("ppo.batch_size=64", "validation.every_steps=256", "validation.episodes=4", "checkpoint_seconds=0.0"),
]
TINY = {
    "fleets": {"train": [device("a", 0.2), device("b", 0.25)], "choose": [device("c", 0.22)], "judge": JUDGED},
    "episodes": 4,
    "seed": 0,
    "duration": 2.0,
    "contenders": ["position-only", "parametric:mixed"],
    "laws": ["constant"],
    "budget": 3000,
    "constant_scenarios": 2,
    "learned": {"mine": {"set": SHORT, "seeds": [3, 4]}},
    "best_learned": "mine",
    "specialists": {"devices": 1, "set": ["total_steps=256"]},
    "adaptation": {"devices": 2, "set": [*SHORT, "total_steps=256", "ppo.critic_steps=null"]},
    "bootstrap": {"resamples": 100},
}

WITH_GAINS = {**TINY, "eq6_gains": "gains.yaml"}


def described(folder: Path, content: dict) -> Path:
    path = folder / "tiny.yaml"
    (folder / "gains.yaml").write_text(yaml.safe_dump(GAINS))
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Run a benchmark, and return its folder."""
    folder = tmp_path_factory.mktemp("devices")
    (folder / "doc.md").write_text("# Title\n\n{}\n\n{}\n".format(*MARKS))
    words = ["benchmark", "--config", str(described(folder, WITH_GAINS)), "--out", str(folder / "out")]
    assert main([*words, "--doc", str(folder / "doc.md")]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def found(done):
    return json.loads((done / "benchmark.json").read_text())


def test_it_writes_numbers_tables_figures_a_page_and_a_document(done, found):
    assert {path.stem for path in (done / "tables").iterdir()} == {
        *(
            "claims",
            "contenders",
            "lower",
            "families",
            "families_to_laws",
            "devices",
            "adaptation",
            "seeds",
            "budgets",
            "costs",
        )
    }
    head, *rows = (done / "tables" / "costs.csv").read_text().splitlines()
    assert head == "entry,seed,device,scenario,family,cost"
    assert len(rows) == 4 * (6 * 3 + 2 * 3 + 1 + 2) and rows[4 * 3].startswith("position-only,,heavy,0,")
    assert {path.stem for path in (done / "figures").iterdir()} == {"devices", "families", "learning"}
    page, document = (done / "benchmark.html").read_text(), (done.parent / "doc.md").read_text()
    assert page.count("<svg") == 3 and "<script" not in page
    assert found["verdict"].split(",")[0] in page and "### By device" in document
    assert (done.parent / "images" / "doc_devices.png").exists()
    assert found["fleets"] == {"train": ["a", "b"], "choose": ["c"], "judge": ["heavy", "light", "medium"]}
    assert list(found["entries"]) == [
        *("eq6", "position-only", "parametric:mixed", "eq6-with-gains", "best-constant", "own-constant"),
        *("mine", "specialist", "adapted"),
    ]
    assert read_provenance(done).kind == "benchmark"


def test_costs_are_those_of_paired_comparisons_on_each_device(done, found):
    bundles = [str(done / "runs" / "mine" / f"seed-{seed}") for seed in (3, 4)]
    costs = []
    for profile in JUDGED:
        own = f"constant:{found['constants']['of_devices'][profile['name']]['tension']:g}"
        values = evaluate([own, *bundles], suite="mixed", profile=profile, episodes=4, duration=2.0).values
        costs.append([values[name]["cost"].sum() for name in ("eq6", own, *bundles)])
        on_device = found["devices"][profile["name"]]["ratio_to_eq6"]
        assert on_device["own-constant"]["mean"] == pytest.approx(costs[-1][1] / costs[-1][0], rel=1e-12)
        assert on_device["mine"]["mean"] == pytest.approx(np.mean(costs[-1][2:]) / costs[-1][0], rel=1e-12)
    eq6, own, *learned = np.array(costs).T
    mine = found["results"]["mine"]
    assert mine["ratio"]["eq6"]["mean"] == pytest.approx(np.mean(learned, axis=0).sum() / eq6.sum(), rel=1e-12)
    assert mine["ratio"]["own-constant"]["mean"] == pytest.approx(np.mean(learned, axis=0).sum() / own.sum(), rel=1e-12)
    assert mine["seeds"] == pytest.approx([each.sum() / 12 for each in learned], rel=1e-12)
    assert mine["lower_on"]["eq6"] == {"count": int((np.mean(learned, axis=0) < eq6).sum()), "devices": 3}
    worst = np.mean(learned, axis=0) / eq6
    assert mine["worst"]["ratio_to_eq6"] == pytest.approx(worst.max(), rel=1e-12)
    assert mine["worst"]["device"] == JUDGED[int(worst.argmax())]["name"]


def test_eq6_also_plays_with_other_gains_in_the_same_unit(done, found):
    heavy = load_profile(JUDGED[0])
    there = heavy.model_copy(
        update={"loop": heavy.loop.model_copy(update={"position": load_profile(GAINS).loop.position})}
    )
    shared = {"suite": "mixed", "episodes": 4, "duration": 2.0}
    slow, eq6 = (evaluate(["eq6"], profile=profile, **shared).values["eq6"] for profile in (there, heavy))
    kept = np.load(done / "episodes" / "heavy" / "held-out" / "mixed" / "eq6-with-gains.npz")
    values = dict(zip(kept["metrics"].tolist(), kept["values"], strict=True))
    assert np.array_equal(values["position_ise"], slow["position_ise"])
    assert not np.allclose(slow["position_ise"], eq6["position_ise"], rtol=0.01)
    unit, other = (each["cost_position"] / each["position_ise"] for each in (eq6, slow))
    assert values["cost_position"] / values["position_ise"] == pytest.approx(unit, rel=1e-12)
    assert not np.allclose(unit, other, rtol=0.01)
    ratio = found["devices"]["heavy"]["ratio_to_eq6"]["eq6-with-gains"]["mean"]
    assert ratio == pytest.approx(values["cost"].sum() / eq6["cost"].sum(), rel=1e-12)
    assert found["eq6_gains"] == "slow"
    assert "eq6, gains of slow" in (done / "benchmark.html").read_text()
    assert "eq6_gains" not in DevicesBenchmark().model_dump() and DevicesBenchmark(eq6_gains="testbed").model_dump()


def test_specialists_and_adapted_policies_are_judged_on_their_own_devices(done, found):
    assert found["entries"]["specialist"]["devices"] == ["heavy"]
    assert found["entries"]["adapted"]["devices"] == ["heavy", "light"]
    assert found["results"]["mine"]["lower_on"]["specialist"]["devices"] == 1
    run = yaml.safe_load((done / "runs" / "adapted" / "light" / f"seed-{_start(found)}" / "config.yaml").read_text())
    assert run["env"]["profile"]["name"] == "light" and run["env"]["fleet"] is None
    assert run["max_seconds"] == 60.0 and run["ppo"]["initial_std"] == ADAPTATION["ppo"]["initial_std"]
    assert Path(run["network"]["start"]) == done / "runs" / "mine" / f"seed-{_start(found)}" / "best"
    for device in ("heavy", "light"):
        values = [found["adaptation"][device][key] for key in ("start", "adapted", "own-constant", "eq6")]
        assert all(value > 0.0 for value in values)
    learned = yaml.safe_load((done / "runs" / "mine" / "seed-3" / "config.yaml").read_text())
    assert load_fleet(learned["env"]["fleet"]) == load_fleet(TINY["fleets"]["train"])
    assert load_fleet(learned["validation"]["fleet"]) == load_fleet(TINY["fleets"]["choose"])


def _start(found):
    """Return the seed of the lowest validation cost."""
    runs = found["training"]["mine"]["runs"]
    return min(runs, key=lambda seed: runs[seed]["best_cost"])


def test_finished_work_is_kept_and_another_description_refused(done, found, monkeypatch, tmp_path):
    def fail(*given, **more):
        raise AssertionError("computed again")

    monkeypatch.setattr(episodes, "play_alone", fail)
    monkeypatch.setattr(runs, "load_learning", fail)
    monkeypatch.setattr("amulett_gym.studies.benchmark.devices.stages.best_constants", fail)
    assert main(["benchmark", "--config", str(described(tmp_path, WITH_GAINS)), "--out", str(done)]) == 0
    again = json.loads((done / "benchmark.json").read_text())
    assert {key: again[key] for key in again if key != "command"} == {
        key: found[key] for key in found if key != "command"
    }
    other = parse_devices_benchmark({**WITH_GAINS, "episodes": 5}, "tiny.yaml")
    with pytest.raises(AmulettError, match="holds another benchmark: description.episodes"):
        run_devices_benchmark(other, done, tmp_path)


def test_a_device_in_two_fleets_is_refused(tmp_path):
    fleets = {**TINY["fleets"], "choose": [{**device("other-name", 0.1)}]}
    with pytest.raises(AmulettError, match=r"'light' of fleets.judge is the device 'other-name' of fleets.choose"):
        load_fleets(parse_devices_benchmark({**TINY, "fleets": fleets}, "tiny.yaml"), tmp_path)
    (tmp_path / "judge.yaml").write_text(yaml.safe_dump(JUDGED))
    relative = parse_devices_benchmark({**TINY, "fleets": {**TINY["fleets"], "judge": "judge.yaml"}}, "tiny.yaml")
    assert [profile.name for profile in load_fleets(relative, tmp_path)["judge"]] == ["heavy", "light", "medium"]


def test_a_recipe_for_another_suite_is_refused(tmp_path, capsys):
    learned = {"mine": {"set": [*SHORT, "env.suite=reach"], "seeds": [3]}}
    path = described(tmp_path, {**TINY, "learned": learned})
    assert main(["config", "validate", str(path)]) == 2
    assert "is trained with suite 'reach', the benchmark has 'mixed'; set env.suite=mixed" in capsys.readouterr().err
    assert main(["config", "validate", str(described(tmp_path, TINY))]) == 0
    assert "a description of a benchmark over devices" in capsys.readouterr().out


def test_other_loops_need_recipes_of_the_loop(tmp_path):
    other = {**TINY, "loop": "computed-torque", "track": "full-control"}
    with pytest.raises(AmulettError, match=r"trained with control 'decentralized'.* set env.control=computed-torque"):
        check_devices_benchmark(parse_devices_benchmark(other, "tiny.yaml"), tmp_path)
    changes = ["env.control=computed-torque", "env.track=full-control", "env.tension_range=[0, 15]"]
    other["learned"] = {"mine": {"set": [*SHORT, *changes], "seeds": [0]}}
    check_devices_benchmark(parse_devices_benchmark(other, "tiny.yaml"), tmp_path)


def test_the_shipped_description_is_written_out():
    path = Path(__file__).parents[4] / "configs" / "devices.yaml"
    content = yaml.safe_load(path.read_text())
    assert set(content) == set(DevicesBenchmark.model_fields)
    made_on_one_device = {"contenders": ["pretrained:testbed", "parametric:mixed"]}
    expected = {**DevicesBenchmark().model_dump(), **made_on_one_device}
    assert parse_devices_benchmark(content, path).model_dump() == expected


def test_a_quick_benchmark_has_the_same_parts_in_small(tmp_path):
    many = [device(f"d{k}", 0.1 + 0.01 * k) for k in range(6)]
    large = {
        **TINY,
        "laws": ["constant", "parametric"],
        "budget": None,
        "episodes": 100,
        "fleets": {**TINY["fleets"], "judge": many},
        "learned": {"mine": {"set": SHORT, "seeds": [3, 4, 5]}, "other": {"set": SHORT, "seeds": [0]}},
    }
    small = quick(parse_devices_benchmark(large, "tiny.yaml"), tmp_path)
    assert [profile.name for profile in load_fleets(small, tmp_path)["judge"]] == ["d0", "d1", "d2", "d3"]
    assert list(small.learned) == ["mine"] and small.learned["mine"].seeds == [3, 4]
    assert (small.episodes, small.specialists.devices, small.adaptation.devices) == (6, 1, 1)
    assert small.specialists.set == [*TINY["specialists"]["set"], *small.learned["mine"].set[len(SHORT) :]]
    check_devices_benchmark(small, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"laws": ["constent"]}, "did you mean 'constant'"),
        ({"contenders": ["best-constant"]}, "two contenders would be called 'best-constant'"),
        ({"best_learned": "yours"}, "unknown learned entry 'yours'"),
        ({"episods": 3}, "did you mean 'episodes'"),
        ({"learned": {"mine": {"seeds": [1], "reference": True}}}, "not for devices"),
    ],
)
def test_a_wrong_description_is_refused(change, message):
    with pytest.raises(AmulettError, match=message):
        parse_devices_benchmark({**TINY, **change}, "tiny.yaml")
