"""The style of all figures: the only module that sets up matplotlib.

Figures do not depend on the user's matplotlib settings: ``MPLBACKEND``, a ``matplotlibrc`` or changed ``rcParams``.
They are drawn without pyplot, and do not change its settings. Import matplotlib's classes from here: importing
matplotlib itself fails if its backend is set to one that is not installed. Colours are those of Okabe and Ito, which
colour-blind readers can distinguish.
"""

from __future__ import annotations

import io
import os
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ParamSpec

from amulett_gym.errors import AmulettError
from amulett_gym.reporting.figure_files import KINDS, figure_files
from amulett_gym.storage.writing import atomic_path


def _import_matplotlib() -> None:
    """Import matplotlib; if the user's settings make that fail, without them."""
    try:
        import matplotlib

        return
    except (ValueError, OSError):  # MPLBACKEND is not a backend; matplotlibrc is not text, or cannot be read
        backend = os.environ.pop("MPLBACKEND", None)
    for name in [name for name in sys.modules if name.startswith("matplotlib.")]:
        del sys.modules[name]  # the parts that were imported before it failed
    found = find_spec("matplotlib")
    assert found is not None and found.origin is not None
    try:
        # A matplotlibrc in the current folder is preferred to all others; this folder has matplotlib's own.
        with chdir(Path(found.origin).parent / "mpl-data"):
            import matplotlib  # noqa: F401
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


_import_matplotlib()

import matplotlib as mpl  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator  # noqa: E402

__all__ = ["Figure", "FuncFormatter", "Line2D", "LogLocator", "MaxNLocator", "Patch", "figure_svg", "save_figure"]
__all__ += ["styled"]

BLACK, GREY = "#000000", "#7a7a7a"
ORANGE, SKY, GREEN, BLUE, RED, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
INDIGO, OLIVE, BROWN = "#5B4BA8", "#9AA51E", "#8A5A33"

JOINT, BICEPS, TRICEPS, SETPOINT = "#1F2937", "#0F76B2", "#C76214", "#1C915A"
"""The renderer's colours (`envs.rendering.canvas`): a string has the same colour everywhere."""

WIDTH = 10.0
"""Width of a comparison's figures [in]: one text size on the page."""

PRINT_WIDTH = 7.0
"""Width of the paper's figures [in]: the text width of a printed page."""

_SETTINGS = {key: value for key, value in mpl.rcParamsDefault.items() if key != "backend"} | {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "figure.dpi": 100,
    "savefig.dpi": 180,
    "svg.hashsalt": "amulett-gym",
    "pdf.fonttype": 42,  # fonts are embedded as TrueType, which publishers ask for
}
"""All of matplotlib's settings, its own defaults included: none depends on the user's."""

