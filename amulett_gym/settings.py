"""Typed settings in pydantic groups."""

from __future__ import annotations

import os
import types
import typing
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from amulett_gym.errors import AmulettError, nearest, shorten
from amulett_gym.storage.reading import user_path, visible

SOURCES = ("paper", "datasheet", "identified", "assumed", "given")
_MOST_ERRORS = 10


class Group(BaseModel):
    """A frozen group of settings; unknown keys, non-finite numbers, and text or truth values as numbers are refused.

    Numbers may be Python's or NumPy's, integers may be floats (``5e6``), lists tuples or arrays, and path texts Paths.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _to_plain(cls, content: Any) -> Any:
        if not isinstance(content, Mapping):
            return content
        fields = cls.model_fields
        return {
            key: to_plain(value, fields[key].annotation if key in fields else Any) for key, value in content.items()
        }


class Sourced(Group):
    """A group with the source of its values: one of `SOURCES`, and an explanation."""

    sources: dict[str, str] = Field(default={}, description="key -> '<source>: explanation'")

    @model_validator(mode="after")
    def _check_sources(self) -> Sourced:
        for key, source in self.sources.items():
            if key not in type(self).model_fields or key == "sources":
                raise ValueError(f"sources names the unknown key '{key}'{nearest(key, type(self).model_fields)}")
            if source.split(":")[0] not in SOURCES:
                raise ValueError(f"source of '{key}' is '{source}'; it has to start with one of {', '.join(SOURCES)}")
        return self


def configs_folder() -> Path:
    """Return the folder of the packaged recipes: a checkout's ``configs/``, or a wheel's copy."""
    package = Path(__file__).parent
    return package / "configs" if (package / "configs").is_dir() else package.parent / "configs"


def find_config(path: str | Path, what: str, folder: Path = Path(), kinds: Sequence[str] = ("yaml", "json")) -> Path:
    """Return a file by its path relative to `folder`, or the packaged one of that name if it does not exist.

    A packaged file may be named as ``configs/ppo.yaml``, ``ppo.yaml`` or ``ppo``; `what` it holds is for the error.
    `kinds` are the suffixes of packaged files.

    Raises
    ------
    AmulettError
        If neither exists.
    """
    place, packaged = folder / user_path(path), configs_folder()
    exists = os.path.exists(place)  # noqa: PTH110  (Path.exists raises for names that are too long)
    if exists and not place.is_dir():
        return place
    files = [file for kind in kinds for file in visible(packaged, f"**/*.{kind}")]
    names = sorted(file.relative_to(packaged).as_posix() for file in files)
    wanted = Path(path).as_posix().removeprefix("configs/")
    for name in names:
        if wanted in (name, name.rpartition(".")[0]):
            return packaged / name
    if exists:
        return place  # a folder: its reader raises
    raise AmulettError(
        f"cannot read {what} '{shorten(str(path))}': No such file or directory; packaged are {', '.join(names)}"
        f"{nearest(wanted, names)}"
    )


def to_plain(value: Any, annotation: Any = Any) -> Any:
    """Return `value` as plain data: numbers, text, truth values, None, and lists and dicts of them.

    NumPy's (or torch's) numbers and arrays become Python's, tuples lists, mappings dicts, and paths text; other objects
    stay. If `annotation` is an integer type, an integral float becomes an int; if it is a tuple, lists become tuples.
    """
    if value is None or type(value) in (str, bool, int):
        return value
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        value = value.tolist()
    wanted = _alternatives(annotation)
    if isinstance(value, Mapping):
        if any(isinstance(kind, type) and issubclass(kind, Group) for kind in wanted):
            return value  # the group does it for its own keys
        _, item = _container(wanted, dict)
        return {key: to_plain(part, item) for key, part in value.items()}
    if isinstance(value, list | tuple):
        kind, item = _container(wanted, list, tuple)
        return kind(to_plain(part, item) for part in value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and int in wanted and float not in wanted and value.is_integer():
        return int(value)
    return value


@cache  # searches validate thousands of profiles
def _alternatives(annotation: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the one type of an annotation."""
    origin, members = typing.get_origin(annotation), typing.get_args(annotation)
    if origin not in (typing.Union, types.UnionType, typing.Annotated):
        return (annotation,)
    parts = members[:1] if origin is typing.Annotated else members
    return tuple(kind for member in parts for kind in _alternatives(member))


def _container(wanted: tuple[Any, ...], *kinds: type) -> tuple[type, Any]:
    """Return the wanted kind of container, the first of `kinds` if none, and the type of its items."""
    for annotation in wanted:
        kind = typing.get_origin(annotation)
        if kind in kinds:
            return kind, typing.get_args(annotation)[kind is dict]
    return kinds[0], Any


def describe(error: ValidationError, model: type[BaseModel], what: str) -> AmulettError:
    """Return a pydantic error as one that names key, value, what is allowed and the nearest valid key."""
    lines = []
    errors = error.errors(include_url=False)
    for item in errors[:_MOST_ERRORS]:
        location = item["loc"]
        key = shorten(".".join(str(part) for part in location))
        if item["type"] == "extra_forbidden":
            choices = _keys_at(model, location[:-1])
            lines.append(f"unknown key '{key}'{nearest(key.split('.')[-1], choices)} (allowed: {', '.join(choices)})")
        elif item["type"] == "missing":
            lines.append(f"'{key}' is missing")
        else:
            value = "" if isinstance(item["input"], dict | list) else f" is {shorten(repr(item['input']))}"
            message = shorten(item["msg"].removeprefix("Value error, "), 1000)
            if item["type"] == "bool_type" and isinstance(item["input"], str):
                message += ": true or false"
            lines.append(f"'{key}'{value}: {message}" if key else message)
    if len(errors) > _MOST_ERRORS:
        lines.append(f"and {len(errors) - _MOST_ERRORS} more")
    return AmulettError(f"{what}: " + "; ".join(lines))


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the keys of `changes` replaced, group by group; a list is replaced whole."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(value, Mapping) and isinstance(old, Mapping) else value
    return merged


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed at `location` inside `model`, also within lists and optional groups."""
    for part in location:
        if part in model.model_fields:
            model = _group_in(model.model_fields[str(part)].annotation) or model
    return list(model.model_fields)


def _group_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, typing.Union, types.UnionType):
        return next(filter(None, map(_group_in, typing.get_args(annotation))), None)
    return None
