"""`amulett rerun`: a folder describes the command that wrote it, so that it can run again and give the same numbers."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from importlib import resources

import pytest
from helpers import blank_figures, make_bundle

from amulett_gym.cli import main
from amulett_gym.laws.bundle import FILES
from amulett_gym.laws.copies import FOLDER
from amulett_gym.laws.parametric import TUNED
from amulett_gym.storage.provenance import COMMAND, PACKAGES, differences, read_provenance

EVALUATE = ["evaluate", "--policies", "constant:8", "--episodes", "2", "--out", "comparison"]


@pytest.fixture(scope="module", autouse=True)
def no_drawing():
    """Draw nothing: these tests are about a comparison's numbers."""
    with pytest.MonkeyPatch.context() as patch:
        blank_figures(patch)
        yield


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def comparison(places):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(places)
        (places / "mine.yaml").write_text("{name: mine, base: testbed, sensors: {encoder_bits: 10}}")
        assert main([*EVALUATE, "--profile", "mine.yaml"]) == 0
    return places / "comparison"


def edited(folder, copy, **changes):
    shutil.copytree(folder, copy)
    (copy / COMMAND).write_text(json.dumps(json.loads((copy / COMMAND).read_text()) | changes))
    return copy


def test_a_folder_says_what_filled_it(comparison):
    note = read_provenance(comparison)
    assert note.kind == "evaluate"
    assert note.command[:4] == ["amulett", *EVALUATE[:3]]
    assert note.config["profile"]["sensors"]["encoder_bits"] == 10
    assert note.seeds == [0, 1]
    assert {"python", "amulett-gym", "numba"} <= set(note.versions) <= {"python", *PACKAGES}
    assert set(note.model_dump()) >= {"git_revision", "working_folder"}


def test_the_same_command_gives_the_same_numbers(comparison, places, tmp_path, capsys):
    (places / "mine.yaml").unlink()  # the resolved profile is in the folder
    assert main(["rerun", str(comparison), "--out", str(tmp_path / "again")]) == 0
    output = capsys.readouterr().out
    assert "numbers are the same" in output
    assert "Warning" not in output
    assert (tmp_path / "again" / "report.html").is_file()
    assert read_provenance(tmp_path / "again").config == read_provenance(comparison).config


def test_another_number_is_noticed_and_other_software_is_told(comparison, tmp_path, capsys):
    versions = {**read_provenance(comparison).versions, "numba": "0.1"}
    copy = edited(comparison, tmp_path / "copy", versions=versions)
    results = json.loads((copy / "results.json").read_text())
    results["policies"]["eq6"]["cost"]["mean"] += 1e-12
    (copy / "results.json").write_text(json.dumps(results))
    assert main(["rerun", str(copy), "--out", str(tmp_path / "again"), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["same"] is False
    assert [line.split(" was ")[0] for line in told["differences"]] == ["policies.eq6.cost.mean"]
    assert any("numba was '0.1'" in warning for warning in told["warnings"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "format-disk"}, "this version cannot run again"),
        (
            {"kind": "identify", "command": ["amulett", "train", "--out", "x"]},
            "is not finished|no command of 'identify'",
        ),
        ({"config": {"trust_pickle": True}}, "they contain pickles"),
        ({"command": ["amulett", "evaluate", "--trust-pickle"]}, "they contain pickles"),
        ({"config": {"kept": {"x": {"copy": "../..", "sha256": {}}}}}, "'kept' in command.json is damaged"),
        ({"config": {}}, "does not describe a comparison"),
        ({"versions": 3}, "'versions' is 3"),
        ({"version": 2}, "'version' is 2"),
    ],
)
def test_a_note_of_a_stranger_does_no_harm(comparison, changes, message, tmp_path, capsys):
    copy = edited(comparison, tmp_path / "copy", **changes)
    assert main(["rerun", str(copy), "--out", str(tmp_path / "again")]) == 2
    assert re.search(message, capsys.readouterr().err)


