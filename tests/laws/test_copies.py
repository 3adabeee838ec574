"""Copies of policies: all files that a policy needs, each source once."""

from __future__ import annotations

import hashlib

import pytest
from helpers import make_bundle

from amulett_gym.errors import AmulettError
from amulett_gym.laws.bundle import FILES, MANIFEST, OPTIONAL, read_bundle, write_bundle
from amulett_gym.laws.copies import FOLDER, copy_policies, kept_policies, policy_digest


def test_a_policy_is_copied_with_all_files_that_it_needs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_bundle(tmp_path / "run" / "best")
    (tmp_path / "tools").mkdir()
    for name, text in {
        "mine.py": "import math\nimport tools.near\n",
        "tools/__init__.py": "",
        "tools/near.py": "from . import far\nimport not_there\n",
        "tools/far.py": "",
        "other.py": "",
        "broken.py": "def (",
        "a.zip": "zip",
        "a.json": "{}",
        "b.zip": "zip",
        "config.yaml": "",
        "law.json": "{}",
    }.items():
        (tmp_path / name).write_text(text)
    contents = {
        "run": {"manifest.json", *FILES},
        "mine.py:f": {"mine.py", "tools/__init__.py", "tools/near.py", "tools/far.py"},
        "broken.py:f": {"broken.py"},
        "a.zip": {"a.zip", "a.json"},
        "b.zip": {"b.zip", "config.yaml"},
        "law.json": {"law.json"},
    }
    copies = copy_policies([*contents, "run/best", "./mine.py:g", "eq6", "constant:8", "pretrained", "none"])
    assert {name: set(entry["sha256"]) for name, entry in copies.record.items()} == {
        **contents,
        "run/best": contents["run"],
        "./mine.py:g": contents["mine.py:f"],
    }
    assert copies.record["run"] == copies.record["run/best"] and len(copies.files) == len(contents)
    assert copies.record["a.zip"]["sha256"]["a.zip"] == hashlib.sha256(b"zip").hexdigest() == policy_digest("b.zip")
    copies.write(tmp_path / "run")
    kept = tmp_path / "run" / FOLDER
    places = kept_policies("run", copies.record)
    assert [places[name] for name in ("run", "./mine.py:g", "a.zip")] == [
        f"run/{FOLDER}/0",
        f"run/{FOLDER}/1/mine.py:g",
        f"run/{FOLDER}/3/a.zip",
    ]
    assert copy_policies(contents, places).record.items() <= copies.record.items()
    (kept / "3" / "a.json").write_text("{} ")
    with pytest.raises(AmulettError, match=r"kept copy of policy 'a\.zip', .*a\.json', was changed"):
        kept_policies("run", copies.record)
    (kept / "3" / "a.json").unlink()
    with pytest.raises(AmulettError, match=r"cannot read kept copy of policy 'a\.zip' '.*a\.json': No such file"):
        kept_policies("run", copies.record)


def test_a_law_of_the_package_has_no_file_even_if_a_file_has_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eq6").write_text("")
    make_bundle(tmp_path / "pretrained")
    assert not copy_policies(["eq6", "pretrained"]).record and policy_digest("pretrained") is None


@pytest.mark.parametrize("record", [3, {"x": 3}, {"x": {"copy": "0", "sha256": {}}}, {"x": {"copy": 0}}])
def test_a_damaged_record_is_refused(record, tmp_path):
    with pytest.raises(AmulettError, match="'kept' in command.json is damaged"):
        kept_policies(tmp_path, record)


def test_a_copied_bundle_keeps_its_critic(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = read_bundle(make_bundle(tmp_path / "mine"))
    write_bundle("mine", found.layers, found.policy, found.env, found.provenance, "# Card\n", b"arrays")
    assert set(copy_policies(["mine"]).record["mine"]["sha256"]) == {MANIFEST, *FILES, *OPTIONAL}
