"""What a sample of plausible devices looks like: in words, as tables of a document, and as a figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from amulett_gym.reporting import style
from amulett_gym.reporting.document import image, marks
from amulett_gym.reporting.style import Figure
from amulett_gym.reporting.table import Table
from amulett_gym.studies.paper.sample import FLEETS, PASSES, SCENARIOS, STIFFNESS_AT, SUITE

MARKS = marks("amulett identify --fleet")
"""Lines around the generated part of the document."""

FIGURE = "plausible_devices"

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN)

_LABELS = {
    "inertia": "inertia J",
    "radius_ratio": "pulley ratio R₁/R₂",
    "max_force": "largest table force",
    "max_deflection": "deflection there",
    "width_ratio": "half width / deflection",
    "length_ratio": "free length / half width",
    "testbed.lag": "drives' lag",
    "testbed.rate_limit": "drives' speed",
    "testbed.slider_noise": "slider noise",
    "stop_stiffness": "stop's stiffness",
    "stall_torque": "stall torque",
    "joint_pulley_radius": "joint pulley R₂",
    "mass_arm": "arm of the mass",
    "encoder_noise": "encoder noise",
    "potentiometer_travel": "potentiometers' travel",
    "command_limit": "command limit",
}
"""Parameter -> its name in the figure."""

_FOR_A_LAW = (
    ("best_constant", "best constant tension [N]"),
    ("best_constant_cost", "its cost relative to eq. 6"),
    ("eq6_position", "eq. 6: position ISE [deg2 s]"),
    ("eq6_effort", "eq. 6: effort [deg2/s]"),
    (0, f"stiffness at {STIFFNESS_AT[0]:g} N [N m/rad]"),
    (1, f"stiffness at {STIFFNESS_AT[1]:g} N [N m/rad]"),
    ("explained", "rows explained"),
    ("cost", "cost of the fit"),
)


def in_words(content: Mapping[str, Any]) -> str:
    """Return how a sample was drawn, and its tables, for the terminal."""
    return "\n\n".join([_summary(content), *(table.text() for table in _tables(content))])


def block(content: Mapping[str, Any]) -> str:
    """Return the generated part of the document."""
    figure = image(
        FIGURE,
        "Left: the devices' parameters within the ranges that were searched or drawn from, on the scale of the search; "
        "black: the shipped testbed. Right: rank correlations; inertia, deflection, slider noise and stall torque go "
        "with the joint pulley's radius.",
        "Parameters of the plausible devices and their rank correlations",
    )
    tables = [table.markdown() for table in _tables(content)]
    return "\n\n".join([_summary(content), *tables[:2], figure, tables[2]])


def _summary(content: Mapping[str, Any]) -> str:
    recipe, refused = content["recipe"], content["refused"]
    words = " ".join(content["command"])
    return (
        f"A device is within the bound if its cost exceeds the least one, {content['least_cost']:.2f}, by at most "
        f"{recipe['bound']:g}. The walks gave {content['members']} sets. {content['tried']} draws of what no table "
        f"sees (up to {PASSES} for a set) gave "
        f"{len(content['devices'])} devices. Refused were {refused['range']} draws that left the searched ranges, "
        f"{refused['cost']} by the bound, and {refused['environment']} with which an environment cannot play. "
        f"{_findings(content)}"
        f"\n\nCommand: `{words}`"
    )


def _findings(content: Mapping[str, Any]) -> str:
    """Return what `diagnose` finds in the devices, in the paper's loop and the default tension range."""
    kinds = Counter(kind for device in content["devices"] for kind in device["findings"])
    found = ", ".join(f"{kind} ({count} devices)" for kind, count in kinds.most_common())
    return f"`amulett config validate` finds: {found}." if found else ""


def _tables(content: Mapping[str, Any]) -> list[Table]:
    return [_start_table(content), _spread_table(content), _law_table(content)]


def _start_table(content: Mapping[str, Any]) -> Table:
    ends = [device["parameters"]["length_ratio"] for device in content["devices"]]
    rows = []
    for start in content["starts"]:
        kind, _, ratio = start["name"].partition("-")
        label = f"free length {float(ratio):g} of the half width" if kind == "spring" else f"seed {start['name']}"
        found = start["parameters"]
        rows.append(
            [label, f"{start['cost']:.2f}", f"{start['explained']} of {content['of']}", f"{found['length_ratio']:.2f}"]
            + [_digits(found[name]) for name in ("width_ratio", "max_force", "stall_torque") if name in found]
            + [str(start["walked"])]
        )
    own = ("stall torque [N m]",) if "stall_torque" in content["starts"][0]["parameters"] else ()
    fitted = ("free length / half width", "half width / deflection", "end force [N]", *own)
    return Table(
        "Starts",
        ("search", "cost", "rows explained", *fitted, "sets walked from it"),
        rows,
        "No set is walked from a start beyond the bound. The free length decides the spring's law: 0 is linear, 1 "
        f"cubic at rest. In the devices it is from {min(ends):.2f} to {max(ends):.2f}.",
    )


