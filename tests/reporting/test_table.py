"""One table in four forms: no word is cut, no line of text is too long, HTML and Markdown are escaped."""

import csv
import io

import pytest
from markupsafe import Markup

from amulett_gym.reporting.table import Table, csv_text

WIDE = Table(
    "What an episode costs with each of the contenders that were compared, on scenarios that none was trained on",
    ("policy", "cost", "ratio to eq6 [95 %]", "position ISE [deg2 s]", "effort of both drives [deg2/s]",
     "rise [s] (risen)", "resting stiffness [N m/rad]", "push deflection [deg]", "failed"),
    [["constant:5.25", "0.853", "0.853 [0.841, 0.866]", "2269", "1.23e+06", "0.412 (98%)", "12.4", "3.21", "0%"],
     ["eq6", "1.00", "1", "2310", "1.53e+06", "0.398 (100%)", "14.1", "2.98", "100%"]],
    "Means over the scenarios; the ratio is that of the sums, with its interval; what is not reached is left out here.",
)  # fmt: skip


def test_a_narrow_table_is_aligned():
    table = Table("Title", ("", "a", "bb"), [["one", "1", "2"], ["twelve", "12", "34"]], "Note.")
    assert table.text().splitlines() == [
        "Title",
        "         a  bb",
        "--------------",
        "one      1   2",
        "twelve  12  34",
        "Note.",
    ]


@pytest.mark.parametrize("width", [40, 60, 80, 120, 300])
def test_a_wide_table_keeps_to_the_width_and_cuts_no_word(width):
    lines = WIDE.text(width).splitlines()
    assert max(map(len, lines)) <= width
    words = {word for line in lines for word in line.split()}
    cells = [*WIDE.head, *(cell for row in WIDE.rows for cell in row), WIDE.title, WIDE.note]
    assert {word for cell in cells for word in cell.split()} <= words
    text = "\n".join(lines)
    assert "0.853 [0.841, 0.866]" in text and "[N m/rad]" in text  # neither numbers nor units are wrapped
    blocks = sum(line.startswith("eq6") for line in lines)
    assert sum(line.startswith("constant:5.25") for line in lines) == blocks
    assert blocks == 1 if width == 300 else blocks >= 1


def test_columns_of_words_are_wrapped_and_numbers_are_not():
    sentence = "the learned policy costs at most 0.65 of what eq. 6 costs on the scenarios that nothing was trained on"
    table = Table("", ("claim", "measured", "95 %"), [[sentence, "0.6421", "[0.63, 0.65]"], ["short", "1", ""]])
    lines = table.text().splitlines()
    assert max(map(len, lines)) <= 80
    assert " ".join(" ".join(line[:50].split()) for line in lines[2:-1]).startswith("the learned policy")
    assert sum("[0.63, 0.65]" in line for line in lines) == 1
    assert len(lines) == 2 + 2 + 1


def test_without_headings_there_is_no_rule():
    assert Table("", ("", ""), [["a", "1"], ["bbb", "20"]]).text() == "a     1\nbbb  20"


def test_an_empty_table_is_its_headings():
    assert Table("", ("name", "x"), []).text().splitlines() == ["name  x", "-------"]


def test_markdown_aligns_and_escapes():
    table = Table("Title", ("", "|x|", "words"), [["a|b", "1", "c"]], "Note.", left=(0, 2))
    assert table.markdown() == ("### Title\n\n|  | \\|x\\| | words |\n| --- | ---: | --- |\n| a\\|b | 1 | c |\n\nNote.")
    assert Table("", ("a",), [["b"]]).markdown() == "| a |\n| --- |\n| b |"


def test_html_escapes_all_but_html():
    table = Table(
        "", ("", "x [deg2]", "words"), [["<b>", "1.00e+06", Markup("<i>kept</i>")]], "See `file`.", left=(0, 2)
    )
    page = table.html()
    assert "&lt;b&gt;" in page and "<i>kept</i>" in page and "<code>file</code>" in page
    assert '<td data-label="x [deg²]:">1.00×10⁶</td>' in page
    assert '<td class="words" data-label="words:">' in page
    assert page.count("<tr>") == page.count("</tr>") == 2


def test_csv_has_all_digits_and_leaves_empty_what_does_not_exist():
    text = csv_text(("a", "b", "c", "d"), [(0.1 + 0.2, None, float("nan"), 'say "no", twice')])
    assert list(csv.reader(io.StringIO(text))) == [["a", "b", "c", "d"], [repr(0.1 + 0.2), "", "", 'say "no", twice']]
