"""The tables of `amulett bench`, for the terminal or for ``docs/performance.md``.

Every table is a function of the plain data that ``--json`` writes.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from amulett_gym.reporting.document import Marks, marks
from amulett_gym.reporting.table import Table

SECTIONS = ("speed", "loops", "worn", "c", "ppo", "time-to-beat", "scale", "peers")

Data = Mapping[str, Any]


def tables(section: str, data: Data) -> list[Table]:
    """Return the tables of one of `SECTIONS`; empty if it was not measured."""
    key, make = _TABLES[section]
    return make(data) if key in data else []


def section_marks(section: str) -> Marks:
    """Return the lines of a document between which a section is written."""
    return marks("amulett bench" if section == "speed" else f"amulett bench --{section}")


def _speed(data: Data) -> list[Table]:
    keys = ("steps_per_s", "slowest", "fastest", "ticks_per_s")
    rows = [
        [name, *(f"{row[key]:,.0f}" for key in keys), "-" if row["ratio"] is None else f"{row['ratio']:.2f}"]
        for name, row in data["environments"].items()
    ]
    head = ("", "agent steps/s", "slowest", "fastest", "ticks/s", "ratio")
    note = (
        "Medians of alternating turns. Ratio: single environments to Pendulum-v1, vector environments to CartPole-v1; "
        "between 1/1.3 and 1.3 counts as equal."
    )
    return [Table("Kernel and environments", head, rows, note)]


def _loops(data: Data) -> list[Table]:
    rows = [
        [f"`{control}`", f"{row['ticks_per_s'] / 1e6:.2f}", _spread(**row["ratio"], digits=2)]
        for control, row in data["loops"].items()
    ]
    note = "One core: medians of alternating turns. Ratio per turn to `decentralized`: median (minimum-maximum)."
    title = f"Control loops, kernel of {data['loops_devices']:,}, testbed"
    return [Table(title, ("loop", "million ticks/s", "speed / that of the paper's loop"), rows, note)]


def _worn(data: Data) -> list[Table]:
    rows = [
        [
            f"`{control}`",
            f"{row['bare_ticks_per_s'] / 1e6:.2f}",
            f"{row['worn_ticks_per_s'] / 1e6:.2f}",
            _spread(**row["worn_tick_over_bare"], digits=2),
        ]
        for control, row in data["worn"].items()
    ]
    note = (
        "One core: medians of alternating turns, with the same devices and scenarios. Ratio of the times per turn: "
        "median (minimum-maximum)."
    )
    title = f"The worn tick compared with the bare one, kernel of {data['worn_devices']:,}, worn, reaches"
    return [Table(title, ("loop", "bare [million ticks/s]", "worn", "worn tick / bare tick"), rows, note)]


def _c(data: Data) -> list[Table]:
    columns = {
        "kernel": "kernel_ticks_per_s",
        "C, strict scalar": "c_ticks_per_s",
        "C, strict SIMD": "c_strict_simd_ticks_per_s",
        "C, SIMD, fast math": "c_limit_ticks_per_s",
    }
    spreads: Mapping[str, tuple[float, float]] = data["ratio_to_c_spread"]
    rows = [
        [
            profile,
            *(f"{data[key][profile] / 1e6:.2f}" for key in columns.values()),
            _spread(ratio, *spreads[profile], digits=2),
        ]
        for profile, ratio in data["ratio_to_c"].items()
    ]
    note = "Million ticks a second on one core: medians of alternating turns. Ratio per turn: median (minimum-maximum)."
    title = f"The kernel compared with the same tick in C, {data['c_devices']:,} devices"
    return [Table(title, ("", *columns, "ratio kernel / C, strict scalar"), rows, note)]


def _ppo(data: Data) -> list[Table]:
    ppo, parts = data["ppo"], ("rollout", "update")
    least, most = ppo["ratio_spread"]
    ratios = {"env": _spread(ppo["ratio"], least, most, digits=3), "null": "1"}
    rows = [
        [label, f"{ppo[name]:,.0f}", *(f"{ppo['step_ms'][name][part]:.2f}" for part in parts), ratios[name]]
        for name, label in (("env", "simulated environment"), ("null", "null environment"))
    ]
    note = (
        f"The recipe of `amulett train`, {ppo['num_envs']} devices. The two environments run alternately. One "
        "turn is enough rollouts, each followed by its update, to cover one episode. Ratio per turn, simulated to null "
        "environment: median (minimum-maximum). Times are averages per step of all devices: rollout time per step, and "
        "update time divided by the steps of a rollout."
    )
    head = ("", "agent steps/s", *(f"{part} [ms]" for part in parts), "ratio")
    return [Table("PPO of Stable-Baselines3", head, rows, note)]


def _time_to_beat(data: Data) -> list[Table]:
    found, rows = data["time_to_beat"], []
    lines, keys = found["lines"]["validation"], ("eq6_s", "lower_s")
    for run in found["runs"]:
        costs = [cost for _, _, cost in run["curve"]]
        times = (seconds(run[key]) for key in keys)
        rows.append([f"seed {run['seed']}", f"{costs[0]:.3f}", *times, f"{min(costs):.3f}", f"{run['curve'][-1][1]:,}"])
    rows.append(["median", "", *(_median(found["runs"], key) for key in keys), "", ""])
    lower = f"below eq. 6 and {lines['constant_tension']:g} N ({lines['lower']:.3f}) [s]"
    head = ("", "first cost", f"below eq. 6 ({lines['eq6']:.3f}) [s]", lower, "lowest cost", "agent steps")
    note = (
        f"Training time on {found['cores']} cores, without evaluation and compilation; in parentheses the cost to "
        f"beat. The first policy is a constant {found['initial_tension']:g} N. Costs on {found['episodes']} fixed "
        "validation scenarios. A law counts as beaten only if the same policy also beats it on as many held-out "
        "scenarios; so a seed may have a lower cost on validation and not have beaten it. A training ends when its "
        f"policy has beaten eq. 6 and the best constant; otherwise after "
        f"{found['recipe']['total_steps']:,} agent steps, rounded up to whole rollouts, or after {found['limit_s']:g} "
        "s. Agent steps: those until the end. A seed that does not reach a goal counts as the slowest in the median."
    )
    return [Table("Time to beat", head, rows, note)]


def _scale(data: Data) -> list[Table]:
    scale, made = data["scale"], []
    if "device_step_ns" in scale:
        keys = ("median", "least", "most")
        costs = scale["device_step_ns"].items()
        rows = [[f"{int(size):,}", *(f"{row[key]:,.0f}" for key in keys)] for size, row in costs]
        note = (
            "Rows: number of devices in one vector environment. The time includes observations, rewards and infos, and "
            "automatic resets only up to about 1,000 devices; with more, a measurement ends before the first episode "
            "ends."
        )
        head = ("devices", "median", "minimum", "maximum")
        made.append(Table("Time per step and device [ns], testbed, one core", head, rows, note))
    if "two_threads" in scale:
        rows = [
            [f"{int(size):,}", *(_spread(**row[key], digits=2) for key in ("threads", "cores"))]
            for size, row in scale["two_threads"].items()
        ]
        note = (
            "Ratio of the speeds per turn: median (minimum-maximum). The threads of the kernel hardly wait for each "
            "other: their speed-up shows how free the second core was."
        )
        columns = ("devices", "environment", "kernel alone")
        made.append(Table("Two threads compared with one, testbed", columns, rows, note))
    if "memory_per_device" in scale:
        memory = scale["memory_per_device"]
        rows = [
            ["simulated devices: parameters, scenarios, states", _bytes(memory["simulation"])],
            ["all arrays of the environment, Gymnasium's spaces included", _bytes(memory["arrays"])],
            [
                "growth of the process's resident memory, with the arrays that a step returns",
                _bytes(memory["resident"]),
            ],
        ]
        note = "Resident memory grows by less than the arrays where the process reuses memory that it had freed before."
        made.append(Table("Memory per device [bytes]", ("", f"{memory['devices']:,} devices"), rows, note))
    if "long_run" in scale:
        made.append(_long_run(scale["long_run"]))
    return made


def _long_run(run: Data) -> Table:
    rows = [
        ["speed in the last third divided by that in the first third", f"{run['speed_ratio']:.3f}"],
        ["growth of resident memory [bytes per device]", _bytes(run["resident_growth_bytes_per_device"])],
        ["devices that failed", f"{run['failures']}"],
        [
            "the last episode is bit-identical to that of a new environment",
            "yes" if run["last_episode_is_exact"] else "NO",
        ],
        ["one episode of the whole time: error of the clock [s]", f"{run['lone_clock_error_s']:.1e}"],
        [
            "one episode of the whole time: change of the joint angle in the second half [deg]",
            f"{run['lone_angle_change_deg']:.1e}",
        ],
        [
            "one episode of the whole time: change of the string tensions in the second half [N]",
            f"{run['lone_tension_change_n']:.1e}",
        ],
    ]
    title = f"{run['simulated_s'] / 60:.0f} minutes of simulated time, {run['devices']:,} devices"
    return Table(title, ("", ""), rows)


def _peers(data: Data) -> list[Table]:
    found: dict[str, Data] = data["peers"]
    ours = [name for name, row in found.items() if row.get("ours")]
    rows, skipped = [], []
    for name, row in found.items():
        if "skipped" in row:
            skipped.append(f"Skipped: {name}: {row['skipped']}.")
            continue
        ratios = [row[key] for key in ("ratio_steps", "ratio_ticks") if key in row]
        cells = [_spread(**ratio[own], digits=1) for ratio in ratios for own in ours] or ["-"] * 2 * len(ours)
        rows.append([name, f"{row['steps_per_s']:,.0f}", f"{row['ticks_per_s']:,.0f}", *cells])
    profiles = [name.removeprefix("single, ") for name in ours]
    columns = (f"{what}: {profile} / row" for what in ("steps", "ticks") for profile in profiles)
    note = (
        "Medians of alternating turns. Ratios of speeds per turn, this environment's profile to the row's environment: "
        "median (minimum-maximum). A step is one action of the agent, a tick one step of the physics."
    )
    head = ("", "agent steps/s", "inner ticks/s", *columns)
    return [Table("Other packages, one environment on one core each", head, rows, "\n".join([note, *skipped]))]


def seconds(value: float | None) -> str:
    """Return a training time, or ``"not reached"``."""
    return "not reached" if value is None else f"{value:.1f}"


def _median(runs: Sequence[Data], key: str) -> str:
    """Return the median of the times, of which those that were not reached are the longest."""
    median = statistics.median([float("inf") if run[key] is None else run[key] for run in runs])
    return seconds(None if median == float("inf") else median)


def _spread(median: float, least: float, most: float, *, digits: int) -> str:
    return f"{median:.{digits}f} ({least:.{digits}f}-{most:.{digits}f})"


def _bytes(value: float | None) -> str:
    return "not measured here" if value is None else f"{value:,.0f}"


_TABLES = {
    "speed": ("environments", _speed),
    "loops": ("loops", _loops),
    "worn": ("worn", _worn),
    "c": ("ratio_to_c", _c),
    "ppo": ("ppo", _ppo),
    "time-to-beat": ("time_to_beat", _time_to_beat),
    "scale": ("scale", _scale),
    "peers": ("peers", _peers),
}
