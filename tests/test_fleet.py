"""Reading fleets."""

import json
from pathlib import Path

import pytest
from helpers import device

from amulett_gym import fleet as fleets
from amulett_gym.envs.eq6_costs import device_digest
from amulett_gym.errors import AmulettError
from amulett_gym.fleet import fleet_names, in_words, load_fleet, name_or_contents, names_or_contents, outside, ranges
from amulett_gym.profile import load_profile, physics

HEAVY = {"name": "heavy", "base": "testbed", "plant": {"masses": [{"mass": 0.5, "arm": 0.13}]}}


def test_profiles_of_every_kind_make_a_fleet(tmp_path):
    (tmp_path / "mine.json").write_text(json.dumps({**HEAVY, "name": "mine"}))
    own = device("testbed")
    fleet = load_fleet(["testbed", HEAVY, tmp_path / "mine.json", own])
    assert [profile.name for profile in fleet] == ["testbed", "heavy", "mine", "testbed-test"]
    assert fleet[0] == load_profile("testbed") and fleet[3] is own
    assert load_fleet(fleet) == fleet
    again = names_or_contents(fleet)
    assert name_or_contents(fleet) == again
    assert again[0] == "testbed" and load_fleet(json.loads(json.dumps(again))) == fleet


def test_a_file_names_files_in_its_folder(tmp_path, monkeypatch):
    folder = tmp_path / "devices"
    folder.mkdir()
    (folder / "curve.csv").write_text("deflection_m,force_N\n" + "\n".join(f"{k / 1000},{k * k}" for k in range(7)))
    (folder / "mine.yaml").write_text(json.dumps({**HEAVY, "name": "mine"}))
    curved = {"name": "curved", "base": "testbed", "spring": {"measured_curve": "curve.csv"}}
    for suffix in ("yaml", "json"):
        (folder / f"fleet.{suffix}").write_text(json.dumps(["simulation", "mine.yaml", curved]))
        fleet = load_fleet(folder / f"fleet.{suffix}")
        assert [profile.name for profile in fleet] == ["simulation", "mine", "curved"]
        assert fleet[2].spring.measured_curve is not None
    monkeypatch.chdir(folder)
    assert load_fleet("fleet.yaml") == fleet


@pytest.mark.parametrize(
    ("fleet", "message"),
    [
        ([], "at least one profile"),
        (["testbed", "testbed"], "2 profiles of the fleet have the name 'testbed'"),
        (["testbed", {**HEAVY, "plant": {"masss": 1}}], "profile 1: .*did you mean 'masses'"),
        (["testbed", "testbad", "testbet"], r"profile 1: unknown profile 'testbad'.*; profile 2: unknown profile"),
        (["testbad"] * 7, "profile 4: unknown profile 'testbad'.*; and 2 more"),
        (["testbad"], "profile 0: unknown profile 'testbad'.*did you mean 'testbed'"),
        ("plausibel", r"unknown fleet 'plausibel'; choose from .*<file>.yaml"),
        ("missing.yaml", "cannot read fleet 'missing.yaml'"),
        (3, "it has to be a name, a YAML or JSON file, or a list"),
    ],
)
def test_a_wrong_fleet_is_refused(fleet, message):
    with pytest.raises(AmulettError, match=message):
        load_fleet(fleet)


def test_a_shipped_fleet_is_kept_by_its_name(monkeypatch):
    shipped = load_fleet(["testbed", HEAVY])
    monkeypatch.setattr(fleets, "fleet_names", lambda: ("ours",))
    monkeypatch.setattr(fleets, "_shipped", lambda name: shipped)
    assert name_or_contents(load_fleet("ours")) == "ours" == name_or_contents(list(shipped))
    assert name_or_contents(shipped[:1]) == ["testbed"]
    assert in_words("ours") == "the fleet ours"
    assert [in_words(["testbed"] * count) for count in (1, 2)] == ["a fleet of 1 device", "a fleet of 2 devices"]


