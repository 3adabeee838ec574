"""The base of all HTML pages: one look, one place where templates are filled, nothing loaded from elsewhere."""

from __future__ import annotations

from importlib import resources
from typing import Any

import jinja2

from amulett_gym.reporting.words import html, number, pretty


def fill_page(template: str, **values: Any) -> str:
    """Return a page: a template of the package that extends ``reporting/page.html.j2``, filled.

    Parameters
    ----------
    template : str
        Its path in the package.
    **values
        What the template needs; text is escaped. `number`, `pretty` and `html` of `reporting.words` are there for all.
    """
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    shared = {"style": _read("reporting/page.css"), "number": number, "pretty": pretty, "html": html}
    return environment.get_template(template).render({**shared, **values})


def _read(name: str) -> str:
    return resources.files("amulett_gym").joinpath(name).read_text(encoding="utf-8")