def test_only_what_filled_the_folder_is_given_again(comparison, tmp_path, capsys):
    """A note whose words are another command's is refused, even if the folder holds what that kind leaves."""
    copy = edited(comparison, tmp_path / "copy", kind="identify", command=["amulett", "bench", "--out", "x"])
    (copy / "identification.json").write_text("{}")
    assert main(["rerun", str(copy), "--out", str(tmp_path / "again")]) == 2
    assert "names no command of 'identify'" in capsys.readouterr().err


TINY = """
env: {profile: mine.yaml, max_episode_steps: 75}
ppo: {n_steps: 80, batch_size: 64, n_epochs: 1}
network: {hidden: [8]}
validation: {every_steps: 640, episodes: 2}
num_envs: 8
total_steps: 1280
"""


def test_a_training_run_is_trained_again_to_the_same_weights(tmp_path, monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("{name: mine, base: testbed, sensors: {encoder_bits: 10}}")
    (tmp_path / "tiny.yaml").write_text(TINY)
    assert main(["train", "--config", "tiny.yaml", "--out", "run"]) == 0
    (tmp_path / "mine.yaml").write_text("{name: mine, base: testbed, sensors: {encoder_bits: 4}}")
    (tmp_path / "tiny.yaml").unlink()
    assert main(["rerun", "run", "--out", "again"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    rows = (tmp_path / "again" / "evaluations.csv").read_text()
    (tmp_path / "again" / "evaluations.csv").write_text(rows.replace("\n640,", "\n641,"))
    assert main(["rerun", "again", "--out", "third"]) == 1
    assert "validations.1.steps was '641' and is '640'" in capsys.readouterr().out
    (tmp_path / "run" / "finished.json").unlink()
    assert main(["rerun", "run", "--out", "fourth"]) == 2
    assert "is not finished: amulett train --resume" in capsys.readouterr().err


def test_whatever_the_words_say_it_writes_to_the_new_folder_alone(comparison, tmp_path, monkeypatch, capsys):
    words = ["amulett", "benchmark", "--out", "a", "--out=b", "--doc", "c.md", "--runs", "d"]
    note = {"kind": "benchmark", "command": words, "config": {"runs": "d"}, "working_folder": str(tmp_path)}
    copy = edited(comparison, tmp_path / "copy", **note)
    (copy / "benchmark.json").write_text('{"number": 1}')
    given = []

    def run(arguments):
        given.append((arguments.out, arguments.doc, arguments.runs))
        (tmp_path / "new").mkdir()
        shutil.copy(copy / "benchmark.json", tmp_path / "new")
        return 0

    monkeypatch.setattr("amulett_gym.cli.benchmark.run", run)
    assert main(["rerun", str(copy), "--out", str(tmp_path / "new")]) == 0
    assert given == [(str(tmp_path / "new"), None, None)]
    assert "Warning: the training runs in 'd' are trained again" in capsys.readouterr().out


def test_nothing_is_overwritten(comparison, tmp_path, capsys):
    for out in (comparison, comparison / "again", comparison.parent):
        assert main(["rerun", str(comparison), "--out", str(out)]) == 2
    assert main(["rerun", str(tmp_path), "--out", str(tmp_path.parent / "new")]) == 2
    assert f"there is no {COMMAND}" in capsys.readouterr().err


def test_differences_are_named():
    old, new = {"a": [1, {"b": 2.0}], "c": 1}, {"a": [1, {"b": 2.5}], "d": 2}
    assert differences(old, new) == ["a.1.b was 2.0 and is 2.5", "c was 1 and is None", "d was None and is 2"]
    assert differences(old, old) == []


def test_a_python_file_is_run_again_only_if_it_is_trusted(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    law = tmp_path / "mine.py"
    law.write_text("def mine(observations): return [0.0] * len(observations)\n")
    assert main(["evaluate", "--policies", "mine.py:mine", "--episodes", "2", "--out", "own"]) == 0
    digest = hashlib.sha256(law.read_bytes()).hexdigest()
    assert read_provenance(tmp_path / "own").config["sha256"] == {"mine.py:mine": digest}
    assert main(["rerun", "own", "--out", "again"]) == 2
    assert "ran a Python file, 'mine.py:mine'; if you trust it" in capsys.readouterr().err
    assert main(["rerun", "own", "--out", "again", "--trust-python"]) == 0
    law.write_text("def mine(observations): return [1.0] * len(observations)\n")  # a copy was kept
    assert main(["rerun", "own", "--out", "other", "--trust-python"]) == 0
    assert "has changed" not in capsys.readouterr().out
    note = json.loads((tmp_path / "own" / COMMAND).read_text())
    del note["config"]["kept"]  # as in folders of earlier versions
    (tmp_path / "own" / COMMAND).write_text(json.dumps(note))
    assert main(["rerun", "own", "--out", "older", "--trust-python"]) == 1
    assert "the policy 'mine.py:mine' has changed" in capsys.readouterr().out


def test_policies_are_kept_by_content_once_each_and_compared_again(tmp_path, monkeypatch, capsys):
    """Names of one bundle stay one contender, two bundles of the same content two."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(make_bundle(tmp_path / "run" / "best"), tmp_path / "twin")
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "near.py").write_text("ACTION = 0.5\n")
    law = "from near import ACTION\ndef f(seen): return [ACTION] * len(seen)\ndef g(seen): return [0.0] * len(seen)\n"
    (tmp_path / "laws" / "mine.py").write_text(law)
    shutil.copy(resources.files("amulett_gym").joinpath(*TUNED, "testbed", "eq6-tuned-mixed.json"), "mine.json")
    names = ["run", "run/best", "twin", "laws/mine.py:f", "laws/mine.py:g", "mine.json", "./mine.json", "constant:8"]
    names += [f"co-rotation/{name}" for name in ("run", "laws/mine.py:f", "mine.json", "constant:8")]
    words = ["--profile", "simulation", "--episodes", "2", "--duration", "1", "--out", "kept"]
    assert main(["evaluate", "--policies", *names, *words]) == 0
    copies = [sorted(path.name for path in place.iterdir()) for place in sorted((tmp_path / "kept" / FOLDER).iterdir())]
    assert copies == [sorted((*FILES, "manifest.json"))] * 2 + [["mine.py", "near.py"], ["mine.json"]]
    for name in ("run", "twin", "laws"):
        shutil.rmtree(tmp_path / name)
    (tmp_path / "mine.json").unlink()
    assert main(["rerun", "kept", "--out", "again", "--trust-python"]) == 0
    assert "numbers are the same" in capsys.readouterr().out
    results = [json.loads((tmp_path / name / "results.json").read_text()) for name in ("kept", "again")]
    assert list(results[0]["policies"]) == ["eq6", "run", "twin", *names[3:6], *names[7:]]
    assert any(remark.startswith("mine.json was tuned on the testbed") for remark in results[0]["remarks"])
    for key in ("policies", "remarks", "labels", "verdict"):
        assert results[0][key] == results[1][key]
    assert read_provenance("again").config == read_provenance("kept").config
    assert main(["rerun", "again", "--out", "third", "--trust-python"]) == 0  # a repetition keeps its policies, too
    (tmp_path / "kept" / FOLDER / "1" / "env.json").open("a").write(" ")
    (tmp_path / "again" / FOLDER / "2" / "near.py").unlink()
    for folder, message in (("kept", "'twin', .*env.json', was changed"), ("again", "'laws/mine.py:f' .*near.py'")):
        assert main(["rerun", folder, "--out", "refused", "--trust-python"]) == 2
        assert re.search(f"kept copy of policy {message}", capsys.readouterr().err)
    assert main(["evaluate", "--policies", "constant:8", "--episodes", "1", "--duration", "1", "--out", "kept"]) == 0
    assert not (tmp_path / "kept" / FOLDER).exists()  # those of the earlier comparison
