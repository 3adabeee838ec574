"""The base of all HTML pages: templates of one style, filled; a page loads nothing from elsewhere."""

from __future__ import annotations

from importlib import resources
from typing import Any

import jinja2

from amulett_gym.reporting.words import html, number, pretty


def fill_page(template: str, **values: Any) -> str:
    """Return a filled template, by its path in the package; it extends ``reporting/page.html.j2``.

    Text in `values` is escaped. Templates can use `number`, `pretty` and `html` of `reporting.words`.
    """
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    shared = {"style": _read("reporting/page.css"), "number": number, "pretty": pretty, "html": html}
    return environment.get_template(template).render({**shared, **values})


def _read(name: str) -> str:
    return resources.files("amulett_gym").joinpath(name).read_text(encoding="utf-8")
