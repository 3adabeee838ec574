"""What `amulett fit` writes and prints: tables, and a page with measured and simulated trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.identification.from_logs.fit import Fit
from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.recording import CHANNELS, FORCES, SLIDERS, Recording
from amulett_gym.identification.from_logs.result import UNITS
from amulett_gym.reporting.page import fill_page
from amulett_gym.reporting.table import Table, fill
from amulett_gym.reporting.words import interval, number

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

Values = NDArray[np.float64]
Titled = tuple[str, "Figure"]

_MOST_POINTS, _MOST_DOTS = 1500, 400  # of a line in a figure, and of the readings beside it
_MOST_LOGS = 4  # drawn
_WHITE = 0.05  # autocorrelation below which residuals are white for practical purposes


def parameter_table(found: Mapping[str, Any], of_recording: bool = False) -> Table:
    """Return the parameters of the device, or those of the recording, with their intervals."""
    rows = [
        (
            f"{each['name']}{' [' + each['unit'] + ']' if each['unit'] else ''}",
            number(each["value"], digits := _digits(each)),
            interval(each["low"], each["high"], digits),
            ("log" if each["determined"] else "prior") + (", unlike the prior" if each["unlike_prior"] else ""),
            interval(*each["prior"]),
        )
        for each in found["parameters"]
        if each["of_recording"] is of_recording
    ]
    note = (
        "Determined by: log, if the interval is at most half as wide as that of the prior, which is what is known of "
        "plausible devices."
    )
    if any(each["loop"] == "closed" for each in found["logs"]):
        note += " A log without the drives' commands tells less than its intervals say: take them as a first guess."
    head = ("parameter", "value", "90 % interval", "determined by", "prior interval")
    return Table("The recording" if of_recording else "The device", head, rows, "" if of_recording else note, (0, 3))


def sensor_table(found: Mapping[str, Any]) -> Table:
    """Return the sensors' noise and resolution."""
    encoder, slider = found["sensors"]["encoder"], found["sensors"].get("sliders")
    keys = ("noise_deg", "low_deg", "high_deg", "resolution_deg")
    rows = [("encoder [deg]", *_sensor(*(encoder[key] for key in keys)))]
    if slider is not None:
        keys = ("noise", "low", "high", "resolution")
        rows.append(("sliders [mm]", *_sensor(*(1000.0 * slider[key] for key in keys))))
    return Table("The sensors", ("sensor", "noise", "90 % interval", "resolution"), rows)


def residual_table(found: Mapping[str, Any]) -> Table:
    """Return size and whiteness of the residuals."""
    rows = [
        (
            f"{channel} [{each['unit']}]",
            number(each["rms"]),
            number(each["largest_autocorrelation"], 2),
            number(each["p"], 2),
            _verdict(each),
        )
        for channel, each in found["residuals"].items()
    ]
    note = "Correlated residuals show what the model does not explain; intervals are widened by them."
    head = ("residual", "rms", "largest autocorrelation", "p of Ljung-Box", "in words")
    return Table("What is left", head, rows, note, (0, 4))


def prediction_table(found: Mapping[str, Any]) -> Table:
    """Return how well held-out logs are predicted; without any, the table has no rows."""
    rows = []
    for each in found["held_out"]:
        for key, value in each["fit"].items():
            channel, unit = key.rsplit("_", 1)
            fitted = found["residuals"].get(channel)
            rows.append(
                (
                    each["log"],
                    f"{channel} [{unit}]",
                    number(value),
                    number(None if fitted is None else fitted["rms"]),
                    number(each["base"][key]),
                )
            )
    head = ("held out", "signal", "rms of the prediction", "rms in the fit", "rms by the base")
    return Table("Prediction", head, rows, "", (0, 1))


def experiment_table(found: Mapping[str, Any]) -> Table:
    """Return what further experiments would tell."""
    rows = [
        (each["name"], each["description"], number(each["shrinks"], 2), ", ".join(each["determines"]) or "-")
        for each in found["experiments"]
    ]
    note = (
        "Width: the factor by which 20 s of it shrink the intervals of the device's parameters, the geometric mean "
        "over all of them."
    )
    return Table("Next experiment", ("experiment", "what it is", "width", "newly determined"), rows, note, (0, 1, 3))


