"""`amulett config`: check a configuration file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from amulett_gym.cli.options import add_json
from amulett_gym.errors import AmulettError

if TYPE_CHECKING:
    from pydantic import BaseModel

HELP = "check a device, recipe, scenario, benchmark or tuning file, or a policy bundle; show its resolved values"
EXAMPLES = """  amulett config validate configs/my_device.yaml
  amulett config validate configs/ppo.yaml --show
  amulett config validate my_scenario.json --json
"""


class Found(NamedTuple):
    """A file's kind in words, its name, and its resolved content."""

    kind: str
    name: str
    content: BaseModel | Mapping[str, BaseModel]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "action", choices=("validate",), help="validate: report the kind of a valid file, or its first errors"
    )
    parser.add_argument("file", metavar="FILE", help="YAML or JSON file, or a policy bundle's folder")
    parser.add_argument("--show", action="store_true", help="print every resolved value with its meaning and unit")
    add_json(parser, "kind and resolved values")


def run(arguments: argparse.Namespace) -> int:
    """Validate; an error names the key."""
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.profile import Profile

    found = validate(arguments.file)
    remarks = device_remarks(found.content) if isinstance(found.content, Profile) else []
    print_remarks(remarks)
    if arguments.json:
        content = {"kind": found.kind, "name": found.name, "remarks": remarks, "content": found.content}
        print(json.dumps(content, indent=2, allow_nan=False, default=_plain))
    elif arguments.show:
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
    from amulett_gym.settings import find_config
    from amulett_gym.storage.reading import read_json, user_path

    path = user_path(path)
    if path.is_dir():
        from amulett_gym.laws.bundle import read_bundle

        return Found("a policy bundle", path.name, read_bundle(path).policy)
    from amulett_gym.tasks.scenario import MAX_BYTES, Scenario, load_scenario

    path = find_config(path, "file")
    if path.suffix.lower() not in (".yaml", ".yml", ".json"):
        allowed = ".yaml or .json (device, recipe, benchmark, scenario) nor a bundle"
        raise AmulettError(f"'{path}' is neither {allowed}")

    from amulett_gym.learning import load_learning
    from amulett_gym.profile import Profile, load_profile
    from amulett_gym.storage.safe_yaml import read_yaml
    from amulett_gym.studies.benchmark.description import Benchmark, load_benchmark

    recipes = load_learning("recipes")
    kinds: Mapping[str, tuple[type[BaseModel], Any]] = {
        "a device profile": (Profile, load_profile),
        "a training recipe": (recipes.TrainConfig, recipes.load_train_config),
        "a benchmark's description": (Benchmark, load_benchmark),
        "a scenario": (Scenario, load_scenario),
    }
    is_json = path.suffix.lower() == ".json"
    content = read_json(path, "file", MAX_BYTES) if is_json else read_yaml(path, "file")
    if not isinstance(content, dict):
        raise AmulettError(f"'{path}' has to hold a mapping of keys to values, not {type(content).__name__}")
    keys = set(content)
    if keys and all("." in str(key) for key in keys):
        return Found("a search space of `amulett tune`", path.stem, _load_space(path))
    known = {kind: len(keys & set(model.model_fields)) for kind, (model, _) in kinds.items()}
    kind = max(known, key=lambda kind: known[kind])
    if not known[kind] and is_json:
        kind = "a scenario"  # the usual content of JSON files
    elif not known[kind]:
        allowed = "; ".join(f"{kind}: {', '.join(model.model_fields)}" for kind, (model, _) in kinds.items())
        raise AmulettError(f"'{path}' has no key of any kind of file ({allowed})")
    content = kinds[kind][1](path)
    if kind == "a training recipe":
        _check_recipe(content)
    elif kind == "a benchmark's description":
        _check_benchmark(content, path)
    return Found(kind, getattr(content, "name", path.stem), content)


def _check_recipe(config: Any) -> None:
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
        _check_recipe(training_recipe(entry, entry.seeds[0], folder))


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


def _load_space(path: Path) -> Mapping[str, BaseModel]:
    from amulett_gym.learning import load_learning

    return load_learning("tuning").load_space(path, load_learning("recipes").TrainConfig())


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    from amulett_gym.storage.safe_yaml import to_yaml

    content = json.loads(json.dumps(value, default=_plain))
    text = to_yaml(content, default_flow_style=True, width=10**9, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def _plain(item: Any) -> Any:
    from pydantic import BaseModel

    return item.model_dump(mode="json") if isinstance(item, BaseModel) else str(item)