def test_a_file_gives_another_fleet_the_gains_of_a_profile(tmp_path):
    gains = {
        "name": "fast",
        "base": "testbed",
        "loops": {"computed_torque": {"kp": 10.0}},
        "loop": {"wiring": "tension_only"},
    }
    (tmp_path / "fast.yaml").write_text(json.dumps(gains))
    (tmp_path / "few.yaml").write_text(json.dumps([HEAVY, "testbed"]))
    for fleet in ("few.yaml", [HEAVY, "testbed"]):
        (tmp_path / "faster.yaml").write_text(json.dumps({"fleet": fleet, "loops_of": "fast.yaml"}))
        heavy, testbed = load_fleet(tmp_path / "faster.yaml")
        assert heavy.loops.computed_torque.kp == testbed.loops.computed_torque.kp == 10.0
        assert physics(heavy) == physics(load_fleet([HEAVY])[0])
        assert heavy.loop == testbed.loop == load_profile("testbed").loop
    (tmp_path / "faster.yaml").write_text(json.dumps({"fleet": "plausible-choose", "loops_of": gains}))
    fleet = load_fleet(tmp_path / "faster.yaml")
    plain = load_fleet("plausible-choose")
    assert [profile.name for profile in fleet] == [profile.name for profile in plain]
    assert [device_digest(profile) for profile in fleet] == [device_digest(profile) for profile in plain]  # same unit


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("testbed", "has to hold a list of profiles, or the keys fleet and loops_of, not str"),
        (HEAVY, "unknown key 'name'"),
        ({"fleet": "plausible"}, "loops_of missing"),
        ({"fleet": "plausible", "loops_off": "testbed"}, "unknown key 'loops_off'.*did you mean 'loops_of'"),
        ({"fleet": "plausible", "loops_of": "testbad"}, "loops_of: unknown profile 'testbad'"),
        ({"fleet": ["testbed", "testbed"], "loops_of": "testbed"}, "2 profiles of the fleet have the name"),
        ({"fleet": "plausibel", "loops_of": "testbed"}, "unknown fleet 'plausibel'"),
    ],
)
def test_a_file_with_something_else_is_refused(content, message, tmp_path):
    path = Path(tmp_path / "one.yaml")
    path.write_text(json.dumps(content))
    with pytest.raises(AmulettError, match=f"fleet '{path}'.*{message}"):
        load_fleet(path)


def test_a_file_names_a_file_with_a_list(tmp_path):
    path = Path(tmp_path / "one.yaml")
    path.write_text(json.dumps({"fleet": "one.yaml", "loops_of": "testbed"}))
    with pytest.raises(AmulettError, match="its fleet .*one.yaml.* has to hold a list"):
        load_fleet(path)


def test_shipped_fleets_can_be_loaded():
    for name in fleet_names():
        assert len(load_fleet(name)) > 1


def test_physics_outside_the_ranges_of_a_fleet_is_named():
    fleet = [device("testbed", drives={"lag": lag}) for lag in (0.02, 0.05)]
    assert outside(device("testbed", drives={"lag": 0.03}, sensors={"below_floor": "hold"}), fleet) == {}
    assert outside(device("testbed", drives={"lag": 0.1}), fleet) == {"drives.lag": "0.1 (0.02 to 0.05)"}
    assert outside(device("testbed", drives={"lag": 0.05, "rate_limit_deg": None}), fleet[:1]) == {
        "drives.lag": "0.05 (0.02)",
        "drives.rate_limit_deg": f"none ({load_profile('testbed').drives.rate_limit_deg:.4g})",
    }
    limp = device("testbed", drives={"lag": 0.03}, damping={"keeps": "rate"})
    kept = load_profile("testbed").damping.keeps
    assert outside(limp, fleet) == ({} if kept == "rate" else {"damping.keeps": f"rate ({kept})"})
    curve = "deflection_m,force_N\n" + "\n".join(f"{k / 1000},{k * k}" for k in range(7))
    curved = device("testbed", drives={"lag": 0.03}, spring={"measured_curve": curve})
    assert outside(curved, fleet)["spring.measured_curve"].endswith("... (none)")


def test_ranges_of_a_fleet_in_words():
    found = ranges(
        [device("testbed", drives={"lag": lag, "rate_limit_deg": most}) for lag, most in ((1, 9), (2, None))]
    )
    assert (found["drives.lag"], found["drives.rate_limit_deg"]) == ("1 to 2", "9 or none")
    assert found["plant.orientation"] == load_profile("testbed").plant.orientation
