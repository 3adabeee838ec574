"""Figures: every axis has its unit, files appear whole, and matplotlib's state stays as it was."""

import re
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from amulett_gym.errors import AmulettError
from amulett_gym.evaluation import motion_plots, plots
from amulett_gym.evaluation.comparison import summarise
from amulett_gym.evaluation.episode import record_episode
from amulett_gym.evaluation.runner import Protocol, evaluate, labels
from amulett_gym.reporting import style

POLICIES = ["eq6", "constant:10", "eq6-held", "position-only"]


@pytest.fixture(scope="module")
def results():
    return evaluate(POLICIES, episodes=3)


@pytest.fixture(scope="module")
def trajectories(results):
    return {name: record_episode(name, results.protocol).trajectory for name in POLICIES}


@pytest.fixture(scope="module")
def figures(results, trajectories):
    profile = results.protocol.profile
    pushed = record_episode("eq6", Protocol(profile, suite="hold-push")).trajectory
    summary = summarise(results)
    return {
        "trajectory": motion_plots.trajectory_figure(trajectories["eq6"], "eq. 6"),
        "pushed": motion_plots.trajectory_figure(pushed),
        "together": motion_plots.overlay_figure(trajectories, "steps"),
        "responses": motion_plots.step_response_figure(trajectories),
        "schedule": plots.schedule_figure(results.schedules, profile.variable_stiffness),
        "no schedule": plots.schedule_figure({}, profile.variable_stiffness),
        "cost": plots.cost_figure(summary),
        "trade-off": plots.trade_off_figure(summary),
    }


def test_every_labelled_axis_has_its_unit(figures):
    for name, figure in figures.items():
        texts = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
        assert len(texts) >= (1 if name == "cost" else 2), name
        for text in texts:
            assert re.search(r"\[.+\]|deg² s$|deg²/s$", text), f"{name}: {text}"


def test_a_push_gets_a_panel_of_its_own(figures):
    assert len(figures["pushed"].axes) == len(figures["trajectory"].axes) + 1
    assert figures["pushed"].axes[-1].get_ylabel() == "torque [N m]"


def test_the_trajectory_shows_truth_and_estimate(figures):
    angle, tension, stiffness, command = figures["trajectory"].axes
    assert {"setpoint", "joint angle"} <= {line.get_label() for line in angle.lines}
    assert {line.get_label() for line in tension.lines} == {
        "biceps, true",
        "biceps, estimated",
        "triceps, true",
        "triceps, estimated",
        "antagonist's setpoint",
    }
    assert {line.get_label() for line in command.lines} == {"biceps", "triceps"}
    assert stiffness.get_ylabel() == "joint stiffness\n[N m/rad]"


def test_every_contenders_joint_stiffness_is_drawn(trajectories, figures):
    drawn = [line.get_ydata() for panel in figures["responses"].axes for line in panel.lines]
    for path in trajectories.values():
        assert any(np.array_equal(values, path["joint_stiffness"]) for values in drawn)


def test_several_laws_share_the_panels(trajectories, figures):
    panels = figures["together"].axes
    assert [panel.get_ylabel().split("\n")[0] for panel in panels] == [
        "joint angle [deg]",
        "antagonist's",
        "joint stiffness",
    ]
    for panel in panels:
        assert {line.get_label() for line in panel.lines} >= set(trajectories)
    angle, tension, stiffness = panels
    for name, path in trajectories.items():
        for panel, expected in (
            (angle, np.degrees(path["angle"])),
            (tension, np.where(path["agonist"] > 0, path["force_triceps"], path["force_biceps"])),
            (stiffness, path["joint_stiffness"]),
        ):
            (line,) = [line for line in panel.lines if line.get_label() == name]
            np.testing.assert_array_equal(line.get_ydata(), expected)


def test_the_schedule_shows_only_tensions_that_change_over_both_readings_of_eq6(figures):
    panels = [axes for axes in figures["schedule"].axes if axes.get_title()]
    assert [axes.get_title() for axes in panels] == ["eq6-held"]
    curves = [line.get_ydata() for line in panels[0].lines if len(line.get_ydata()) == 200]
    assert [(curve[0], curve[-1]) for curve in curves] == [(10.0, 4.0), (4.0, 10.0)]


