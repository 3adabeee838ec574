"""An exported folder is complete: it compiles without a warning and passes its own test vectors."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from firmware.test_network import write
from helpers import device, keep_network

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.firmware import export as export_module
from amulett_gym.firmware.description import firmware_content, read_description
from amulett_gym.firmware.device import device_header
from amulett_gym.firmware.export import export
from amulett_gym.firmware.host import FLAGS, SOURCES, firmware_id
from amulett_gym.firmware.laws import PARAMETRIC_SLICES, choose
from amulett_gym.profile import load_profile

ZEROS = [(np.zeros((1, 13), "f4"), np.zeros(1, "f4"))]  # a network's layers


pytestmark = pytest.mark.usefixtures("without_chip")

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason=NO_COMPILER)


@needs_compiler
@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_a_folder_checks_itself(tmp_path, capsys):
    assert main(["export", "eq6-held", "--out", str(tmp_path / "firmware"), "--json"]) == 0
    sizes = json.loads(capsys.readouterr().out)
    assert sizes == {path.name: path.stat().st_size for path in (tmp_path / "firmware").iterdir()}
    done = subprocess.run(["make", "check"], cwd=tmp_path / "firmware", capture_output=True, text=True, check=True)
    assert done.stdout.count("as it should be") == len(FLAGS)
    header = tmp_path / "firmware" / "device.h"
    header.write_text(header.read_text().replace(".position_ki = 5.8", ".position_ki = 5.9"))
    assert (
        "TOO MUCH"
        in subprocess.run(["make", "check"], cwd=tmp_path / "firmware", capture_output=True, text=True).stdout
    )
    readme = (tmp_path / "firmware" / "README.md").read_text()
    assert "| double | 0 | 0 |" in readme and "eq6-held" in readme


def test_firmware_of_a_worn_device_says_that_it_lacks_intent_control(tmp_path):
    notes = []
    export("eq6", "worn", None, tmp_path / "worn", note=notes.append)
    export("eq6", "testbed", None, tmp_path / "bare", note=notes.append)
    (note,) = notes
    assert note.startswith("Without intent control: 'worn' is worn")
    assert note in (tmp_path / "worn" / "README.md").read_text()
    assert "intent control" not in (tmp_path / "bare" / "README.md").read_text()


@needs_compiler
@pytest.mark.parametrize("real", FLAGS)
def test_sources_compile_without_a_warning(firmware, real, tmp_path):
    folder = firmware("eq6-tuned", suite="mixed", split="shifted").folder
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Wno-sign-conversion", "-Werror", *FLAGS[real]]
    for source in SOURCES:
        command = [find_compiler(), *flags, "-c", str(folder / source), "-o", str(tmp_path / "out.o")]
        assert subprocess.run(command, capture_output=True, text=True).stderr == ""


def test_an_export_replaces_an_earlier_one_and_nothing_else(tmp_path):
    export("eq6", "testbed", None, tmp_path / "firmware")
    export("constant:8", "testbed", None, tmp_path / "firmware")
    assert "constant:8" in (tmp_path / "firmware" / "README.md").read_text()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    with pytest.raises(AmulettError, match="not empty"):
        export("eq6", "testbed", None, tmp_path / "mine")


def test_the_delay_is_the_bundles_own_or_what_the_slices_need(tmp_path, capsys):
    late = str(keep_network(tmp_path / "late", ZEROS, keywords={"action_delay": 4}))
    for law, delay, remark in (
        (late, 4, "begins 4 control ticks after its observation, as in the simulation"),
        ("parametric", PARAMETRIC_SLICES - 1, "the law was trained or tuned with 0 control ticks"),
    ):
        assert main(["export", law, "--out", str(tmp_path / "firmware")]) == 0
        assert remark in " ".join(capsys.readouterr().out.split())
        assert remark in (tmp_path / "firmware" / "README.md").read_text()
        assert f"#define LAW_DELAY {delay}" in " ".join((tmp_path / "firmware" / "device.h").read_text().split())
        assert read_description(tmp_path / "firmware").keywords["action_delay"] == delay
    files = export("constant:8", "testbed", None, tmp_path / "firmware", note=pytest.fail)
    assert "after its observation" not in files["README.md"] and "#define LAW_DELAY" in files["device.h"]
    wrong = keep_network(
        tmp_path / "wrong", [(np.zeros((1, 13), "f4"), np.zeros(1, "f4"))], keywords={"action_delay": 8}
    )
    with pytest.raises(AmulettError, match="action_delay is 8 control ticks; .* from 0 to 7"):
        export(str(wrong), "testbed", None, tmp_path / "firmware")


@pytest.mark.parametrize(
    ("law", "control", "message"),
    [
        ("eq7", None, "unknown policy"),
        ("constant:20", None, "needs 20 N"),
        ("eq6", "positon-only", "unknown control"),
        ("constant:10", "position-only", "no contender"),
    ],
)
def test_wrong_words(law, control, message, tmp_path):
    with pytest.raises(AmulettError, match=message):
        export(law, "testbed", control, tmp_path / "firmware")
    assert not (tmp_path / "firmware").exists()


def test_a_converter_with_too_many_bits(tmp_path):
    with pytest.raises(AmulettError, match="encoder_bits is 30; .* at most 24"):
        export("eq6", device("testbed", sensors={"encoder_bits": 30}), None, tmp_path / "firmware")


def test_an_agent_period_with_too_many_ticks():
    profile = load_profile("testbed")
    _, settings = choose("eq6-held", profile)
    settings = type(settings)(profile=profile, agent_period=100.0, control=settings.control)
    device_header(profile, settings, {})
    fast = device("testbed", loop={"control_period": 0.001})
    with pytest.raises(AmulettError, match="100000 control ticks; the firmware counts 65535"):
        device_header(fast, type(settings)(profile=fast, agent_period=100.0), {})


def test_a_folder_keeps_the_policy_that_it_was_made_of(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "policy", hidden=(4,))
    export("policy", "testbed", None, "firmware")
    shutil.rmtree("policy")
    monkeypatch.chdir("/")
    found = read_description(tmp_path / "firmware")
    assert found.law == "policy"
    assert choose(found.contender, found.keywords["profile"])[0].policy_name == found.contender
    content = firmware_content(tmp_path / "firmware")
    assert {"controller.c", "Makefile", "weights.h", "kept_policies/0/weights.safetensors"} <= set(content)
    export("eq6", "testbed", None, tmp_path / "firmware")
    assert read_description(tmp_path / "firmware").contender == "eq6"
    assert not (tmp_path / "firmware" / "kept_policies").exists()


def test_a_hostile_name_of_a_profile_stays_text(tmp_path):
    name = '*/ #include "/etc/passwd" <script>`x` | [a](http://b)'
    files = export("eq6", device("testbed").model_copy(update={"name": name}), None, tmp_path / "firmware")
    assert {name for name, content in files.items() if "passwd" in content} <= {"README.md", "manifest.json"}
    assert json.loads(files["manifest.json"])["profile"]["name"] == name  # data, not text of a source
    assert "<script>" not in files["README.md"] and "`x`" not in files["README.md"]


def test_a_folder_is_written_without_a_c_compiler(tmp_path, monkeypatch):
    from amulett_gym.firmware import host, measuring

    monkeypatch.setattr(export_module, "measure", measuring.measure)
    for module in (export_module, host):
        monkeypatch.setattr(module, "find_compiler", lambda: None)
    export("eq6", "testbed", None, tmp_path / "firmware")
    readme = (tmp_path / "firmware" / "README.md").read_text()
    assert "Not measured: no C compiler found" in readme
    assert "Nothing: there was no C compiler" in readme


def test_a_header_without_the_firmware_s_identity_is_refused():
    with pytest.raises(AmulettError, match=r"device.h has no FIRMWARE_ID; export the firmware again"):
        firmware_id("#define CONTROL_PERIOD 0.0025\n")
