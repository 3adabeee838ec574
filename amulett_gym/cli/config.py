"""`amulett config`: check a configuration file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from amulett_gym.cli.options import add_json
from amulett_gym.errors import AmulettError, unknown

if TYPE_CHECKING:
    from pydantic import BaseModel

HELP = "check a device, fleet, recipe, scenario, benchmark, tuning or rl_zoo3 file, a bundle or run; show all values"
EXAMPLES = """  amulett config validate configs/my_device.yaml
  amulett config validate configs/ppo.yaml --show
  amulett config validate pretrained --show
  amulett config validate my_scenario.json --json
"""


class Found(NamedTuple):
    """A file's kind in words, its name, its resolved content, and the model card of a policy."""

    kind: str
    name: str
    content: BaseModel | Mapping[str, BaseModel]
    card: str | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "action", choices=("validate",), help="validate: report the kind of a valid file, or its first errors"
    )
    parser.add_argument(
        "file", metavar="FILE", help="YAML or JSON file, the folder of a bundle or a training run, or pretrained"
    )
    control = "loop in which a device of your own is diagnosed (default: decentralized, the paper's)"
    parser.add_argument("--control", default="decentralized", metavar="LOOP", help=control)
    parser.add_argument(
        "--show",
        action="store_true",
        help="print every resolved value with its meaning and unit, and the model card of a policy",
    )
    add_json(parser, "kind and resolved values")


def run(arguments: argparse.Namespace) -> int:
    """Validate; an error names the key."""
    from amulett_gym.envs.settings import Settings
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.profile import Profile
    from amulett_gym.simulation.layout import CONTROLS

    if arguments.control not in CONTROLS:
        raise unknown("control", arguments.control, CONTROLS)
    found = validate(arguments.file)
    remarks: list[str] = []
    fleet = found.content.values() if isinstance(found.content, Mapping) else [found.content]
    for device in fleet:
        if isinstance(device, Profile):
            suite = Settings.model_fields["suite"].default
            remarks += device_remarks(device, loops=(arguments.control,), suite=suite)
    print_remarks(remarks)
    if arguments.json:
        content = {"kind": found.kind, "name": found.name, "remarks": remarks, "content": found.content}
        content |= {} if found.card is None else {"card": found.card}
        print(json.dumps(content, indent=2, allow_nan=False, default=_plain))
    elif arguments.show:
        if found.card is not None:
            print(found.card)
        print(f"# {found.name}, valid: {found.kind}")
        print("\n".join(show(found.content)))
    else:
        print(f"{arguments.file}: valid, {found.kind} ({found.name})")
    return 0


def validate(path: str | Path) -> Found:
    """Recognise the kind of a file by its keys, and validate it.

    Raises
    ------
    AmulettError
        If the file cannot be read, is of no known kind, or is not valid.
    """
    from amulett_gym.laws.contenders import PRETRAINED, bundle_folder
    from amulett_gym.settings import find_config
    from amulett_gym.storage.reading import user_path

    name, path = str(path), user_path(path)
    if name in PRETRAINED and not path.exists():
        path = bundle_folder(name)
    if path.is_dir():
        return _validate_folder(path)
    from amulett_gym.cli.zoo import is_zoo_file, parse_zoo_file
    from amulett_gym.fleet import MAX_BYTES, is_fleet, parse_fleet
    from amulett_gym.learning import load_learning
    from amulett_gym.profile import Profile, parse_profile
    from amulett_gym.storage.reading import parse_json, read_text
    from amulett_gym.storage.safe_yaml import parse_yaml
    from amulett_gym.studies.benchmark.description import Benchmark, parse_benchmark
    from amulett_gym.studies.benchmark.devices.description import DevicesBenchmark, parse_devices_benchmark
    from amulett_gym.studies.benchmark.devices.stages import check_devices_benchmark
    from amulett_gym.studies.wearer.description import Description, parse_description
    from amulett_gym.tasks.scenario import Scenario, parse_scenario

    path = find_config(path, "file", kinds=("yaml", "json", "yml"))
    is_json = path.suffix.lower() == ".json"
    if not is_json and path.suffix.lower() not in (".yaml", ".yml"):
        allowed = (
            ".yaml or .json (device, fleet, recipe, benchmark, scenario, rl_zoo3) nor the folder of a bundle or a "
            "training run"
        )
        raise AmulettError(f"'{path}' is neither {allowed}")
    recipes = load_learning("recipes")
    kinds: Mapping[str, tuple[type[BaseModel], Any]] = {
        "a device profile": (Profile, parse_profile),
        "a training recipe": (recipes.TrainConfig, _parse_recipe),
        "a benchmark's description": (Benchmark, parse_benchmark),
        "a description of a benchmark over devices": (DevicesBenchmark, parse_devices_benchmark),
        "a study of wearers": (Description, parse_description),
        "a scenario": (Scenario, lambda content, path: parse_scenario(content, path.parent, f"scenario '{path}'")),
    }
    content = (parse_json if is_json else parse_yaml)(read_text(path, "file", MAX_BYTES), f"file '{path}'")
    if is_fleet(content):
        fleet = parse_fleet(content, path)
        return Found(
            f"a fleet of {len(fleet)} device{'s' * (len(fleet) > 1)}", path.stem, {one.name: one for one in fleet}
        )
    if not isinstance(content, dict):
        raise AmulettError(
            f"file '{path}' has to hold a mapping of keys to values, or a fleet's list, not {type(content).__name__}"
        )
    if is_zoo_file(content):
        entries = parse_zoo_file(content, path)
        count = f"{len(entries)} environment{'s' * (len(entries) > 1)}"
        return Found(f"hyper-parameters of rl_zoo3 for {count}", path.stem, entries)
    keys = set(content)
    if keys and all("." in str(key) for key in keys):
        space = load_learning("tuning").parse_space(content, recipes.TrainConfig(), path)
        return Found("a search space of `amulett tune`", path.stem, space)
    known = {kind: len(keys & set(model.model_fields)) for kind, (model, _) in kinds.items()}
    kind = max(known, key=lambda kind: known[kind])
    if "fleets" in keys:
        kind = "a description of a benchmark over devices"
    if not known[kind] and is_json:
        kind = "a scenario"  # the usual content of JSON files
    elif not known[kind]:
        allowed = "; ".join(f"{kind}: {', '.join(model.model_fields)}" for kind, (model, _) in kinds.items())
        raise AmulettError(f"'{path}' has no key of any kind of file ({allowed})")
    valid = kinds[kind][1](content, path)
    if kind == "a training recipe":
        _check_start(valid)
    elif kind == "a benchmark's description":
        _check_benchmark(valid, path)
    elif kind == "a description of a benchmark over devices":
        check_devices_benchmark(valid, path.parent)
    return Found(kind, getattr(valid, "name", path.stem), valid)