def test_bars_end_at_the_mean_cost(figures, results):
    panel = figures["cost"].axes[0]
    ends = {}
    for bar in panel.patches:
        row = round(bar.get_y() + bar.get_height() / 2)
        ends[row] = max(ends.get(row, 0.0), bar.get_x() + bar.get_width())
    means = [summarise(results)["policies"][name]["cost"]["mean"] for name in POLICIES]
    assert [ends[row] for row in (3, 2, 1, 0)] == pytest.approx(means)


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_figure_is_written_whole_and_twice_the_same(figures, tmp_path, suffix):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    style.save_figure(figures["cost"], first)
    style.save_figure(figures["cost"], second)
    assert first.read_bytes() == second.read_bytes()
    if suffix == ".png":
        assert Image.open(first).width > 1000
    assert {path.name for path in tmp_path.iterdir()} == {first.name, second.name}


def test_another_suffix_is_refused(figures, tmp_path):
    with pytest.raises(AmulettError, match=r"\.png, \.svg, \.pdf"):
        style.save_figure(figures["cost"], tmp_path / "figure.jpg")
    assert not list(tmp_path.iterdir())


def test_an_inline_figure_is_one_element_with_ids_of_its_own(figures):
    svg = style.figure_svg(figures["cost"], "mine")
    assert svg.startswith("<svg") and svg.rstrip().endswith("</svg>")
    assert all(name.startswith("mine-") for name in re.findall(r'\bid="([^"]+)"', svg))
    assert all(name.startswith("mine-") for name in re.findall(r'(?:href="|url\()#([^")]+)', svg))


def test_settings_of_matplotlib_stay_as_they_were(results):
    before = dict(mpl.rcParams)
    plots.cost_figure(summarise(results))
    assert dict(mpl.rcParams) == before


def test_no_global_pyplot_state():
    script = "import sys, amulett_gym.evaluation.page; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_labels_are_short_and_unambiguous():
    names = ["eq6", "constant:5", "runs/a/best", "runs/b", "old/b", "."]
    assert labels(names) == {
        "eq6": "eq6",
        "constant:5": "constant:5",
        "runs/a/best": "a",
        "runs/b": "runs/b",
        "old/b": "old/b",
        ".": ".",
    }


def test_learned_policies_have_colours_that_no_law_has():
    laws = [
        "eq6",
        "eq6-printed",
        "eq6-held",
        "eq6-held-printed",
        "position-only",
        *(f"constant:{n}" for n in range(5, 9)),
    ]
    colours = plots.colours(["runs/a", *laws, "runs/b"])
    assert len({colours[name] for name in laws}) == len(laws)
    assert not {colours["runs/a"], colours["runs/b"]} & {colours[name] for name in laws}
    assert colours["runs/a"] == plots.colours(["runs/a"])["runs/a"]
    assert plots.colours(["pretrained", "mine.py:law"])["pretrained"] == colours["runs/a"]  # the function is no policy


def test_a_string_has_the_renderers_colour():
    from amulett_gym.envs.rendering import canvas

    for ours, theirs in (
        (style.BICEPS, canvas.BICEPS),
        (style.TRICEPS, canvas.TRICEPS),
        (style.SETPOINT, canvas.SETPOINT),
        (style.JOINT, canvas.INK),
    ):
        assert mpl.colors.to_rgb(ours) == pytest.approx([value / 255 for value in theirs])


def test_a_median_needs_points():
    error = np.concatenate([np.full(5000, 0.2), np.full(40, 8.0)])
    centres, medians = plots._medians(error, np.full(error.size, 6.0))
    assert centres[~np.isnan(centres)].tolist() == [0.2]
    assert medians[~np.isnan(medians)].tolist() == [6.0]


def test_eq6_is_black_and_neighbours_differ():
    colours = plots.colours(POLICIES)
    assert colours["eq6"] == style.BLACK
    assert len({colours[name] for name in POLICIES}) == len(POLICIES)


def test_laws_in_another_loop_are_coloured_as_laws():
    laws, learned = ["co-rotation/constant:10", "cascade/eq6"], ["cascade/pretrained", "cascade/runs/mine"]
    found = plots.colours([*laws, *learned])
    assert {found[name] for name in laws}.isdisjoint(plots._LEARNED_COLOURS)
    assert {found[name] for name in learned} <= set(plots._LEARNED_COLOURS)


def test_all_panels_of_ratios_have_the_same_labels():
    estimate = {"mean": 0.8, "low": 0.7, "high": 0.9}
    rows = {f"row {k}": {"a": estimate, "b": estimate} for k in range(5)}
    figure = plots.ratios_figure(rows, {"a": "A", "b": "B"}, {"a": "red", "b": "blue"}, "ratio [1]")
    for which in ("major", "minor"):
        shown = {panel.xaxis.get_tick_params(which=which).get("labelbottom", True) for panel in figure.axes}
        assert shown == {True}