_IN_PRINT = dict.fromkeys(
    ("font.size", "axes.titlesize", "axes.labelsize", "legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 8.0
) | {"lines.linewidth": 1.0, "lines.markersize": 4.0, "savefig.dpi": 600, "figure.constrained_layout.w_pad": 0.09}
"""Other settings in print: text of 8 pt at the printed size, and pixels for a printer."""

_CHARACTER = 0.06
"""Mean width of a character of 8 pt [in]."""

_LINE = 0.14
"""Height of a line of text in print [in]."""

_LEGEND_ROW = 0.17
"""Height of a row of a legend in print [in]."""

P = ParamSpec("P")
Estimate = Mapping[str, float | None]
"""``"mean"``, ``"low"`` and ``"high"``; None: undefined."""


@contextmanager
def _settings() -> Iterator[None]:
    """Use our settings of matplotlib within a block."""
    with mpl.rc_context():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # some defaults are deprecated
            mpl.rcParams.update(_SETTINGS)
            if figure_files().columns is not None:
                mpl.rcParams.update(_IN_PRINT)
        yield


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Return a function that draws in our style; matplotlib's settings are neither used nor changed."""

    @wraps(draw)
    def styled(*args: P.args, **keywords: P.kwargs) -> Figure:
        with _settings():
            figure = draw(*args, **keywords)
            if figure_files().columns is not None:
                _wrap_words(figure)
            FigureCanvasAgg(figure)  # not the canvas of the user's backend
            engine = figure.get_layout_engine()
            if engine is not None:  # only once: it moves things a little in every run
                engine.execute(figure)
            figure.set_layout_engine(None)
            return figure

    return styled


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF, by the file's suffix, completely or not at all.

    Raises
    ------
    AmulettError
        If the suffix is another one or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in KINDS:
        known = ", ".join(f".{name}" for name in KINDS)
        raise AmulettError(f"'{path}' has to end in one of {known}, the kinds of figures")
    with atomic_path(path) as temporary:
        _write(figure, temporary, kind)


def save_figures(figures: Mapping[str, Figure], folder: Path, kind: str | None = None) -> list[Path]:
    """Write figures into a folder, by their names, and return the files; their kind is the chosen one, or PNG."""
    kind = kind or figure_files().kind or KINDS[0]
    paths = [folder / f"{name}.{kind}" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        save_figure(figure, path)
    return paths


def figure_svg(figure: Figure, prefix: str) -> str:
    """Return a figure as an SVG element for a page; `prefix` makes its ids differ from those of other figures."""
    buffer = io.StringIO()
    _write(figure, buffer, "svg")
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    if (width := figure_files().width) is not None:  # a page would make it as wide as itself
        svg = svg.replace("<svg", f'<svg style="max-width: {1.5 * width:g}in"', 1)
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    return re.sub(r'((?:url\(|href=")#)', rf"\g<1>{prefix}-", svg)


def _write(figure: Figure, target: Path | io.StringIO, kind: str) -> None:
    """Write a figure as one of `KINDS`, without dates and versions: the same bytes each time."""
    backend, metadata = {
        "png": ("agg", {"Software": None}),
        "svg": ("svg", {"Date": None, "Creator": None}),
        "pdf": ("pdf", {"CreationDate": None, "Creator": None, "Producer": None}),
    }[kind]
    with _settings():
        figure.savefig(target, format=kind, backend=backend, metadata=metadata)


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """Return an empty figure with automatic layout; sizes in inches, on a screen.

    In print the width is that of the columns. The height shrinks less than the width, since text does not shrink.
    """
    printed = figure_files().width
    if printed is not None:
        height, width = height * min(1.0, (printed / width) ** 0.4), printed
    return Figure(figsize=(width, height), layout="constrained")


def _wrap_words(figure: Figure) -> None:
    """Break titles and labels that are longer than what they belong to, and make the figure higher by their lines."""
    wide, high = figure.get_size_inches()
    if (title := figure.get_suptitle()) != "":
        figure.suptitle(_broken(title, wide), fontsize=mpl.rcParams["font.size"])
    if (label := figure.get_supxlabel()) != "":
        figure.supxlabel(_broken(label, wide), fontsize=mpl.rcParams["font.size"])
    added: dict[int, int] = {}
    for panel in figure.axes:
        spec = panel.get_subplotspec()
        rows, columns = (1, 1) if spec is None else spec.get_gridspec().get_geometry()
        row, across, up = (0, 1, 1) if spec is None else (spec.rowspan.start, len(spec.colspan), len(spec.rowspan))
        panel.yaxis.label.set_text(_broken(panel.get_ylabel(), high * up / rows))
        lines = 0
        for words in (panel.title, panel.xaxis.label):
            broken = _broken(words.get_text(), wide * across / columns)
            lines += broken.count("\n") - words.get_text().count("\n")
            words.set_text(broken)
        added[row] = max(added.get(row, 0), lines)
    figure.set_figheight(high + _LINE * sum(added.values()))


def _broken(text: str, length: float) -> str:
    """Return text in lines of at most a length [in]; the user's own line breaks stay."""
    most = max(int(length / _CHARACTER) - 4, 10)
    return "\n".join(textwrap.fill(line, most, break_long_words=False) for line in text.split("\n"))


def one_panel(height: float, width: float = WIDTH) -> tuple[Figure, Any]:
    """Return a figure and its only panel."""
    figure = new_figure(height, width)
    return figure, figure.subplots()


_LEAST_PANEL = 1.7
"""Least width of a panel in print, with its labels [in]."""


def panels_across(columns: int) -> int:
    """Return how many columns of panels a figure has that would have `columns` on a screen."""
    printed = figure_files().width
    return columns if printed is None else min(columns, int(printed / _LEAST_PANEL))


def panel_grid(count: int, columns: int, margin: float, height: float, **sharing: Any) -> tuple[Figure, list[Any]]:
    """Return a figure and its `count` panels, row by row, in at most `columns` columns.

    `margin` is the height of the figure without panels, `height` that of a panel [in]; `sharing` is ``sharex``,
    ``sharey``.
    """
    columns = panels_across(min(count, columns))
    rows = -(-count // columns)
    figure = new_figure(margin + rows * height)
    grid = figure.subplots(rows, columns, squeeze=False, **sharing)
    for panel in grid.flat[count:]:
        panel.set_axis_off()
    return figure, list(grid.flat[:count])


def draw_dot(
    panel: Any, x: Estimate, y: Estimate | float, colour: str, marker: str, label: str = "", **keywords: Any
) -> None:
    """Draw a point with the intervals of its coordinates; `label` is its entry in the legend."""
    across, up = x["mean"], y["mean"] if isinstance(y, Mapping) else y
    bars = {"xerr": reach(x), "yerr": reach(y) if isinstance(y, Mapping) else None}
    shape = {"markersize": 7, "elinewidth": 1.1, "markeredgecolor": "white", "markeredgewidth": 0.6} | keywords
    panel.errorbar(across, up, **bars, color=colour, marker=marker, linewidth=0.0, **shape)
    if label:
        panel.plot([], [], color=colour, marker=marker, linewidth=0.0, label=label)


def name_rows(panel: Any, names: Sequence[str]) -> None:
    """Name the rows of a panel of bars or dots; the first name is on top, at the highest y."""
    panel.set_yticks(range(len(names)), list(reversed(names)))
    panel.set_ylim(-0.6, len(names) - 0.4)
    panel.tick_params(axis="y", length=0)
    panel.grid(False, axis="y")


def legend_beside(panel: Any, **keywords: Any) -> None:
    """Put the legend to the right of a panel; in one column of print above it, or below the figure's only one.

    Keywords are those of `Axes.legend`.
    """
    if figure_files().columns != 1:
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **keywords)
        return
    handles, labels = panel.get_legend_handles_labels()
    given = {"handles": handles, "labels": labels} | keywords
    ncols, figure = _fitting(given["labels"], 3), panel.figure
    figure.set_figheight(figure.get_figheight() + _LEGEND_ROW * -(-len(given["labels"]) // ncols))
    if len(figure.axes) > 1:
        panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=ncols, **given)
    else:
        figure.legend(loc="outside lower center", ncols=ncols, **given)


def legend_below(figure: Figure, handles: Sequence[Any], ncols: int, place: str = "outside lower center") -> None:
    """Put a legend below all panels, or at another place, with one entry for each label of the handles."""
    labelled = {handle.get_label(): handle for handle in handles if not handle.get_label().startswith("_")}
    fitting = _fitting(labelled, ncols)
    more = -(-len(labelled) // fitting) + (-len(labelled) // ncols)  # rows than on a screen
    figure.set_figheight(figure.get_figheight() + _LEGEND_ROW * more)
    figure.legend(handles=list(labelled.values()), loc=place, ncols=fitting)


def _fitting(labels: Iterable[str], columns: int) -> int:
    """Return how many columns of a legend fit the width in print, at most `columns`."""
    printed, longest = figure_files().width, max(map(len, labels), default=0)
    return columns if printed is None else max(1, min(columns, int(printed / (longest * _CHARACTER + 0.45))))


def label_outer(panels: Sequence[Any], x_label: str, y_label: str) -> None:
    """Label the x axes of a grid's lowest panels and the y axes of its leftmost panels."""
    for k, panel in enumerate(panels):
        columns = panel.get_subplotspec().get_gridspec().ncols
        if k % columns == 0:
            panel.set_ylabel(y_label)
        if k + columns >= len(panels):
            panel.set_xlabel(x_label)
            panel.tick_params(labelbottom=True)


PLAIN = FuncFormatter(lambda value, _: f"{value:g}")
"""Ticks without exponents, also on logarithmic axes."""


def reach(estimate: Estimate) -> list[list[float]] | None:
    """Return an interval's distances below and above its mean, for `Axes.errorbar`; None without an interval."""
    middle, low, high = estimate["mean"], estimate["low"], estimate["high"]
    if middle is None or low is None or high is None:
        return None
    return [[max(middle - low, 0.0)], [max(high - middle, 0.0)]]
