"""`amulett rerun`: check whether a command gives the same numbers again."""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import io
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.cli.options import add_json, add_options
from amulett_gym.cli.output import print_json, printer
from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from amulett_gym.storage.provenance import Provenance

HELP = "repeat the command that wrote a folder, into a new one, and compare the numbers"
EXAMPLES = """  amulett rerun comparison --out comparison-again
  amulett rerun runs/first --out runs/first-again
  amulett rerun runs/first --out runs/first-again --json
"""

Numbers = dict[str, Any]

_NOT_NUMBERS = ("command", "machine", "versions", "seconds", "sha256", "status")
"""Keys, at any depth, that are not compared."""

_SCENARIO = ("policy", "device", "scenario")
"""Columns that name a row of a comparison's ``scenarios.csv``; without a fleet there is no device."""

_MOST_SHOWN = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("folder", metavar="DIR", help=f"folder that a command wrote ({', '.join(_KINDS)})")
    parser.add_argument("--out", required=True, metavar="NEW", help="folder for the repetition")
    add_options(parser, "--trust-pickle")
    trust = "also run the Python files whose functions were compared (mylaw.py:function)"
    parser.add_argument("--trust-python", action="store_true", help=trust)
    parser.add_argument("--trust-c", action="store_true", help="also compile and run the C sources of a firmware")
    add_json(parser, "what differs")


def run(arguments: argparse.Namespace) -> int:
    """Repeat the command; return 1 if a number differs."""
    from amulett_gym.laws.contenders import python_file
    from amulett_gym.storage.provenance import differences, read_provenance, software_changes
    from amulett_gym.storage.reading import visible

    old, new = Path(arguments.folder).resolve(), Path(arguments.out).resolve()
    if old == new or old in new.parents or new in old.parents:
        raise AmulettError(f"--out '{arguments.out}' has to be another folder than '{arguments.folder}', and not in it")
    if new.exists() and (not new.is_dir() or visible(new)):
        raise AmulettError(f"--out '{arguments.out}' exists already; choose a new folder")
    note = read_provenance(old)
    kind = note.kind or "train"
    if kind not in _KINDS:
        raise AmulettError(f"'{arguments.folder}' was written by '{kind}', which this version cannot run again")
    if not arguments.trust_pickle and (note.config.get("trust_pickle") or "--trust-pickle" in (note.command or [])):
        raise AmulettError(
            f"the command behind '{arguments.folder}' opened zips of Stable-Baselines3: they contain pickles, which "
            "can run any code; if you trust them, give --trust-pickle here, too"
        )
    files = [name for name in note.command or [] if python_file(name) is not None]
    files += [name for name in note.config.get("policies", []) if python_file(str(name)) is not None]
    if files and not arguments.trust_python:
        raise AmulettError(
            f"the command behind '{arguments.folder}' ran a Python file, '{files[0]}'; if you trust it, give "
            "--trust-python here, too"
        )
    if kind == "hil" and not arguments.trust_c:
        raise AmulettError(
            f"'{arguments.folder}' holds a firmware's C sources, which are compiled and run; if you trust them, give "
            "--trust-c"
        )
    again, read = _KINDS[kind]
    expected = read(old)  # an unfinished folder is refused before anything runs
    warnings = [f"the software differs: {change}" for change in software_changes(note)]
    show = printer(arguments)
    with _working_folder(note) as moved:
        warnings += moved
        warnings += _changed_inputs(note)
        for warning in warnings:
            show(f"Warning: {warning}")
        show(f"Repeating: {shlex.join(note.command or ['amulett', kind])}", wrap=False)
        with contextlib.redirect_stdout(sys.stderr) if arguments.json else contextlib.nullcontext():
            again(note, old, new)
    changed = differences(_numbers(expected), _numbers(read(new)))
    if arguments.json:
        result = {"kind": kind, "same": not changed, "differences": changed, "warnings": warnings, "out": str(new)}
        print_json(result)
    elif changed:
        show(f"{len(changed)} of {_count(_numbers(expected))} numbers are not the same:")
        for line in changed[:_MOST_SHOWN]:
            show(f"  {line}")
        if len(changed) > _MOST_SHOWN:
            show(f"  and {len(changed) - _MOST_SHOWN} more (--json has them all)")
    elif kind == "bench":
        show(f"The same was measured; speeds are not compared. The repetition is in {arguments.out}.")
    else:
        show(f"All {_count(_numbers(expected))} numbers are the same. The repetition is in {arguments.out}.")
    return 1 if changed else 0


@contextlib.contextmanager
def _working_folder(note: Provenance) -> Any:
    """Change to the folder in which the command ran, for its relative paths; yield a warning if it is gone."""
    place = note.working_folder
    if place is None or not Path(place).is_dir():
        yield [] if place is None else [f"the folder in which the command ran is gone: {place}"]
        return
    with contextlib.chdir(place):
        yield []


