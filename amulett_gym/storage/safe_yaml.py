"""YAML from strangers: plain data only, and bounded before anything is built from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import MAX_DEPTH, check_tree, read_text

MAX_BYTES = 100_000
"""Largest YAML file accepted; the shipped ones have 5 kB."""

MAX_NODES = 10_000
"""Keys and values in a file, aliases counted as often as they are used; the largest of ours has 500."""

_TAGS = ("map", "seq", "str", "int", "float", "bool", "null", "merge")


def parse_yaml(text: str, what: str) -> Any:
    """Return what a YAML text stands for: mappings, lists, text, numbers, truth values and null.

    Parameters
    ----------
    text : str
    what : str
        What the text is, for the error message.

    Raises
    ------
    AmulettError
        If it is no valid YAML, wants another kind of object, is nested more than `MAX_DEPTH` deep, stands for more than
        `MAX_NODES` keys and values, refers to itself, holds a key twice or an integer that is too long.
    """
    try:
        value = yaml.load(text, Loader=_Loader)  # a SafeLoader with less
        check_tree(value, finite=False)
    # What the safe loader raises for `!!int ''`, `!!bool x` and the like.
    except (yaml.YAMLError, ValueError, LookupError, ArithmeticError, TypeError, RecursionError) as error:
        message = " ".join(str(error).split())[:500]
        raise AmulettError(f"{what} is not valid YAML: {message}") from error
    return value


def read_yaml(path: str | Path, what: str) -> dict[str, Any]:
    """Read a YAML file that has to hold a mapping.

    Raises
    ------
    AmulettError
        If the file cannot be read, `parse_yaml` refuses its text, or it holds something else than a mapping.
    """
    content = parse_yaml(read_text(path, what, MAX_BYTES), f"{what} '{path}'")
    if not isinstance(content, dict):
        raise AmulettError(f"{what} '{path}' has to hold a mapping of keys to values, not {type(content).__name__}")
    return content


class _Loader(yaml.SafeLoader):
    """Counts nodes while they are composed; constructs what JSON has, and nothing else."""

    yaml_constructors = {  # noqa: RUF012  (PyYAML's own convention)
        tag: constructor
        for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.rpartition(":")[2] in _TAGS
    }
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag.rpartition(":")[2] in _TAGS]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._count = self._depth = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self._sizes:
                raise ValueError("a part of it refers to itself")
            self._add(self._sizes[id(node)])
            return node
        before = self._count
        self._add(1)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f"it is nested more than {MAX_DEPTH} levels deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._sizes[id(node)] = self._count - before
        if isinstance(node, yaml.MappingNode):
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            if len(set(keys)) < len(keys):
                raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)[:100]!r} is there twice")
        return node

    def _add(self, count: int) -> None:
        self._count += count
        if self._count > MAX_NODES:
            raise ValueError(f"it stands for more than {MAX_NODES} keys and values")