def _spread_table(content: Mapping[str, Any]) -> Table:
    return Table(
        "What varies",
        ("parameter", "unit", "lowest", "median", "highest", "shipped", "possible", "how", "source of the range"),
        [
            [
                f"`{item['name']}`",
                item["unit"],
                *map(_digits, (item["range"][0], item["median"], item["range"][1])),
                "" if item["shipped"] is None else _digits(item["shipped"]),
                "{:g} to {:g}".format(*item["bounds"]),
                item["kind"],
                item["source"],
            ]
            for item in content["parameters"]
        ],
        left=(0, 1, 7, 8),
    )


def _law_table(content: Mapping[str, Any]) -> Table:
    rows = []
    for key, label in _FOR_A_LAW:
        cells = [label]
        for begin in FLEETS.values():
            values = [_of(device, key) for device in _devices(content, begin)]
            known = [value for value in values if value is not None]
            shown = map(_digits, (float(np.median(known)), min(known), max(known))) if known else ()
            cells.append("{} ({} to {})".format(*shown) if known else "")
        rows.append(cells)
    return Table(
        "How different the devices are for a law",
        ("median (lowest to highest)", *(f"`{fleet}`" for fleet in FLEETS)),
        rows,
        f"Constants: {SCENARIOS} training scenarios of `{SUITE}`, tensions from 4 to 15 N in steps of 0.25 N about the "
        f"best whole number. Eq. 6: training scenarios of `{SUITE}`. Stiffness: of the resting joint, both strings at "
        "this tension.",
    )


def _digits(value: float) -> str:
    """Return a number with three digits, large ones without exponent."""
    text = f"{value:.3g}"
    return f"{float(text):.0f}" if "e+" in text else text


def _devices(content: Mapping[str, Any], begin: str) -> list[Mapping[str, Any]]:
    return [device for device in content["devices"] if device["name"].startswith(f"{begin}-")]


def _of(device: Mapping[str, Any], key: str | int) -> float | None:
    return device["stiffness"][key] if isinstance(key, int) else device[key]


def draw(content: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the figure by its name: spread of the parameters, and their correlations."""
    return {FIGURE: _figure(content)}


@style.styled
def _figure(content: Mapping[str, Any]) -> Figure:
    parameters: Sequence[Mapping[str, Any]] = content["parameters"]
    labels = [_LABELS[item["name"]] for item in parameters]
    figure = style.new_figure(0.36 * len(labels) + 1.6)
    spread, map_ = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    rng, rows = np.random.default_rng(0), np.arange(len(labels))[::-1]
    for fleet, begin, colour in zip(FLEETS, FLEETS.values(), _COLOURS, strict=True):
        for row, item in zip(rows, parameters, strict=True):
            values = [device["parameters"][item["name"]] for device in _devices(content, begin)]
            places = [_place(item, value) for value in values]
            shift = rng.uniform(-0.28, 0.28, len(places))
            label = fleet if row == rows[0] else ""
            spread.plot(places, row + shift, ".", color=colour, markersize=4, alpha=0.7, label=label)
    known = [
        (row, _place(item, item["shipped"])) for row, item in zip(rows, parameters, strict=True) if item["shipped"]
    ]
    across, up = [place for _, place in known], [row for row, _ in known]
    spread.plot(across, up, "|", color=style.BLACK, markersize=15, markeredgewidth=1.8, label="shipped testbed")
    style.name_rows(spread, labels)
    spread.set_xlim(-0.02, 1.02)
    spread.set_xticks([0, 0.5, 1], ["least", "", "most"])
    spread.set_xlabel("place in the range")
    correlations = np.array(content["correlations"])
    shown = np.where(np.tri(len(labels), k=-1) > 0, correlations, np.nan)
    map_.imshow(shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(np.abs(np.nan_to_num(shown)) >= 0.2), strict=True):
        dark = abs(shown[i, j]) > 0.6
        map_.text(j, i, f"{shown[i, j]:.1f}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    map_.set_yticks([])
    map_.set_xticks(range(len(labels)), labels, rotation=90)
    map_.grid(False)
    map_.set_ylim(len(labels) - 0.4, -0.6)
    map_.set_xlabel("rank correlation with the parameter of the row")
    style.legend_below(figure, spread.get_lines(), 4)
    return figure


def _place(item: Mapping[str, Any], value: float) -> float:
    """Return the place of a value in its range, 0 to 1, on the scale of the search."""
    low, high = item["bounds"]
    if low > 0.0:
        return float(np.log(value / low) / np.log(high / low))
    return float((value - low) / (high - low))
