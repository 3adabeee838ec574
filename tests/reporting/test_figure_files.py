"""Figures for print: kinds of files, widths, text sizes; the same bytes each time."""

import re
import zlib

import pytest
from PIL import Image

from amulett_gym.cli import build_parser, main
from amulett_gym.errors import AmulettError
from amulett_gym.reporting import style
from amulett_gym.reporting.figure_files import COLUMN_WIDTHS, KINDS, figure_files, figures_as

LONG = "a label that is much longer than a figure of one column is wide, in words of a usual length"


@style.styled
def draw() -> style.Figure:
    figure, panels = style.panel_grid(4, 4, 0.5, 2.5)
    for k, panel in enumerate(panels):
        panel.plot([0, 1], [k, 1 - k], label=f"line {k}")
        panel.set(title=LONG, xlabel=LONG, ylabel="value")
    style.legend_below(figure, [panel.lines[0] for panel in panels], ncols=4)
    return figure


@style.styled
def draw_one() -> style.Figure:
    figure, panel = style.one_panel(4.0)
    for k in range(6):
        panel.plot([0, 1], [k, 1 - k], label=f"line {k}")
    style.legend_beside(panel)
    return figure


@pytest.mark.parametrize("columns", [None, *COLUMN_WIDTHS])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_the_width_of_its_columns_and_the_same_bytes_each_time(tmp_path, kind, columns):
    found = []
    for folder in ("first", "second"):
        with figures_as(kind, columns):
            [path] = style.save_figures({"figure": draw()}, tmp_path / folder)
        found.append(path.read_bytes())
    assert path.suffix == f".{kind}" and found[0] == found[1]
    width = style.WIDTH if columns is None else COLUMN_WIDTHS[columns]
    assert _width(path) == pytest.approx(width, abs=0.01)
    assert figure_files().columns is None


def _width(path):
    """Return the width of a figure's file [in]."""
    if path.suffix == ".png":
        with Image.open(path) as image:
            return image.width / image.info["dpi"][0]
    pattern = rb'width="([\d.]+)pt"' if path.suffix == ".svg" else rb"/MediaBox \[ 0 0 ([\d.]+) "
    [points] = re.findall(pattern, path.read_bytes())[:1]
    return float(points) / 72.0


def test_a_pdf_embeds_its_fonts_and_names_no_date(tmp_path):
    with figures_as("pdf", 1):
        [path] = style.save_figures({"figure": draw()}, tmp_path)
    content = path.read_bytes()
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.DOTALL):
        try:
            content += zlib.decompress(stream)
        except zlib.error:
            continue
    assert b"/FontFile2" in content and b"/Type3" not in content  # TrueType, which is fonttype 42
    assert b"CreationDate" not in content and b"Matplotlib" not in content


@pytest.mark.parametrize("drawn", [draw, draw_one])
@pytest.mark.parametrize("columns", COLUMN_WIDTHS)
def test_in_print_text_is_legible_and_within_the_figure(columns, drawn):
    with figures_as(columns=columns):
        figure = drawn()
        with style._settings():
            figure.canvas.draw()
            box, (wide, high) = figure.get_tightbbox(), figure.get_size_inches()
    texts = [text for text in figure.findobj(style.mpl.text.Text) if text.get_text()]
    assert min(text.get_fontsize() for text in texts) >= 7.0
    assert min(box.x0, box.y0) >= -0.01 and box.x1 <= wide + 0.01 and box.y1 <= high + 0.01


def test_a_figure_of_another_kind_is_refused(tmp_path):
    with pytest.raises(AmulettError, match=r"figure.jpg' has to end in one of \.png, \.svg, \.pdf"):
        style.save_figure(draw_one(), tmp_path / "figure.jpg")


def _plotting():
    """Return the commands that draw figures, with their parsers."""
    commands = build_parser()._subparsers._group_actions[0].choices
    return {name: parser for name, parser in commands.items() if parser.get_default("figures_into")}


def test_every_command_that_plots_has_the_options():
    assert {"simulate", "evaluate", "benchmark"} <= set(_plotting())
    for name, parser in _plotting().items():
        assert "--columns {1,2}" in parser.format_help()
        assert ("--format {png,svg,pdf}" in parser.format_help()) == (name != "simulate")  # there, the suffix says it
        options = {action.dest for action in parser._actions}
        assert set(parser.get_default("figures_into")) <= options, name


@pytest.mark.parametrize("name", sorted(set(_plotting()) - {"benchmark", "fit"}))  # these two always write figures
def test_how_figures_are_drawn_is_refused_where_none_are(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    needed = {"evaluate": ["--policies", "eq6"], "hil": ["firmware"], "identify": ["--out", "out"]}.get(name, [])
    for options in (["--columns", "1"], ["--format", "svg"]):
        if name == "simulate" and options[0] == "--format":
            continue
        assert main([name, *needed, *options]) == 2
        said = capsys.readouterr().err
        places = [
            each for each in _plotting()[name].get_default("figures_into") if each != "doc" or "--columns" in options
        ]
        wanted = " or ".join(f"--{each}" for each in places)
        assert f"{options[0]} is for figures, which are written only with {wanted}" in said
    assert list(tmp_path.iterdir()) == []


def test_commands_write_what_was_chosen(tmp_path, capsys):
    words = ["simulate", "--duration", "1", "--columns", "1", "--plot"]
    assert main([*words, str(tmp_path / "step.pdf")]) == 0
    assert _width(tmp_path / "step.pdf") == pytest.approx(3.5, abs=0.01)
    assert main([*words, str(tmp_path / "step.jpg")]) == 2
    assert ".png or .svg or .pdf" in capsys.readouterr().err
    out = tmp_path / "compared"
    words = ["evaluate", "--policies", "constant:6", "--episodes", "2", "--duration", "1", "--out", str(out)]
    for kind in ("png", "svg"):
        assert main([*words, "--format", kind, "--columns", "2"]) == 0
        figures = {path.stem for path in out.iterdir() if path.suffix == f".{kind}"}
        assert {"cost", "schedule", "responses"} <= figures
        assert "<svg style=" in (out / "report.html").read_text()
    assert list(out.glob("*.png")) == []  # of the earlier comparison
