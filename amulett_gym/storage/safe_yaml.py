"""YAML 1.2 of plain data, read from untrusted text within limits.

PyYAML reads YAML 1.1, where ``yes`` and ``off`` are truth values, ``010`` is 8, ``1:30`` is 90, and ``1e-3`` is text.
Here only ``true`` and ``false`` are truth values, and numbers are those of YAML 1.2, with ``_`` between digits allowed
as well. Everything else is text, also an integer with leading zeros, which the two versions read differently.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from amulett_gym.errors import AmulettError
from amulett_gym.storage.reading import MAX_DEPTH, check_tree, parse_json, read_text

MAX_NODES = 200_000
"""Keys and values in a file, aliases counted at each use; the recipe of a run with 64 own devices has 40,000."""

_TAGS = ("map", "seq", "str", "null", "merge")
_DIGITS = "[0-9]+(?:_[0-9]+)*"
_SCALARS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (rf"[-+]?(?:0|(?!0){_DIGITS})|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        rf"[-+]?(?:{_DIGITS}\.(?:{_DIGITS})?|\.{_DIGITS}|{_DIGITS}(?=[eE]))(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
}
"""Pattern of truth values and numbers, and their first characters."""


def parse_yaml(text: str, what: str) -> Any:
    """Return the content of a YAML text: mappings, lists, text, numbers, truth values and null.

    Parameters
    ----------
    text : str
    what : str
        What the text is, for the error message.

    Raises
    ------
    AmulettError
        If it is no valid YAML, holds another kind of object, is nested more than `MAX_DEPTH` deep, has more than
        `MAX_NODES` keys and values, refers to itself, holds a key twice or an integer that is too long.
    """
    try:
        value = yaml.load(text, Loader=_Loader)
        check_tree(value, finite=False)
    # `!!int ''`, `!!bool x` and the like raise LookupError, ArithmeticError or TypeError.
    except (yaml.YAMLError, ValueError, LookupError, ArithmeticError, TypeError, RecursionError) as error:
        message = " ".join(str(error).split())[:500]
        raise AmulettError(f"{what} is not valid YAML: {message}") from error
    return value


def to_yaml(value: Any, **options: Any) -> str:
    """Return plain data as YAML from which `parse_yaml` reads the same, keys in order; `options` are PyYAML's."""
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, **options)
    return text


def read_yaml(path: str | Path, what: str, limit: int = 4_000_000) -> dict[str, Any]:
    """Return the mapping in a YAML file, or in a JSON file if its name ends in ``.json``.

    Raises
    ------
    AmulettError
        If the file cannot be read or is longer than `limit` [bytes], `parse_yaml` or `parse_json` refuses its text, or
        it holds something else.
    """
    parse = parse_json if Path(path).suffix.lower() == ".json" else parse_yaml
    content = parse(read_text(path, what, limit), f"{what} '{path}'")
    if not isinstance(content, dict):
        raise AmulettError(f"{what} '{path}' has to hold a mapping of keys to values, not {type(content).__name__}")
    return content


class _Loader(yaml.SafeLoader):
    """Counts nodes while composing them; constructs JSON's types only."""

    yaml_constructors = {  # noqa: RUF012  (PyYAML's own convention)
        tag: constructor
        for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.rpartition(":")[2] in _TAGS
    }
    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, pattern) for tag, pattern in resolvers if tag.rpartition(":")[2] in _TAGS]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_truth(self, node: yaml.ScalarNode) -> bool:
        text = self.construct_scalar(node)
        if text.lower() not in ("true", "false"):
            raise ValueError(f"{text[:100]!r} is no truth value: true or false")
        return text.lower() == "true"

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        return int(self.construct_scalar(node), 0)

    def construct_number(self, node: yaml.ScalarNode) -> float:
        text = self.construct_scalar(node).lower()
        return float(text.replace(".inf", "inf") if text.endswith(".inf") else "nan" if text == ".nan" else text)

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
            raise ValueError(f"it has more than {MAX_NODES} keys and values")


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.1 or 1.2 would take for something else; writes text of several lines as such."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, data: str) -> yaml.ScalarNode:
        return self.represent_scalar("tag:yaml.org,2002:str", data, style="|" if "\n" in data else None)


_Dumper.add_representer(str, _Dumper.represent_text)
for _kind, _construct in (
    ("bool", _Loader.construct_truth),
    ("int", _Loader.construct_integer),
    ("float", _Loader.construct_number),
):
    _pattern, _first = _SCALARS[_kind]
    _tag = f"tag:yaml.org,2002:{_kind}"
    _Loader.add_constructor(_tag, _construct)
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(_tag, re.compile(f"(?:{_pattern})$"), list(_first))
