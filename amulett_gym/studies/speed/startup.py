"""Measure the start-up time of help, import, first step, each in fresh processes.

::

    python -m amulett_gym.studies.speed.startup
    python -m amulett_gym.studies.speed.startup --turns 9 --cold-turns 3 --json startup.json

The time of the whole process counts, with Python's own start. Processes take turns, so that a busy machine slows all
alike: see the ratios. A cold first step compiles everything into an empty cache folder; a warm one uses that cache.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from amulett_gym.storage.writing import write_json
from amulett_gym.studies.speed.command import command

TURNS = 7
COLD_TURNS = 3

PYTHON, GYMNASIUM, COLD = "python -c pass", "import gymnasium", "first step, cold"

_FIRST_STEP = (
    "import gymnasium, amulett_gym; env = gymnasium.make('Amulett/Scaling-v0'); env.reset(seed=0); "
    "env.step(env.action_space.low)"
)

COMMANDS: dict[str, tuple[str, ...]] = {
    PYTHON: ("-c", "pass"),
    GYMNASIUM: ("-c", "import gymnasium"),
    "import amulett_gym": ("-c", "import amulett_gym"),
    "amulett --help": ("-m", "amulett_gym", "--help"),
    "first step, warm": ("-c", _FIRST_STEP),
    COLD: ("-c", _FIRST_STEP),
}

LIMITS = {"import amulett_gym": 0.6, "amulett --help": 0.3, "first step, warm": 1.0, COLD: 12.0}
"""Upper limit of each [s]."""


def measure(turns: int, cold_turns: int) -> dict[str, list[float]]:
    """Return the time of each process of each of `COMMANDS` [s].

    Parameters
    ----------
    turns, cold_turns : int
        Processes of each command; of the cold first step.

    Raises
    ------
    subprocess.CalledProcessError
        If a command fails.
    """
    seconds: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory(prefix="amulett-startup-") as folder:
        for turn in range(cold_turns):
            seconds[COLD].append(_seconds(COMMANDS[COLD], Path(folder) / f"cold-{turn}"))
        others = [name for name in COMMANDS if name != COLD]
        for turn in range(turns + 1):
            for name in others:
                passed = _seconds(COMMANDS[name], Path(folder) / "cold-0")
                if turn > 0:  # in the first, Python compiles its files and the system reads them
                    seconds[name].append(passed)
    return seconds


def table(seconds: dict[str, list[float]]) -> str:
    """Return the medians, their spread and their ratios to Python's and Gymnasium's as text."""
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    lines = [f"{'median of fresh processes':26}{'s':>7}  {'least-most':13}{'x python':>9}{'x gymnasium':>12}  limit"]
    for name, median in medians.items():
        spread = f"{min(seconds[name]):.2f}-{max(seconds[name]):.2f}"
        ratios = f"{median / medians[PYTHON]:>9.1f}{median / medians[GYMNASIUM]:>12.2f}"
        limit = f"{LIMITS[name]:g} s" if name in LIMITS else ""
        verdict = "" if median <= LIMITS.get(name, median) else "  MISSED"
        lines.append(f"{name:26}{median:>7.3f}  {spread:13}{ratios}  {limit}{verdict}")
    return "\n".join(lines)


def _seconds(arguments: Sequence[str], cache: Path) -> float:
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], env=variables, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> int:
    """Run the command."""
    parser = command(__doc__, "startup", TURNS)
    parser.add_argument("--cold-turns", type=int, default=COLD_TURNS, help=f"cold first steps (default: {COLD_TURNS})")
    arguments = parser.parse_args()
    if arguments.turns < 1 or arguments.cold_turns < 1:
        parser.error("at least one process of each kind is needed")
    seconds = measure(arguments.turns, arguments.cold_turns)
    print(table(seconds))
    found = {
        name: {"seconds": values, "median_s": statistics.median(values), "limit_s": LIMITS.get(name)}
        for name, values in seconds.items()
    }
    if arguments.json:
        write_json(arguments.json, found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
