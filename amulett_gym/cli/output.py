"""Output of commands on stdout: lines of text, or a single JSON document."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from typing import Any


def print_json(content: Any) -> None:
    """Print plain data as one JSON document; a number that is not finite is null."""
    print(json.dumps(_finite(content), indent=2, allow_nan=False, default=str), flush=True)


def printer(arguments: argparse.Namespace) -> Callable[..., None]:
    """Return `reporting.progress.say`, which prints text; with `--json` a function that prints nothing."""
    if arguments.json:
        return lambda text, wrap=True: None
    from amulett_gym.reporting.progress import say

    return say


def _finite(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _finite(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [_finite(item) for item in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