def undetermined_lines(found: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each direction that the logs leave open."""
    logarithmic = {each["name"]: each["unit"] for each in found["parameters"]}
    lines = []
    for direction in found["undetermined"]:
        parts = []
        for name, change in direction.items():
            relative = name not in ("length_ratio",) and not _of_recording(found, name)
            unit = f" {logarithmic[name]}" if logarithmic[name] and not relative else ""
            parts.append(f"{name} {100.0 * np.expm1(change):+.0f} %" if relative else f"{name} {change:+.2g}{unit}")
        together = " together with " if len(parts) > 1 else ""
        lines.append(f"{parts[0]}{together}{', '.join(parts[1:])}: the logs hardly see such a change.")
    return lines


def in_words(found: Mapping[str, Any]) -> str:
    """Return the result as text for the terminal."""
    tables = [parameter_table(found), parameter_table(found, True), sensor_table(found), residual_table(found)]
    tables += [each for each in (prediction_table(found), experiment_table(found)) if each.rows]
    parts = [each.text() for each in tables]
    if lines := undetermined_lines(found):
        parts.insert(1, "\n".join(["What the logs do not determine:", *(fill(f"- {line}") for line in lines)]))
    return "\n\n".join(parts)


def page(fit: Fit, found: Mapping[str, Any], name: str, figures: Mapping[str, Titled], command: str) -> str:
    """Return the result as one HTML page with inline figures.

    Parameters
    ----------
    fit : Fit
    found : mapping
        Its content (`result.content`).
    name, command : str
        Name of the profile, and the command's words.
    figures : mapping
        Of `figures_of`.
    """
    from amulett_gym.reporting.style import figure_svg

    tables = [parameter_table(found), sensor_table(found), residual_table(found)]
    return fill_page(
        "evaluation/fit_page.html.j2",
        name=name,
        found=found,
        tables=[(each.title, each.html()) for each in tables],
        recording=parameter_table(found, True).html(),
        undetermined=undetermined_lines(found),
        prediction=prediction_table(found).html() if found["held_out"] else None,
        experiments=experiment_table(found).html() if found["experiments"] else None,
        figures=[(title, figure_svg(figure, prefix)) for prefix, (title, figure) in figures.items()],
        command=command,
    )


def _digits(each: Mapping[str, Any]) -> int:
    """Return the digits of a parameter with which its interval's width has two."""
    width = each["high"] - each["low"]
    if width <= 0.0 or each["value"] == 0.0:
        return 3
    return int(np.clip(np.ceil(np.log10(abs(each["value"]) / width)) + 2, 3, 7))


def _sensor(noise: float, low: float, high: float, resolution: float) -> tuple[str, str, str]:
    return number(noise), interval(low, high), number(resolution) if resolution else "none seen"


def _verdict(each: Mapping[str, Any]) -> str:
    if each["p"] >= 0.01:
        return "white"
    if abs(each["largest_autocorrelation"]) < _WHITE:
        return "nearly white"
    return f"correlated: {each['rows_that_count_as_one']:.0f} rows count as one"


def _of_recording(found: Mapping[str, Any], name: str) -> bool:
    return any(each["name"] == name and each["of_recording"] for each in found["parameters"])


def figures_of(fit: Fit, held_out: Sequence[Recording]) -> dict[str, Titled]:
    """Return titles and figures of the logs, predicted and fitted, by a short name."""
    drawn = []
    for recording in held_out[:_MOST_LOGS]:
        model = Model(fit.model.template, [recording], whole=True)
        predicted = model.predict([fit.values], fit.noise.get("slider_biceps", 0.0))[0]
        drawn.append((f"Held out: {recording.name}", _figure(model, predicted)))
    names = list(dict.fromkeys(piece.recording.name for piece in fit.model.pieces))[:_MOST_LOGS]
    drawn += [(f"Fitted: {name}", _figure(fit.model, fit.predicted, name)) for name in names]
    return {f"fit-{k}": each for k, each in enumerate(drawn)}


def _figure(model: Model, predicted: Values, name: str | None = None) -> Figure:
    from amulett_gym.reporting.style import BICEPS, BLACK, GREY, JOINT, TRICEPS, label_outer, panel_grid, styled

    @styled
    def draw() -> Figure:
        present = {part.channel for part in model.parts}
        groups = [group for group in (("angle",), SLIDERS, FORCES) if present & set(group)]
        figure, panels = panel_grid(len(groups) + 1, 1, 0.4, 1.6, sharex=True)
        colours = dict(zip(CHANNELS, (JOINT, BICEPS, TRICEPS, BICEPS, TRICEPS), strict=True))
        drawn = [(part, model.piece_of(part)) for part in model.parts]
        drawn = [(part, piece) for part, piece in drawn if name in (None, piece.recording.name)]
        rows = {
            channel: sum(part.cells.stop - part.cells.start for part, _ in drawn if part.channel == channel)
            for channel in CHANNELS
        }
        labels = {channel: channel.split("_")[1] for channel in (*SLIDERS, *FORCES)}
        for part, piece in drawn:
            _, factor = UNITS[part.channel.split("_")[0]]
            time = piece.recording.columns["time"][piece.rows][part.known]
            panel = panels[next(k for k, group in enumerate(groups) if part.channel in group)]
            measured, found = (factor * values[part.cells] for values in (model.measured, predicted))
            line, dots = (slice(None, None, -(-rows[part.channel] // most)) for most in (_MOST_POINTS, _MOST_DOTS))
            panel.plot(time[dots], measured[dots], ".", color=GREY, markersize=1.5)
            label = labels.pop(part.channel, None)
            panel.plot(time[line], found[line], color=colours[part.channel], linewidth=1.0, label=label)
            if part.channel == "angle":
                panels[-1].plot(time[dots], (measured - found)[dots], ".", color=BLACK, markersize=1.5)
        for panel, group in zip(panels, groups, strict=False):
            panel.set_ylabel(f"{group[0].split('_')[0]} [{UNITS[group[0].split('_')[0]][0]}]")
            if group != ("angle",):
                panel.legend(loc="upper right", ncols=2)
        label_outer(panels[-1:], "time [s]", "angle, residual [deg]")
        return figure

    return draw()
