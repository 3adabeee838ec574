"""A document's generated parts are renewed between their marks, and nothing else of it changes."""

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.reporting.document import check_document, image, marks, update_document
from amulett_gym.reporting.style import Figure, styled

ONE, TWO = marks("amulett one"), marks("amulett two --all")


@pytest.fixture
def document(tmp_path):
    path = tmp_path / "document.md"
    path.write_text("\n".join(["before", *ONE, "between", TWO[0], "old", TWO[1], "after"]))
    return path


@styled
def figure() -> Figure:
    figure = Figure(figsize=(1, 1))
    figure.subplots()
    return figure


def test_only_what_is_given_is_renewed(document, tmp_path):
    check_document(document, [ONE, TWO], images=True)
    update_document(document, {ONE: image("plot", "What it shows.")}, {"plot": figure()})
    text = document.read_text()
    assert f"{ONE[0]}\n\n![What it shows.](images/plot.png)\n\n*What it shows.*\n\n{ONE[1]}" in text
    assert text.startswith("before\n") and text.endswith(f"{TWO[0]}\nold\n{TWO[1]}\nafter")
    assert (tmp_path / "images" / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_a_check_changes_nothing(document, tmp_path):
    before = document.read_text()
    check_document(document, [ONE], images=True)
    assert document.read_text() == before
    assert [path.name for path in tmp_path.iterdir()] == ["document.md"]


@pytest.mark.parametrize("broken", ["", "{1}\n{0}", "{0}\n{0}\n{1}", "{0}"])
def test_marks_have_to_be_there_once_in_their_order(tmp_path, broken):
    path = tmp_path / "document.md"
    path.write_text(broken.format(*ONE))
    with pytest.raises(AmulettError, match="has to hold the line"):
        check_document(path, [ONE])


def test_a_place_for_figures_that_is_none_is_refused(document, tmp_path):
    (tmp_path / "images").write_text("a file")
    check_document(document, [ONE])
    with pytest.raises(AmulettError, match="cannot write to '.*images'"):
        check_document(document, [ONE], images=True)
