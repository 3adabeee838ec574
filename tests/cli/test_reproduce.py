"""`amulett reproduce` refuses what it cannot write before it works, can be killed, and takes a study of one's own."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from amulett_gym.cli import main
from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import inertia
from amulett_gym.reporting import style
from amulett_gym.storage.writing import output_folder
from amulett_gym.studies.paper import report, results
from amulett_gym.studies.paper.figures import CAPTIONS
from amulett_gym.studies.paper.own_study import read_study
from amulett_gym.studies.paper.report import MARKS, REPRODUCTION_MARKS, in_words, write_numbers, write_pictures
from amulett_gym.studies.paper.results import STATUS, Evidence
from amulett_gym.studies.paper.results import content as numbers
from amulett_gym.studies.paper.study import profile_text, shipped
from amulett_gym.studies.paper.tables import DEVICES

BEGIN, END = MARKS
HEAVIER = 1.1


@pytest.fixture(scope="module")
def content() -> dict[str, Any]:
    """Return a study that found a heavier arm than the shipped one did."""
    content = shipped()
    entry = next(entry for entry in content["spread"] if entry["name"] == "inertia")
    entry["value"] *= HEAVIER
    return content


def write_study(folder: Path, content: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "identification.json").write_text(json.dumps(content))
    for name in DEVICES:
        (folder / f"{name}.yaml").write_text(profile_text(name, content))
    return folder


@pytest.fixture(scope="module")
def folder(content, tmp_path_factory) -> Path:
    return write_study(tmp_path_factory.mktemp("study"), content)


@dataclass(frozen=True)
class Done:
    """What the command wrote and printed, the study that it was given, and the evidence that it gathered."""

    out: Path
    document: Path
    study: Path
    printed: str
    evidence: Evidence


@pytest.fixture(scope="module")
def done(content, tmp_path_factory) -> Done:
    """Run the command once for all tests: it takes long."""
    place = tmp_path_factory.mktemp("done")
    out, document, mine = place / "out", place / "mine.md", write_study(place / "mine", content)
    document.write_text(f"{BEGIN}\n{END}\n")
    gather, kept, printed = results.gather, [], io.StringIO()

    def gather_and_keep(*given: Any) -> Evidence:
        kept.append(gather(*given))
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        patch.setattr(results, "gather", gather_and_keep)
        assert main(["reproduce", "--study", str(mine), "--out", str(out), "--doc", str(document)]) == 0
    [evidence] = kept
    return Done(out, document, mine, printed.getvalue(), evidence)


@pytest.fixture(scope="module")
def evidence(done) -> Evidence:
    return done.evidence


@pytest.fixture
def one_figure(monkeypatch) -> None:
    """Draw one figure instead of all: where the test is about the files and not what they show."""
    monkeypatch.setattr(report, "draw", lambda evidence: {"figure_2": draw_one()})


@style.styled
def draw_one() -> style.Figure:
    figure, panel = style.one_panel(2.0)
    panel.plot([0.0, 1.0], [1.0, 0.0])
    return figure


@pytest.fixture
def no_work(monkeypatch) -> None:
    def work(*_: object) -> None:
        raise AssertionError("the command began to work")

    monkeypatch.setattr(results, "gather", work)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["reproduce", *arguments]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize("text", ["# No marks\n", f"{END}\n{BEGIN}\n", f"{BEGIN}\n{BEGIN}\n{END}\n"])
def test_a_document_without_its_marks_is_refused_before_any_work(tmp_path, capsys, no_work, text):
    path = tmp_path / "mine.md"
    path.write_text(text)
    assert "has to hold the line" in refusal(capsys, "--doc", str(path), "--out", str(tmp_path / "out"))
    assert path.read_text() == text
    assert not (tmp_path / "out").exists()


def test_a_document_that_cannot_be_renewed_is_refused_before_any_work(tmp_path, capsys, no_work, monkeypatch):
    path = tmp_path / "mine.md"
    assert "cannot read document" in refusal(capsys, "--doc", str(path))
    path.write_text(f"{BEGIN}\n{END}\n")
    (tmp_path / "images").write_text("a file where the figures go")
    assert f"cannot write to '{tmp_path / 'images'}'" in refusal(capsys, "--doc", str(path))
    (tmp_path / "images").unlink()
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may write everything
    assert "is read-only" in refusal(capsys, "--doc", str(path))


def test_a_run_that_was_killed_while_it_wrote_can_be_repeated_into_the_same_folder(
    tmp_path, monkeypatch, evidence, one_figure
):
    out = tmp_path / "out"

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(style, "save_figures", killed)
        write_numbers(evidence, out)
        write_pictures(evidence, out)
    assert json.loads((out / "reproduction.json").read_text()) == json.loads(json.dumps(numbers(evidence)))
    assert not (out / "reproduction.html").exists()
    with output_folder(out, "reproduction", [REPRODUCTION_MARKS]) as earlier:
        assert earlier
        write_numbers(evidence, out)
        write_pictures(evidence, out)
    assert (out / "reproduction.html").exists()


def test_an_own_study_comes_back_as_it_was_written(folder, content):
    study = read_study(folder)
    assert study.identification == content
    shipped_inertia = next(entry["value"] for entry in shipped()["spread"] if entry["name"] == "inertia")
    assert list(study.profiles) == list(DEVICES)
    for profile in study.profiles.values():
        [item] = profile.plant.masses
        assert inertia([item.mass], [item.arm]) == pytest.approx(HEAVIER * shipped_inertia, rel=1e-3)


def test_the_command_shows_an_own_study_instead_of_the_shipped_one(tmp_path, capsys, content, done, one_figure):
    status = f"These are the devices of the study in {done.study}: seeds"
    result = json.loads((done.out / "reproduction.json").read_text())
    assert result["parameters"]["status"].startswith(STATUS) and status in result["parameters"]["status"]
    assert result["parameters"]["identified"] == {entry["name"]: entry["value"] for entry in content["spread"]}
    ours = [row.ours for row in done.evidence.reproduction.rows]
    assert [row["ours"] for row in result["rows"]] == ours
    assert ours != [row.ours for row in results.reproduce().rows]
    page = (done.out / "reproduction.html").read_text()
    assert page.count("<svg") == len(list(done.out.glob("*.png"))) == len(CAPTIONS)
    for text in (done.printed, done.document.read_text(), page):
        assert status in " ".join(text.split())
    shutil.rmtree(done.study)  # the reproduction holds a copy
    assert main(["rerun", str(done.out), "--out", str(tmp_path / "again")]) == 0
    assert "numbers are the same" in capsys.readouterr().out


def test_the_terminal_shows_every_number_in_80_columns(evidence):
    text = in_words(evidence)
    assert max(map(len, text.splitlines())) <= 80
    for row in evidence.reproduction.rows:
        assert any(f"{row.cell.value:g}" in line.split() for line in text.splitlines())
    for answer in evidence.hypotheses:
        section = text.split(f"Hypothesis {answer.number}: {answer.verdict}\n")[1].split("Hypothesis")[0]
        assert len(re.findall(r" (yes|no)  ", section)) == len(answer.criteria)
        for item in answer.criteria:
            assert all(word in section for word in item.words.split())


def without_key(content: dict[str, Any]) -> None:
    del content["springs"]


def without_parameter(content: dict[str, Any]) -> None:
    del content["without"]["variable"]["inertia"]


def without_spring_parameter(content: dict[str, Any]) -> None:
    del content["springs"][0]["parameters"]["inertia"]


def with_one_bound(content: dict[str, Any]) -> None:
    content["spread"][0]["bounds"].pop()


def with_truth_for_a_number(content: dict[str, Any]) -> None:
    content["cost"] = True


def with_an_empty_list(content: dict[str, Any]) -> None:
    content["starts"] = []


def with_less_than_zero(content: dict[str, Any]) -> None:
    content["spread"][0]["value"] = -1


def with_unknown_parameter(content: dict[str, Any]) -> None:
    content["spread"].append({**content["spread"][0], "name": "colour"})


def with_text_for_a_number(content: dict[str, Any]) -> None:
    content["spread"][0]["value"] = "heavy"


def with_nan(content: dict[str, Any]) -> None:
    content["cost"] = float("nan")


def with_zero(content: dict[str, Any]) -> None:
    content["without"]["tension-5"]["max_deflection"] = 0.0


def with_another_reading(content: dict[str, Any]) -> None:
    content["readings"]["eq6"] = "printed"


def without_a_refit(content: dict[str, Any]) -> None:
    content["readings_refitted"].pop()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without_key, "lacks springs; identify again"),
        (without_spring_parameter, "'springs.0.parameters' lacks inertia"),
        (with_one_bound, "each 'bounds' in 'spread' has to hold two numbers"),
        (with_truth_for_a_number, "'cost' is 'True'; it has to be a number"),
        (with_an_empty_list, "'starts' is '\\[\\]'; it has to be a list that is not empty"),
        (with_less_than_zero, "'spread.inertia' is -1; it has to be greater"),
        (without_parameter, "'without.variable' lacks inertia"),
        (with_unknown_parameter, "'spread' has colour, which this version does not know"),
        (with_text_for_a_number, "'spread.0.value' is 'heavy'"),
        (with_nan, "NaN is no number in JSON"),
        (with_zero, "'without.tension-5.max_deflection' is 0"),
        (with_another_reading, "other readings: eq6 printed \\(not text\\)"),
        (without_a_refit, "'readings_refitted' lacks isav_columns as-printed"),
    ],
)
def test_a_study_with_something_wrong_is_refused_with_the_key(tmp_path, content, spoil: Callable[..., None], message):
    folder = write_study(tmp_path / "study", content)
    spoilt = json.loads(json.dumps(content))
    spoil(spoilt)
    (folder / "identification.json").write_text(json.dumps(spoilt))
    with pytest.raises(AmulettError, match=message):
        read_study(folder)


@pytest.mark.parametrize("text", ["{", "[1]", "[" * 100_000, "3"])
def test_a_study_that_is_no_json_mapping_is_refused(tmp_path, text):
    (tmp_path / "identification.json").write_text(text)
    with pytest.raises(AmulettError, match="identification.json'"):
        read_study(tmp_path)


def test_a_folder_without_a_finished_study_is_refused_before_any_work(tmp_path, capsys, no_work):
    assert "holds no study" in refusal(capsys, "--study", str(tmp_path / "nowhere"))
    (tmp_path / "recipe.json").write_text("{}")
    out = tmp_path / "out"
    assert "is not finished" in refusal(capsys, "--study", str(tmp_path), "--out", str(out))
    assert not out.exists()


def test_profiles_that_are_not_the_studys_are_refused(tmp_path, content):
    folder = write_study(tmp_path / "study", content)
    (folder / "testbed.yaml").write_text(profile_text("testbed", shipped()))
    with pytest.raises(AmulettError, match="testbed.yaml' does not describe the device of"):
        read_study(folder)
    (folder / "testbed.yaml").unlink()
    with pytest.raises(AmulettError, match="cannot read profile .*testbed.yaml"):
        read_study(folder)