def _validate_folder(path: Path) -> Found:
    """Validate a policy bundle, or a training run: its recipe, the bundle that it starts from, and its best bundle."""
    from amulett_gym.laws.bundle import MANIFEST, read_bundle
    from amulett_gym.laws.card import card_of
    from amulett_gym.storage.safe_yaml import read_yaml

    name, recipe, best, start = path.resolve().name, path / "config.yaml", path / "best", path / "start"
    if (path / MANIFEST).exists():
        bundle = read_bundle(path)
        return Found("a policy bundle", name, bundle.policy, card_of(bundle))
    if not recipe.exists():
        raise AmulettError(
            f"'{path}' holds neither a policy bundle ({MANIFEST}) nor a training run (config.yaml, and best/ in it)"
        )
    config = _parse_recipe(read_yaml(recipe, "recipe"), recipe)
    if start.exists():  # the copy counts
        read_bundle(start)
    else:
        _check_start(config)
    if not best.exists():
        return Found("a training run without a policy yet", name, config)
    return Found("a training run with its best policy", name, config, card_of(read_bundle(best)))


def _parse_recipe(content: Mapping[str, Any], path: Path) -> Any:
    from amulett_gym.learning import load_learning

    return load_learning("recipes").parse_train_config(content, f"recipe '{path}'")


def _check_start(config: Any) -> None:
    """Refuse a recipe that starts from a bundle that cannot be read; its device has been read."""
    from amulett_gym.laws.bundle import read_bundle
    from amulett_gym.laws.contenders import bundle_folder

    if config.network.start is not None:
        read_bundle(bundle_folder(config.network.start))


def _check_benchmark(benchmark: Any, path: Path) -> None:
    """Refuse a description with a device, recipe or start that the command would refuse."""
    from amulett_gym.studies.benchmark.description import load_profile_of, recipe_folder, training_recipe
    from amulett_gym.studies.benchmark.reference import check_starts

    folder = recipe_folder(path)
    load_profile_of(benchmark, folder)
    check_starts(benchmark)
    for entry in benchmark.learned.values():
        _check_start(training_recipe(entry, entry.seeds[0], folder))


def show(model: BaseModel | Mapping[str, BaseModel], indent: str = "") -> list[str]:
    """Return resolved values as lines of YAML, each with its field's description."""
    from pydantic import BaseModel

    if not isinstance(model, BaseModel):
        return [f"{key}: {_flow(value)}" for key, value in model.items()]
    lines = []
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        remark = f"  # {field.description}" if field.description else ""
        if isinstance(value, BaseModel):
            lines += [f"{indent}{key}:{remark}", *show(value, f"{indent}  ")]
        else:
            lines.append(f"{indent}{key}: {_flow(value)}{remark}")
    return lines


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    from amulett_gym.storage.safe_yaml import to_yaml

    content = json.loads(json.dumps(value, default=_plain))
    text = to_yaml(content, default_flow_style=True, width=10**9, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def _plain(item: Any) -> Any:
    from pydantic import BaseModel

    return item.model_dump(mode="json") if isinstance(item, BaseModel) else str(item)
