"""How well `amulett fit` finds hidden devices: fits of simulated logs, their predictions and intervals.

``python -m amulett_gym.studies.fits --devices 20 --workers 2`` prints a table. Devices are those of
``plausible-held-out``, the prior is ``plausible``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from amulett_gym.errors import AmulettError
from amulett_gym.fleet import load_fleet
from amulett_gym.identification.from_logs.fit import fit
from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.physics import physics_of
from amulett_gym.identification.from_logs.recording import Recording
from amulett_gym.logs.simulated import log_of
from amulett_gym.profile import Profile, load_profile
from amulett_gym.reporting.table import Table
from amulett_gym.reporting.words import number
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.trajectory import record
from amulett_gym.tasks.scenario import Scenario, pack, pack_path
from amulett_gym.workers.call import Call, chosen
from amulett_gym.workers.run import results

FITTED, HELD_OUT = 60.0, 15.0
"""Times of a log [s]."""

_EVERY = 1.6  # a step [s]
_TENSIONS = (8.0, 14.0, 6.0, 11.0)  # [N], for as long each, and again


def simulated_log(device: Profile, duration: float, seed: int) -> Recording:
    """Return the log of a device with its noise: steps between -40 and 40 deg at four tensions."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-40.0, 40.0, int(duration / _EVERY)).round(2).tolist()
    moves = [{"time": 0.5 + _EVERY * k, "angle_deg": angle} for k, angle in enumerate(angles)]
    scenario = Scenario.model_validate({"moves": moves, "noise_seed": seed})
    simulation, path = Simulation(device), pack_path(scenario)
    simulation.reset(pack(scenario, device), paths=[path] if path.size else None)
    period = device.loop.control_period

    def act(tick: int) -> None:
        simulation.command_tension(_TENSIONS[int(tick * period / 5.0) % len(_TENSIONS)])

    moved = record(simulation, round(duration / period), before_tick=act)
    return Recording(f"{device.name}.csv", log_of(moved).columns)


def find_device(name: str, seed: int, tried: int) -> dict[str, Any]:
    """Return how well the device of ``plausible-held-out`` with this name is found from its log."""
    device = next(each for each in load_fleet("plausible-held-out") if each.name == name)
    log = simulated_log(device, FITTED + HELD_OUT, seed)
    columns = dict(log.columns)
    begin = time.perf_counter()
    found = fit(load_profile("testbed"), [Recording(log.name, columns, end=FITTED)], load_fleet("plausible"), tried)
    seconds = time.perf_counter() - begin
    held, truth = [Recording(log.name, columns, begin=FITTED)], physics_of(device)
    errors = []
    for template, values in ((found.model.template, found.values), (device, truth)):
        model = Model(template, held, whole=True)
        apart = model.predict([values], device.sensors.potentiometer_noise)[0] - model.measured
        errors.append(float(np.degrees(np.sqrt(np.mean(apart[model.channel_of() == 0] ** 2)))))
    inside = {
        each.seen.name: each.low <= truth.get(each.seen.name, 0.0) <= each.high
        for each in found.estimates
        if each.determined and not each.seen.nuisance
    }
    return {
        "seconds": seconds,
        "starts": len(found.starts),
        "error": errors[0],
        "best_error": errors[1],
        "inside": inside,
        "values": found.values,
        "truth": truth,
    }


def tables(found: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    """Return the table of devices, and that of parameters."""
    rows = [
        (
            name,
            number(each["error"]),
            number(each["best_error"]),
            number(each["error"] / each["best_error"]),
            f"{sum(each['inside'].values())} of {len(each['inside'])}",
            str(each["starts"]),
            number(each["seconds"]),
        )
        for name, each in found.items()
    ]
    head = ("device", "error [deg]", "least [deg]", "ratio", "inside", "starts", "time [s]")
    note = (
        "Error: rms of the angle's prediction over the held-out time; least: by the hidden device without noise. "
        "Inside: determined parameters whose 90 % interval contains the truth."
    )
    names = dict.fromkeys(name for each in found.values() for name in each["inside"])
    counts = {name: [each["inside"][name] for each in found.values() if name in each["inside"]] for name in names}
    covered = [(name, f"{sum(each)} of {len(each)}") for name, each in counts.items()]
    return [
        Table("Hidden devices", head, rows, note),
        Table("Intervals", ("parameter", "contains the truth, where determined"), covered),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and print its tables; return 2 after an error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=20, metavar="N", help="hidden devices (default: 20)")
    parser.add_argument("--starts", type=int, default=6, metavar="N", help="most starts of a search (default: 6)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the first log (default: 0)")
    number = "fits at a time (default: 1); --processes is its earlier name"
    parser.add_argument("--workers", "--processes", type=int, metavar="N", help=number)
    parser.add_argument("--ray", metavar="ADDRESS", help="fit on a Ray cluster (docs/scale.md)")
    arguments = parser.parse_args(argv)
    try:
        _run(arguments)
    except AmulettError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _run(arguments: argparse.Namespace) -> None:
    workers = chosen(arguments.workers, arguments.ray)
    devices = load_fleet("plausible-held-out")[: arguments.devices]
    calls = {
        each.name: Call(find_device, (each.name, arguments.seed + k, arguments.starts))
        for k, each in enumerate(devices)
    }
    found = {}
    with closing(results(calls, workers)) as finished:
        for name, result in finished:
            found[name] = result
            ratio = result["error"] / result["best_error"]
            print(f"{name}: ratio {ratio:.3f}, inside {result['inside']}, {result['seconds']:.0f} s", flush=True)
    print("\n\n".join(each.text() for each in tables({each.name: found[each.name] for each in devices})))


if __name__ == "__main__":
    sys.exit(main())
