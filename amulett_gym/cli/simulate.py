"""`amulett simulate`: one episode with each law, recorded at control rate."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import (
    add_device,
    add_figures,
    add_json,
    add_options,
    check_file,
    check_seconds,
    chosen_device,
)
from amulett_gym.cli.output import print_json, printer
from amulett_gym.cli.own_policies import POLICIES, digests, own_contenders
from amulett_gym.errors import AmulettError
from amulett_gym.reporting.figure_files import KINDS

if TYPE_CHECKING:
    from amulett_gym.evaluation.episode import Episode

HELP = "record one episode with one or more laws or policies: CSV, figure, metrics"
EXAMPLES = """  amulett simulate --law eq6 --suite paper-step --profile simulation --out step.csv --plot step.png
  amulett simulate --law eq6 constant:6 pretrained --plot three.png
  amulett simulate --law constant:10 --suite hold-push --seed 3 --plot pushes.svg
  amulett simulate --law constant:8 --duration 60 --log steps.csv
  amulett simulate --law mylaw.py:softer --scenario my_scenario.json --duration 5 --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    laws = f"{POLICIES}; all get the same scenario (default: eq6)"
    parser.add_argument("--law", nargs="+", default=["eq6"], metavar="LAW", help=laws)
    add_options(parser, "--trust-pickle", "--suite", "--split", "--scenario")
    add_device(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of the scenario and the sensor noise (default: 0)")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="simulated time [s] (default: 10)")
    rows = "trajectory, one row per control tick; those of several laws follow each other, with a column 'law'"
    parser.add_argument("--out", metavar="FILE.csv", help=rows)
    log = "what the device would log: setpoints, sensor readings, commands (see docs/logs.md); of one law"
    parser.add_argument("--log", metavar="FILE", help=f"{log}; .csv or .npz")
    parser.add_argument("--plot", metavar="FILE.png", help="figure (.png, .svg or .pdf); several laws share its panels")
    add_figures(parser, kind=False, into=("plot",))
    add_json(parser, "metrics, units and scenario")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print the metrics, and write the files."""
    check_seconds(arguments, "duration")
    files = (("out", (".csv",)), ("log", (".csv", ".npz")), ("plot", tuple(f".{kind}" for kind in KINDS)))
    if arguments.log is not None and len(set(arguments.law)) > 1:
        raise AmulettError(f"--log is for one law; --law names {len(set(arguments.law))}")
    for option, suffixes in files:
        check_file(option, getattr(arguments, option), suffixes)

    from amulett_gym.evaluation.episode import record_episode
    from amulett_gym.evaluation.remarks import device_remarks, loop_remarks, print_remarks
    from amulett_gym.evaluation.runner import Protocol, labels, training_remarks
    from amulett_gym.laws.contenders import loops_of
    from amulett_gym.logs.simulated import log_of
    from amulett_gym.logs.writer import write_log
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.simulation.trajectory import write_csv

    profile = chosen_device(arguments)
    protocol = Protocol(
        profile, arguments.suite, arguments.split, episodes=1, seed=arguments.seed, duration=arguments.duration
    )
    names = list(dict.fromkeys(arguments.law))
    contenders = own_contenders(names, profile, protocol.env_id, arguments.trust_pickle)
    remarks = device_remarks(profile, names, loops=loops_of(contenders), suite=arguments.suite)
    remarks += [*training_remarks(contenders, protocol, task=False), *loop_remarks(contenders)]
    print_remarks(remarks)
    with Progress(math.ceil(arguments.duration) * len(contenders), "simulate", "s") as bar:
        played = [record_episode(each, protocol, arguments.scenario, bar.update) for each in contenders]
    label = labels(names)
    episodes = {label[name]: episode for name, episode in zip(names, played, strict=True)}
    trajectories = {name: episode.trajectory for name, episode in episodes.items()}
    if arguments.out is not None:
        write_csv(trajectories if len(trajectories) > 1 else played[0].trajectory, arguments.out)
    if arguments.log is not None:
        write_log(arguments.log, log_of(played[0].trajectory))
    scenario = f"suite {arguments.suite}" if arguments.scenario is None else f"scenario {arguments.scenario}"
    task = f"profile {profile.name}, {scenario}"
    title = f"{', '.join(episodes)}, {task}"
    if arguments.json:
        print_json(_content(arguments, names, played, remarks))
    else:
        _print(arguments, episodes, title)
    if arguments.plot is not None:  # last: an error in a figure loses no number
        from amulett_gym.evaluation.motion_plots import overlay_figure, trajectory_figure
        from amulett_gym.reporting.style import save_figure

        if len(trajectories) > 1:
            figure = overlay_figure(dict(zip(names, trajectories.values(), strict=True)), task)
        else:
            figure = trajectory_figure(played[0].trajectory, title)
        save_figure(figure, arguments.plot)
        printer(arguments)(f"Written: {arguments.plot}")
    return 0


def _content(
    arguments: argparse.Namespace, names: list[str], played: list[Episode], remarks: list[str]
) -> dict[str, Any]:
    """Return what --json prints: one law's name and metrics at the top level; several laws' under ``laws``."""
    from amulett_gym.evaluation.metrics import UNITS

    results = [{"failure": episode.failure, "metrics": episode.metrics} for episode in played]
    found: dict[str, Any] = {"law": names[0], **results[0]}
    if len(names) > 1:
        found = {"laws": dict(zip(names, results, strict=True))}
    return {
        **found,
        "sha256": digests(names),
        "profile": played[0].trajectory.profile,
        **{key: getattr(arguments, key) for key in ("suite", "split", "seed", "duration")},
        "units": {name: UNITS[name] for name in played[0].metrics},
        "remarks": remarks,
        "scenario": played[0].scenario.model_dump(),
    }


def _print(arguments: argparse.Namespace, episodes: Mapping[str, Episode], title: str) -> None:
    """Print metrics, failures, and the trajectories' file."""
    from amulett_gym.evaluation.metrics import UNITS
    from amulett_gym.reporting.table import Table

    show = printer(arguments)
    show(f"{title}, seed {arguments.seed}, {arguments.duration:g} s")
    metrics = [episode.metrics for episode in episodes.values()]
    rows = [
        (name, *(f"{each[name]:.4g}" if math.isfinite(each[name]) else "-" for each in metrics), unit.replace("1", ""))
        for name, unit in UNITS.items()
        if name in metrics[0]
    ]
    head = ("metric", *episodes, "unit") if len(episodes) > 1 else ("",) * 3
    show(Table("", head, rows, left=(0, len(head) - 1)).text())
    for name, episode in episodes.items():
        if episode.failure:
            ended = f"after {episode.trajectory['time'][-1]:g} s: {episode.failure}"
            show(f"The device failed {ended}." if len(episodes) == 1 else f"{name}: the device failed {ended}.")
    for path in (arguments.out, arguments.log):
        if path is not None:
            show(f"Written: {path}")