def _changed_inputs(note: Provenance) -> list[str]:
    """Return a warning for each input that differs from the original one."""
    from amulett_gym.laws.copies import policy_digest

    if note.kind == "benchmark" and note.config.get("runs") is not None:
        # The original folder is not used: missing runs would be trained there.
        return [f"the training runs in '{note.config['runs']}' are trained again"]
    not_kept = note.kind == "evaluate" and "kept" not in note.config  # by an earlier version
    then = note.config.get("sha256", {}) if not_kept else {}
    return [f"the policy '{name}' has changed" for name in then if policy_digest(name) != then[name]]


def _train_again(note: Provenance, old: Path, new: Path) -> None:
    from amulett_gym.learning import load_learning

    training = load_learning("training")
    config = load_learning("recipes").load_train_config(old / "config.yaml")
    if config.max_seconds is not None:
        print("Warning: max_seconds may end one of the two runs earlier than the other.", file=sys.stderr)
    # The original devices, even if a file has changed.
    devices = {key: note.config[key] for key in ("profile", "fleet") if key in note.config}
    config = config.model_copy(update={"env": config.env.model_copy(update=devices)})
    result = training.train(training.with_start(config, old), new, command=note.command)
    if result.interrupted:
        raise KeyboardInterrupt


def _trained(folder: Path) -> Numbers:
    """Return a finished run's validations, without their times, and digests of its weights."""
    from amulett_gym.storage.reading import read_bytes, read_text

    if not (folder / "finished.json").is_file():
        raise AmulettError(f"the run in '{folder}' is not finished: amulett train --resume {folder}")
    rows = list(csv.DictReader(io.StringIO(read_text(folder / "evaluations.csv", "a run's validations"))))
    weights = {
        name: hashlib.sha256(read_bytes(folder / name / "weights.safetensors", "weights", 16_000_000)).hexdigest()
        for name in ("best", "last")
    }
    validations = [{key: value for key, value in row.items() if key != "seconds"} for row in rows]
    return {"validations": validations, "weights": weights}


def _seeds_again(note: Provenance, old: Path, new: Path) -> None:
    from amulett_gym.storage.provenance import read_provenance

    for seed in note.seeds:
        run = old / f"seed-{seed}"
        _train_again(read_provenance(run), run, new / run.name)


def _trained_seeds(folder: Path) -> Numbers:
    """Return the validations and digests of each finished run."""
    from amulett_gym.storage.reading import visible

    return {run.name: _trained(run) for run in visible(folder, "seed-*")}


def _evaluate_again(note: Provenance, old: Path, new: Path) -> None:
    from amulett_gym.cli.evaluate import compare
    from amulett_gym.laws.copies import kept_policies

    places = kept_policies(old, note.config.get("kept", {}))
    try:
        compare(note.config, str(new), note.command or ["amulett", "evaluate"], places)
    except (KeyError, TypeError) as error:
        raise AmulettError(f"'{old / 'command.json'}' does not describe a comparison: {error!r}") from error


def _hil_again(note: Provenance, old: Path, new: Path) -> None:
    from amulett_gym.cli.hil import compare
    from amulett_gym.laws.copies import kept_policies

    places = kept_policies(old, note.config.get("kept", {}))
    try:
        compare(note.config, str(new), note.command or ["amulett", "hil"], places)
    except (KeyError, TypeError) as error:
        raise AmulettError(f"'{old / 'command.json'}' does not describe a firmware in the loop: {error!r}") from error


def _compared(folder: Path) -> Numbers:
    """Return a comparison's numbers, overall and in each scenario."""
    from amulett_gym.storage.reading import read_json, read_text

    rows = csv.DictReader(io.StringIO(read_text(folder / "scenarios.csv", "a comparison's scenarios", 400_000_000)))
    results = read_json(folder / "results.json", "a comparison's results", 400_000_000)
    found = {key: results[key] for key in ("policies", "devices", "families", "lower_than") if key in results}
    return {**found, "scenarios": {" ".join(row[key] for key in row if key in _SCENARIO): row for row in rows}}


def _quickstart(folder: Path) -> Numbers:
    """Return the numbers of a quickstart's training run and comparison, independent of the folder's name."""
    trained, compared = _trained(folder / "ppo"), _compared(folder)
    own = next((name for name in compared["policies"] if Path(name).name == "ppo"), "ppo")
    scenarios = {key.replace(own, "ppo"): {**row, "policy": ""} for key, row in compared["scenarios"].items()}
    policies = {name.replace(own, "ppo"): numbers for name, numbers in compared["policies"].items()}
    return {**trained, "policies": policies, "scenarios": scenarios}


