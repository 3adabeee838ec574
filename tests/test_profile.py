"""Profiles: shipped ones are complete and sourced, wrong ones are refused with a helpful message."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
import yaml

from amulett_gym.envs.prices import divisors
from amulett_gym.errors import AmulettError
from amulett_gym.fitting import Fitting
from amulett_gym.profile import device_names, load_profile, loop_configuration, physics, profile_names
from amulett_gym.settings import SOURCES, Sourced, merge
from amulett_gym.storage.curve import Curve


def test_every_value_of_a_shipped_profile_names_its_source(profile):
    for name in type(profile).model_fields:
        group = getattr(profile, name)
        if isinstance(group, Sourced):
            given = {key for key, value in group if key != "sources" and (value is not None or key in group.sources)}
            assert given == set(group.sources), f"{profile.name}.{name}"
            assert all(source.split(":")[0] in SOURCES for source in group.sources.values())


def test_every_value_of_a_shipped_fitting_names_its_source():
    fitting = load_profile("worn").wearer
    assert fitting is not None
    for name, group in fitting:
        assert {key for key, _ in group if key != "sources"} == set(group.sources), name
    assert {name: group.model_dump(exclude={"sources"}) for name, group in fitting} == {
        name: group.model_dump(exclude={"sources"}) for name, group in Fitting()
    }


def test_the_worn_device_is_the_testbed_with_a_larger_joint_pulley():
    worn, testbed = load_profile("worn"), load_profile("testbed")
    assert physics(worn) == {**physics(testbed), "plant.joint_pulley_radius": 0.05}
    assert worn.plant.joint_pulley_radius == pytest.approx(1.25 * testbed.plant.joint_pulley_radius)
    assert worn.plant.sources["joint_pulley_radius"].startswith("assumed: 1.25 times the testbed's")
    # Tuned laws of the testbed act on it, also on devices that are based on it.
    assert worn.root == load_profile({"base": "worn", "name": "mine"}).root == "testbed"
    assert divisors(worn, "steps") == divisors(testbed, "steps")
    assert set(profile_names()) - set(device_names()) == {"worn"}


def test_profiles_share_one_set_of_mechanical_parameters():
    simulation, testbed = load_profile("simulation"), load_profile("testbed")
    for group in ("plant", "spring", "damping", "variable_stiffness"):
        assert getattr(simulation, group) == getattr(testbed, group)


def test_own_profile_gives_only_what_differs(tmp_path: Path):
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\nbase: testbed\nplant: {orientation: vertical}\n")
    mine, testbed = load_profile(file), load_profile("testbed")
    assert mine.plant.orientation == "vertical"
    assert mine.loop == testbed.loop
    assert mine.root == "testbed"


def test_measured_curve_is_found_beside_the_profile(tmp_path: Path):
    (tmp_path / "curve.csv").write_text("deflection_m,force_N\n0,0\n0.003,4\n0.006,12\n")
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\nbase: testbed\nspring: {measured_curve: curve.csv}\n")
    curve = Curve(deflection_m=[0, 0.003, 0.006], force_N=[0, 4, 12])
    assert load_profile(file).spring.measured_curve == curve
    assert load_profile(str(file)).spring.measured_curve == curve
    in_python = {"name": "mine", "base": "testbed", "spring": {"measured_curve": tmp_path / "curve.csv"}}
    assert load_profile(in_python).spring.measured_curve == curve


def test_a_name_alone_does_not_make_a_device():
    simulation, testbed = load_profile("simulation"), load_profile("testbed")
    assert (simulation.root, testbed.root) == ("simulation", "testbed")
    named = load_profile({"name": "testbed", "base": "simulation"})
    assert named.root == "simulation"
    assert divisors(named, "steps") == divisors(simulation, "steps") != divisors(testbed, "steps")
    assert load_profile({"name": "simulation", "base": "testbed"}).root == "testbed"
    assert load_profile({"name": "x", "base": "testbed", "drives": {"lag": 0.2}}).root == "testbed"
    # What was changed in a copy of the testbed's content is based on the testbed, though its 'base' is the simulation.
    copy = merge(testbed.model_dump(), {"drives": {"lag": 0.2}})
    assert load_profile(copy).root == "testbed"
    assert testbed.model_copy(update={"description": "mine"}).root == "testbed"
    # Without a base: all of the content is its own.
    own = {name: {**getattr(simulation, name).model_dump(), "sources": {}} for name in GROUPS}
    assert load_profile({"name": "simulation", **own}).root == "simulation (own)"
    assert load_profile({"name": "mine", **own}).root == "mine"


GROUPS = [name for name, group in load_profile("simulation") if isinstance(group, Sourced)]


def test_a_changed_value_does_not_keep_the_source_of_the_bases(tmp_path: Path):
    testbed = load_profile("testbed").drives
    file = tmp_path / "mine.yaml"
    file.write_text(f"name: mine\nbase: testbed\ndrives: {{lag: 0.2, rate_limit_deg: {testbed.rate_limit_deg}}}\n")
    mine = load_profile(file)
    assert mine.drives.sources == {**testbed.sources, "lag": "given: in mine.yaml"}  # the rate is what the source says
    assert load_profile(mine.model_dump()) == mine
    content = {"name": "mine", "base": "testbed", "loop": {"position": {"kp": 0.5}}}
    assert load_profile(content).loop.sources["position"] == "given: by the caller"
    content["loop"]["sources"] = {"position": "assumed: by hand"}
    assert load_profile(content).loop.sources["position"] == "assumed: by hand"
    assert load_profile("testbed").loop.sources["position"].startswith(("assumed", "identified", "paper"))


def test_files_are_known_by_their_suffix_in_any_case(tmp_path: Path):
    for name in ("P.YAML", "p.Yml"):
        (tmp_path / name).write_text("{name: mine, base: testbed}")
        assert load_profile(tmp_path / name).name == "mine"


def test_a_profile_is_the_same_from_a_name_a_path_a_mapping_or_itself():
    testbed = load_profile("testbed")
    for profile in (Path("testbed"), testbed, testbed.model_dump(), MappingProxyType(testbed.model_dump())):
        assert load_profile(profile) == testbed
    for wrong in (3, None, b"testbed", ["testbed"]):
        with pytest.raises(AmulettError, match="it has to be a name, a YAML file or a mapping"):
            load_profile(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spring": {"beyond": "hard-stop"}}, r"spring.*beyond is hard-stop, so stop_stiffness is needed"),
        ({"spring": {"stop_stiffness": 1e4}}, r"stop_stiffness is 10000.0 N/m, but beyond is held"),
        ({"spring": {"beyond": "hard"}}, r"spring\.beyond.*'hard'.*'continued' or 'hard-stop'"),
        ({"drives": {"stall_torque": 0.3, "rate_limit_deg": None}}, r"with a lag it needs rate_limit_deg"),
        ({"plant": {"orientaton": "vertical"}}, r"unknown key 'plant.orientaton'; did you mean 'orientation'"),
        ({"plant": {"orientation": "diagonal"}}, r"'plant.orientation' is 'diagonal'.*'horizontal' or 'vertical'"),
        ({"plant": {"masses": [{"mass": -1.0, "arm": 0.1}]}}, r"'plant.masses.0.mass' is -1.0.*greater than or equal"),
        ({"plant": {"masses": [{"mas": 1.0, "arm": 0.1}]}}, r"unknown key 'plant.masses.0.mas'; did you mean 'mass'"),
        ({"plant": {"masses": [{"mass": 0.0, "arm": 0.1}]}}, r"masses give no inertia"),
        ({"loop": {"position": {"kp": 1e200}}}, r"'loop.position.kp' is 1e\+200.*1000000"),
        ({"plant": {"masses": []}}, r"'plant.masses'.*at least 1 item"),
        ({"loop": {"control_period": float("nan")}}, r"'loop.control_period' is nan.*finite"),
        ({"loop": {"control_period": "fast"}}, r"'loop.control_period' is 'fast'.*number"),
        ({"loop": {"position": {"kpp": 1.0}}}, r"unknown key 'loop.position.kpp'; did you mean 'kp'"),
        ({"loop": {"tie_width": 1.0}}, r"tie_width is 1.0 m; it has to be at most switch_hysteresis"),
        ({"spring": {"free_length": 0.5}}, r"free_length is 0.5 m; it has to be at most half_width"),
        ({"variable_stiffness": {"minimum_tension": 20.0}}, r"at most nominal_tension"),
        ({"drives": {"sources": {"lagg": "assumed"}}}, r"unknown key 'lagg'; did you mean 'lag'"),
        ({"drives": {"sources": {"lag": "guessed"}}}, r"has to start with one of paper, datasheet"),
        ({"base": "testbad"}, r"unknown base profile 'testbad'.*did you mean 'testbed'"),
    ],
)
def test_wrong_profiles_name_key_value_and_nearest(changes: dict[str, Any], message: str):
    with pytest.raises(AmulettError, match=message):
        load_profile(merge({"name": "mine", "base": "testbed"}, changes))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "has to hold a mapping"),
        ("[1, 2]", "has to hold a mapping"),
        ("a: [", "not valid YAML"),
        ("name: mine", "'plant' is missing"),
        ("!!python/object/apply:os.system ['true']", "not valid YAML"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, content: str, message: str):
    file = tmp_path / "mine.yaml"
    file.write_text(content)
    with pytest.raises(AmulettError, match=message):
        load_profile(file)


def test_missing_and_binary_files_are_refused(tmp_path: Path):
    with pytest.raises(AmulettError, match="cannot read profile"):
        load_profile(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(AmulettError, match="not UTF-8"):
        load_profile(tmp_path / "binary.yaml")


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(AmulettError, match="unknown profile 'tesbed'.*did you mean 'testbed'"):
        load_profile("tesbed")


def test_options_that_are_null_are_left_out_of_a_profiles_content():
    """So that hashes of profiles from before these options stay."""
    testbed = load_profile("testbed")
    plain, content = testbed.model_dump(), testbed.model_dump_json()
    assert not {"beyond", "stop_stiffness"} & set(plain["spring"]) and "stall_torque" not in plain["drives"]
    assert "stall_torque" not in content and "rate_limit_deg" in content
    options = {"spring": {"beyond": "hard-stop", "stop_stiffness": 4e4}, "drives": {"stall_torque": 0.3}}
    mine = load_profile({"name": "mine", "base": "testbed", **options})
    assert mine.model_dump()["spring"].items() >= options["spring"].items()
    assert load_profile(mine.model_dump()) == mine
    assert "structure" not in plain and "structure" not in content and "structure.stiffness" not in physics(testbed)
    soft = load_profile({"name": "mine", "base": "testbed", "structure": {}})
    assert soft.model_dump()["structure"]["stiffness"] == physics(soft)["structure.stiffness"] == 8e4
    assert load_profile(soft.model_dump()) == soft != load_profile({"name": "mine", "base": "testbed"})
    held = load_profile({"name": "mine", "base": "testbed", "spring": {"beyond": "held"}})
    assert held.spring.beyond is None


def test_profiles_survive_yaml():
    for name in profile_names():
        content = yaml.safe_load(yaml.safe_dump(load_profile(name).model_dump()))
        assert load_profile(content) == load_profile(name)


def test_costs_may_be_divided_by_those_of_a_shipped_profile_only():
    with pytest.raises(AmulettError, match=r"divisors_of.*'testbad'.*testbed"):
        load_profile({"base": "testbed", "name": "mine", "divisors_of": "testbad"})


def test_a_profile_is_a_loop_configuration_and_physics():
    testbed = load_profile("testbed")
    loop, body = loop_configuration(testbed), physics(testbed)
    assert loop["sensors.below_floor"] == testbed.sensors.below_floor and loop["loop.tension.kp"] > 0
    assert not loop.keys() & {"loop.substeps", "loop.sources", "loop.offset_deg", "loop.position_only.kp"}
    assert not set(loop) & set(body) and not [key for key in {**loop, **body} if "sources" in key]
    assert body["plant.inertia"] == pytest.approx(sum(each.mass * each.arm**2 for each in testbed.plant.masses))
    content = testbed.model_dump(include={"plant", "spring", "damping", "drives", "sensors"})
    given = {f"{group}.{key}" for group, values in content.items() for key in values}
    given -= {key for key in given if key.endswith(".sources")} | {"plant.masses"}
    assert set(body) | {key for key in loop if key.startswith("sensors.")} == given | {"plant.inertia"}


def test_each_control_loop_has_its_own_configuration():
    testbed = load_profile("testbed")
    only, other = loop_configuration(testbed, "position-only"), loop_configuration(testbed, "co-rotation")
    assert "loop.position_only.kp" in only and "loop.tension.kp" not in only
    assert other["loops.co_rotation.kp"] == testbed.loops.co_rotation.kp
    assert not [key for key in other if key.startswith(("loop.position", "loop.tension", "loops.cascade"))]
    assert "loop.control_period" in loop_configuration(testbed, "drives")


def test_gravity_and_a_measured_curve_are_physics():
    curve = "deflection_m,force_N\n" + "\n".join(f"{k / 1000},{k * k}" for k in range(7))
    own = load_profile(
        {"base": "testbed", "plant": {"orientation": "vertical"}, "spring": {"measured_curve": curve, "beyond": None}}
    )
    found = physics(own)
    assert found["plant.moment"] == pytest.approx(sum(each.mass * each.arm for each in own.plant.masses))
    assert "spring.stiffness" not in found and "0.006" in found["spring.measured_curve"]
