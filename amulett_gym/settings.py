"""Typed settings: groups that refuse unknown keys, and errors that name key, value and what is allowed."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from amulett_gym.errors import AmulettError, nearest

SOURCES = ("paper", "datasheet", "identified", "assumed")
_MOST_ERRORS = 10
_MOST_SHOWN = 100


class Group(BaseModel):
    """A frozen group of settings; unknown keys and non-finite numbers are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Sourced(Group):
    """A group whose values can name where they come from: `paper`, `datasheet`, `identified` or `assumed`."""

    sources: dict[str, str] = Field(default_factory=dict, description="key -> '<source>: explanation'")

    @model_validator(mode="after")
    def _check_sources(self) -> Sourced:
        for key, source in self.sources.items():
            if key not in type(self).model_fields or key == "sources":
                raise ValueError(f"sources names the unknown key '{key}'{nearest(key, type(self).model_fields)}")
            if source.split(":")[0] not in SOURCES:
                raise ValueError(f"source of '{key}' is '{source}'; it has to start with one of {', '.join(SOURCES)}")
        return self


def configs_folder() -> Path:
    """Return the folder of the recipes that come with the package: a checkout's ``configs/``, or a wheel's copy."""
    package = Path(__file__).parent
    return package / "configs" if (package / "configs").is_dir() else package.parent / "configs"


def describe(error: ValidationError, model: type[BaseModel], what: str) -> AmulettError:
    """Turn a pydantic error into one that names key, value, what is allowed and the nearest valid key."""
    lines = []
    errors = error.errors(include_url=False)
    for item in errors[:_MOST_ERRORS]:
        location = item["loc"]
        key = _shorten(".".join(str(part) for part in location))
        if item["type"] == "extra_forbidden":
            choices = _keys_at(model, location[:-1])
            lines.append(f"unknown key '{key}'{nearest(key.split('.')[-1], choices)} (allowed: {', '.join(choices)})")
        elif item["type"] == "missing":
            lines.append(f"'{key}' is missing")
        else:
            value = "" if isinstance(item["input"], dict | list) else f" is {_shorten(repr(item['input']))}"
            message = _shorten(item["msg"].removeprefix("Value error, "), 10 * _MOST_SHOWN)
            lines.append(f"'{key}'{value}: {message}" if key else message)
    if len(errors) > _MOST_ERRORS:
        lines.append(f"and {len(errors) - _MOST_ERRORS} more")
    return AmulettError(f"{what}: " + "; ".join(lines))


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the keys of `changes` replaced, group by group; a list is replaced whole."""
    merged = dict(base)
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed at `location` inside `model`, looking through lists and optional groups."""
    for part in location:
        if part in model.model_fields:
            model = _group_in(model.model_fields[str(part)].annotation) or model
    return list(model.model_fields)


def _shorten(text: str, most: int = _MOST_SHOWN) -> str:
    return text if len(text) <= most else f"{text[:most]}..."


def _group_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (list, typing.Union, types.UnionType):
        return next((group for group in map(_group_in, typing.get_args(annotation)) if group), None)
    return None
