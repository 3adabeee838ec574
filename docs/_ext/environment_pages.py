"""Pages of environments: their docstrings, which are Markdown as those of Gymnasium's environments.

A page holds a fence of the language `{environment}` with the name of the class, `module:Class`. It is replaced by a
table of the environment's spaces and by the docstring.
"""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from typing import Any

import gymnasium
from sphinx.application import Sphinx

FENCE = re.compile(r"^```\{environment\} (?P<module>[\w.]+):(?P<name>\w+)\n```$", flags=re.MULTILINE)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("source-read", put_docstrings)
    app.connect("autodoc-process-docstring", shorten, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def put_docstrings(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace the fences of a page, whose text is the only entry of `source`."""

    def docstring(match: re.Match[str]) -> str:
        cls = getattr(import_module(match["module"]), match["name"])
        app.env.note_dependency(inspect.getsourcefile(cls) or "")
        return f"{spaces(cls)}\n\n{as_markdown(inspect.getdoc(cls) or '')}"

    source[0] = FENCE.sub(docstring, source[0])


def spaces(cls: type[Any]) -> str:
    """Return the table at the head of an environment's page."""
    env = gymnasium.make(cls.env_id, disable_env_checker=True)
    rows = {
        "Import": f'`gymnasium.make("amulett_gym:{cls.env_id}")`',
        "Many devices": f'`gymnasium.make_vec("amulett_gym:{cls.env_id}", num_envs=N)`',
        "Action space": f"`{env.action_space}`",
        "Observation space": f"`{env.observation_space}`",
        "Class": f"{{py:class}}`{cls.__module__}.{cls.__name__}`",
    }
    env.close()
    return "\n".join(["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows.items())])


def as_markdown(text: str) -> str:
    """Return a docstring whose roles and literal blocks are those of reStructuredText as MyST."""
    text = re.sub(r":(class|func|data|mod|meth):`([^`]+)`", r"{py:\1}`\2`", text)
    literal = re.compile(r"::\n\n(?P<code>(?:(?: {4}.*)?\n)+)(?=\S)")

    def fenced(match: re.Match[str]) -> str:
        return f":\n\n```python\n{inspect.cleandoc(match['code'])}\n```\n\n"

    return literal.sub(fenced, text)


def shorten(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Leave only the first paragraph of a docstring in Markdown: the environment's page has the rest."""
    if what == "class" and any(line.startswith("## ") for line in lines):
        end = lines.index("") if "" in lines else len(lines)
        lines[:] = [*lines[:end], ""]
