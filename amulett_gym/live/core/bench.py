"""Compare the speed of ``amulett.wasm`` in node with that of the same C texts as a library of this computer.

``python -m amulett_gym.live.core.bench`` prints control ticks per second of processor time for each loop, the best of
some rounds.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.errors import AmulettError, ToolMissing
from amulett_gym.live.core import script
from amulett_gym.live.core.build import WASM, objects, read_wasm
from amulett_gym.live.core.data import device_data, scenario_data
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import CONTROLS, LOOPS, Control, pack_loop, pack_parameters
from amulett_gym.tasks.scenario import Move, Scenario, pack

NO_NODE = "there is no node, which runs WebAssembly: apt-get install -y nodejs"

SCENARIO = Scenario(moves=[Move(time=1.0, angle_deg=60.0)], noise_seed=0)
"""The paper's step."""


def measure(profile: Profile, ticks: int = 100_000, rounds: int = 3) -> dict[str, tuple[float, float]]:
    """Return the ticks per second of processor time of each loop of a device: by WebAssembly in node, and natively.

    Raises
    ------
    ToolMissing
        If there is no node or no C compiler.
    """
    if shutil.which("node") is None:
        raise ToolMissing(NO_NODE)
    device = device_data(profile)
    loops: list[Control] = [loop for loop in CONTROLS if loop not in device["unfit"]]
    with tempfile.TemporaryDirectory(prefix="amulett-bench-") as temporary:
        folder = Path(temporary)
        job = {"device": device, "scenario": scenario_data(SCENARIO), "loops": loops, "ticks": ticks, "rounds": rounds}
        native = _native(folder, profile, loops, ticks, rounds)
        browser = _node(folder, json.dumps(job))
    return {loop: (browser[loop], native[loop]) for loop in loops}


def _node(folder: Path, job: str) -> dict[str, float]:
    paths = [folder / name for name in ("scripts.js", WASM, "job.json")]
    for path, content in zip(paths, (script().encode(), read_wasm(), job.encode()), strict=True):
        path.write_bytes(content)
    command = ["node", str(Path(__file__).with_name("bench.js")), *map(str, paths)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise AmulettError(f"node cannot run {WASM}:\n{result.stderr[-2000:]}")
    return dict(json.loads(result.stdout))


def _native(folder: Path, profile: Profile, loops: Sequence[Control], ticks: int, rounds: int) -> dict[str, float]:
    compiler = find_compiler()
    if compiler is None:
        raise ToolMissing(NO_COMPILER)
    paths = objects(folder, [compiler, "-O3", "-fPIC"])
    library_path = folder / "live.so"
    subprocess.run([compiler, "-shared", *paths, "-o", str(library_path), "-lm"], check=True)
    library = ctypes.CDLL(str(library_path))
    for name in ("device_at", "loop_at", "scenario_at"):
        getattr(library, name).restype = ctypes.c_void_p
    rates = dict.fromkeys(loops, 0.0)
    row = pack(SCENARIO, profile).tobytes()
    for _ in range(rounds):
        for loop in loops:
            index = LOOPS.index(loop) if loop in LOOPS else -1
            gains = pack_loop(profile, loop).tobytes() if index >= 0 else b""
            records = {"device_at": pack_parameters(profile, loop, "eq6").tobytes(), "loop_at": gains}
            for name, record in {**records, "scenario_at": row}.items():
                ctypes.memmove(getattr(library, name)(), record, len(record))
            library.choose(index, 0)
            library.begin()
            library.play(ticks // 10)
            begin = time.process_time()
            library.play(ticks)
            rates[loop] = max(rates[loop], ticks / (time.process_time() - begin))
    return {str(loop): rate for loop, rate in rates.items()}


def main() -> None:
    """Print the rates and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="testbed", help="device (default: testbed)")
    parser.add_argument("--ticks", type=int, default=100_000, help="control ticks of a measurement (default: 100000)")
    arguments = parser.parse_args()
    if arguments.ticks < 10:
        parser.error(f"--ticks is {arguments.ticks}; at least 10 are needed")
    found = measure(load_profile(arguments.profile), arguments.ticks)
    print(f"{'loop':24} {'WebAssembly':>12} {'native':>12}  ratio   [ticks/s]")
    for loop, (browser, native) in found.items():
        print(f"{loop:24} {browser:12.0f} {native:12.0f} {browser / native:6.2f}")


if __name__ == "__main__":
    main()
