"""What `amulett bench` measured, as tables: for the terminal, and between the marks of ``docs/performance.md``.

Every table is a function of the plain data that ``--json`` writes.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from amulett_gym.reporting.document import Marks, marks
from amulett_gym.reporting.table import Table

SECTIONS = ("speed", "c", "ppo", "time-to-beat", "scale", "peers")

Data = Mapping[str, Any]


def tables(section: str, data: Data) -> list[Table]:
    """Return the tables of one of `SECTIONS`; empty if it was not measured."""
    return _TABLES[section](data)


def section_marks(section: str) -> Marks:
    """Return the lines of a document between which a section is written."""
    return marks("amulett bench" if section == "speed" else f"amulett bench --{section}")


def _speed(data: Data) -> list[Table]:
    if "environments" not in data:
        return []
    rows = [
        [
            name,
            *(f"{row[key]:,.0f}" for key in ("steps_per_s", "slowest", "fastest", "ticks_per_s")),
            "-" if row["ratio"] is None else f"{row['ratio']:.2f}",
        ]
        for name, row in data["environments"].items()
    ]
    note = (
        "Medians of interleaved turns. Ratio: to Pendulum-v1 (single), to CartPole-v1 (vector); 1.3 or less is a tie."
    )
    return [
        Table("Kernel and environments", ("", "agent steps/s", "slowest", "fastest", "ticks/s", "ratio"), rows, note),
    ]


def _c(data: Data) -> list[Table]:
    if "ratio_to_c" not in data:
        return []
    rows = []
    for profile, ratio in data["ratio_to_c"].items():
        least, most = data["ratio_to_c_spread"][profile]
        rows.append(
            [
                profile,
                *(
                    f"{data[key][profile] / 1e6:.2f}"
                    for key in (
                        "kernel_ticks_per_s",
                        "c_ticks_per_s",
                        "c_strict_simd_ticks_per_s",
                        "c_limit_ticks_per_s",
                    )
                ),
                f"{ratio:.2f} ({least:.2f}-{most:.2f})",
            ]
        )
    columns = ("", "kernel", "C, strict scalar", "C, strict SIMD", "C, SIMD, fast math", "kernel to strict scalar C")
    note = "Million ticks a second on one core; medians of interleaved turns; the ratio turn by turn (least-most)."
    return [Table(f"The kernel beside the same tick in C, {data['c_devices']:,} devices", columns, rows, note)]


def _ppo(data: Data) -> list[Table]:
    if "ppo" not in data:
        return []
    ppo = data["ppo"]
    least, most = ppo["ratio_spread"]
    parts = ("rollout", "update")
    ratios = {"env": f"{ppo['ratio']:.3f} ({least:.3f}-{most:.3f})", "null": "1"}
    rows = [
        [label, f"{ppo[name]:,.0f}", *(f"{ppo['step_ms'][name][part]:.2f}" for part in parts), ratios[name]]
        for name, label in (("env", "our environment"), ("null", "null environment"))
    ]
    note = (
        f"The recipe of `amulett train`, {ppo['num_envs']} devices. Rollouts alternate, each with its update; a turn "
        "is as many of each as an episode takes, the ratio turn by turn (least-most). Milliseconds are what a step "
        "of all devices takes on average: in the rollout, and as its share of the update."
    )
    columns = ("", "agent steps/s", *(f"{part} [ms]" for part in parts), "ratio")
    return [Table("PPO of Stable-Baselines3", columns, rows, note)]


def _time_to_beat(data: Data) -> list[Table]:
    if "time_to_beat" not in data:
        return []
    found = data["time_to_beat"]
    lines = found["lines"]["validation"]
    rows = []
    for run in found["runs"]:
        costs = [cost for _, _, cost in run["curve"]]
        rows.append(
            [
                f"seed {run['seed']}",
                f"{costs[0]:.3f}",
                seconds(run["eq6_s"]),
                seconds(run["lower_s"]),
                f"{min(costs):.3f}",
                f"{run['curve'][-1][1]:,}",
            ]
        )
    columns = (
        "",
        "first cost",
        f"below eq. 6 ({lines['eq6']:.3f}) [s]",
        f"below the lower of eq. 6 and {lines['constant_tension']:g} N ({lines['lower']:.3f}) [s]",
        "least cost",
        "agent steps",
    )
    rows.append(["median", "", _median(found["runs"], "eq6_s"), _median(found["runs"], "lower_s"), "", ""])
    note = (
        f"Training time on {found['cores']} cores, without judging and compiling, at most {found['limit_s']:g} s. "
        f"The first policy is a constant {found['initial_tension']:g} N. Costs on {found['episodes']} fixed validation "
        "scenarios; a line counts as crossed if the same policy is below it on as many held-out scenarios, too."
    )
    return [Table("Time to beat", columns, rows, note)]


def _scale(data: Data) -> list[Table]:
    scale = data.get("scale", {})
    made = []
    if "device_step_ns" in scale:
        rows = [
            [f"{int(size):,}", *(f"{row[key]:,.0f}" for key in ("median", "least", "most"))]
            for size, row in scale["device_step_ns"].items()
        ]
        made.append(
            Table(
                "Cost of a device's step [ns], testbed, one core",
                ("", "median", "least", "most"),
                rows,
                "By number of devices in a vector environment: observations, rewards and infos included; "
                "autoreset where turns are longer than episodes, up to about a thousand devices.",
            )
        )
    if "two_threads" in scale:
        rows = [
            [f"{int(size):,}", f"{row['median']:.2f} ({row['least']:.2f}-{row['most']:.2f})"]
            for size, row in scale["two_threads"].items()
        ]
        note = "By number of devices; turn by turn (least-most). Faster where a second core is free."
        made.append(Table("Two threads to one, testbed", ("", "times as fast"), rows, note))
    if "memory_per_device" in scale:
        memory = scale["memory_per_device"]
        rows = [
            ["simulated devices: parameters, scenarios, states", f"{memory['simulation']:,.0f}"],
            ["all arrays of the environment, Gymnasium's spaces included", f"{memory['arrays']:,.0f}"],
            [
                "growth of resident memory, room for what a step returns included",
                "not measured here" if memory["resident"] is None else f"{memory['resident']:,.0f}",
            ],
        ]
        made.append(Table("Memory of a device [bytes]", ("", f"{memory['devices']:,} devices"), rows))
    if "long_run" in scale:
        made.append(_long_run(scale["long_run"]))
    return made


def _long_run(run: Data) -> Table:
    grown = run["resident_growth_bytes_per_device"]
    rows = [
        ["last third's speed to the first third's", f"{run['speed_ratio']:.3f}"],
        ["growth of resident memory, bytes a device", "not measured here" if grown is None else f"{grown:,.0f}"],
        ["devices that failed", f"{run['failures']}"],
        ["the episode after it is bit for bit a new environment's", "yes" if run["last_episode_is_exact"] else "NO"],
        ["error of the clock in one episode as long as all of it [s]", f"{run['lone_clock_error_s']:.1e}"],
        ["change of the joint angle in its second half [deg]", f"{run['lone_angle_change_deg']:.1e}"],
        ["change of the string tensions in its second half [N]", f"{run['lone_tension_change_n']:.1e}"],
    ]
    title = f"{run['simulated_s'] / 60:.0f} minutes of simulated time, {run['devices']:,} devices"
    return Table(title, ("", ""), rows)


def _peers(data: Data) -> list[Table]:
    if "peers" not in data:
        return []
    found: dict[str, Data] = data["peers"]
    ours = [name for name, row in found.items() if row.get("ours")]
    rows = []
    for name, row in found.items():
        if "skipped" in row:
            continue
        cells = [f"{row['steps_per_s']:,.0f}", f"{row['ticks_per_s']:,.0f}"]
        for key in ("ratio_steps", "ratio_ticks"):
            cells += [_spread(row[key][own]) if key in row else "-" for own in ours]
        rows.append([name, *cells])
    profiles = [name.removeprefix("single, ") for name in ours]
    columns = (
        "",
        "agent steps/s",
        "inner ticks/s",
        *(f"{what}: {profile} to it" for what in ("steps", "ticks") for profile in profiles),
    )
    note = (
        "Medians of interleaved turns; ratios turn by turn (least-most): how many times as fast ours is. A step is an "
        "agent's, a tick the physics'."
    )
    skipped = [f"Skipped: {name}: {row['skipped']}." for name, row in found.items() if "skipped" in row]
    return [Table("Peers, one environment on one core each", columns, rows, "\n".join([note, *skipped]))]


def seconds(value: float | None) -> str:
    """Return a training time, or that it was not enough."""
    return "not reached" if value is None else f"{value:.1f}"


def _median(runs: Sequence[Data], key: str) -> str:
    """Return the median of the times, of which those that were not reached are the longest."""
    median = statistics.median_high([float("inf") if run[key] is None else run[key] for run in runs])
    return seconds(None if median == float("inf") else median)


def _spread(ratio: Data) -> str:
    return f"{ratio['median']:.1f} ({ratio['least']:.1f}-{ratio['most']:.1f})"


_TABLES = dict(zip(SECTIONS, (_speed, _c, _ppo, _time_to_beat, _scale, _peers), strict=True))