def _tune_law_again(note: Provenance, old: Path, new: Path) -> None:
    from amulett_gym.cli.tune_law import read_recipes, tune_in
    from amulett_gym.reporting.progress import say
    from amulett_gym.workers.call import Workers

    try:
        recipes = read_recipes(note.config)
    except (TypeError, ValueError) as error:
        raise AmulettError(f"'{old / 'command.json'}' does not describe a tuning: {error}") from error
    workers = Workers(os.cpu_count() or 1)
    tune_in(str(new), recipes, note.command or ["amulett", "tune-law"], say, workers)


def _tuned(folder: Path) -> Numbers:
    """Return the content of a tuned law's file, or of those in several loops by their names."""
    from amulett_gym.cli.tune_law import TUNING
    from amulett_gym.storage.reading import read_json, visible

    found = {path.name: read_json(path, "tuned law") for path in visible(folder, "*-*.json") if path.is_file()}
    loops = read_json(folder / TUNING, "tuned law's folder").get("control") if found else None
    if len(found) != (len(loops) if isinstance(loops, list) else 1):
        raise AmulettError(f"'{folder}' is not finished: repeat the command that began it")
    return found if isinstance(loops, list) else next(iter(found.values()))


def _command_again(note: Provenance, old: Path, new: Path) -> None:
    """Run a command's words again; it writes only to the new folder, even if they name other outputs."""
    from amulett_gym.cli import build_parser
    from amulett_gym.cli.reproduce import STUDY
    from amulett_gym.laws.copies import kept_policies

    problem = io.StringIO()
    try:
        with contextlib.redirect_stderr(problem), contextlib.redirect_stdout(problem):
            arguments = build_parser().parse_args(list(note.command or [])[1:])
    except SystemExit as error:
        reason = problem.getvalue().strip().rpartition("error: ")[2]
        raise AmulettError(f"'{old / 'command.json'}' holds no command of this version: {reason}") from error
    if arguments.command != note.kind:
        raise AmulettError(f"'{old / 'command.json'}' names no command of '{note.kind}' to repeat")
    vars(arguments).update({"out": str(new), "doc": None, "runs": None, "overwrite": False, "json": False, "ray": None})
    arguments.resolved, arguments.places = note.config, kept_policies(old, note.config.get("kept", {}))
    if (old / STUDY).is_dir():  # the original study of a reproduction
        arguments.study = str(old / STUDY)
    code = arguments.run(arguments)
    if code == 130:
        raise KeyboardInterrupt
    if code:
        raise AmulettError(f"the repetition ended with exit code {code}")


def _reader(pattern: str) -> Callable[[Path], Numbers]:
    """Return a reader of the JSON files that match a pattern in a finished folder."""

    def read(folder: Path) -> Numbers:
        from amulett_gym.storage.reading import read_json, visible

        found = visible(folder, pattern)
        if not found:
            raise AmulettError(f"'{folder}' is not finished: there is no {pattern}")
        return {path.relative_to(folder).as_posix(): read_json(path, "results", 400_000_000) for path in found}

    return read


def _identified(folder: Path) -> Numbers:
    """Return the content of an identification, or of a sample of devices."""
    from amulett_gym.studies.paper.sample import CONTENT, RECIPE

    return _reader(CONTENT if (folder / RECIPE).is_file() else "identification.json")(folder)


def _measured(folder: Path) -> Numbers:
    """Return the quantities in a folder of `amulett bench`; their values differ from run to run."""
    return {name: dict.fromkeys(content, "measured") for name, content in _reader("bench.json")(folder).items()}


_KINDS: Mapping[str, tuple[Callable[[Any, Path, Path], None], Callable[[Path], Numbers]]] = {
    "train": (_train_again, _trained),
    "seeds": (_seeds_again, _trained_seeds),
    "evaluate": (_evaluate_again, _compared),
    "quickstart": (_command_again, _quickstart),
    "hil": (_hil_again, _reader("hil.json")),
    "identify": (_command_again, _identified),
    "benchmark": (_command_again, _reader("benchmark.json")),
    "tune": (_command_again, _reader("trials.json")),
    "tune-law": (_tune_law_again, _tuned),
    "loops": (_command_again, _reader("loops.json")),
    "wearer": (_command_again, _reader("results.json")),
    "reproduce": (_command_again, _reader("reproduction.json")),
    "bench": (_command_again, _measured),
}


def _numbers(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _numbers(value) for key, value in tree.items() if key not in _NOT_NUMBERS}
    return [_numbers(item) for item in tree] if isinstance(tree, list) else tree


def _count(tree: Any) -> int:
    """Return the number of leaves."""
    below = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else None
    return 1 if below is None else sum(map(_count, below))
