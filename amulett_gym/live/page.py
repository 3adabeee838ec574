"""One HTML file with everything in it: the simulation as WebAssembly, devices, laws and scenarios as data, the page.

It opens from a file and asks nothing of any other place; its content security policy forbids it to.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from amulett_gym import __version__
from amulett_gym.errors import AmulettError
from amulett_gym.live.choices import Choices, choices
from amulett_gym.live.core import script as core_script
from amulett_gym.live.core.build import read_wasm
from amulett_gym.live.core.hex import read_hex

STYLE, TEMPLATE = "style.css", "page.html.j2"
YAML, YAML_LICENCE = "vendor/js-yaml.min.js", "vendor/js-yaml.LICENSE"
"""js-yaml 5.5.0, `dist/browser/js-yaml.umd.min.js` of the package of that name on npm, unchanged."""

SCRIPTS = (
    *("base", "palette", "canvas", "arm", "samples", "paper", "strips", "run", "laws", "messages", "link", "csv"),
    *("fields", "pointer", "keys", "profile", "drop", "panel", "app"),
)
"""The page's scripts, in the order in which they need each other."""


def build_page(
    profile: Any = "testbed", policies: Sequence[str] = (), scenario: Any = None, loop: str | None = None
) -> str:
    """Return the page as one HTML text.

    Parameters
    ----------
    profile : str, Path, Mapping or Profile
        The device that is shown first; one of your own is added to the shipped ones.
    policies : sequence of str
        Laws that are added, by the names that `amulett_gym.laws.contenders.parse_contender` takes, but for Python
        functions; the first one acts first.
    scenario : str, Path, Mapping or Scenario, optional
        A task of your own, which is shown first.
    loop : str, optional
        The control loop that is shown first; None: that of the first policy, or the paper's.

    Raises
    ------
    AmulettError
        If one of them cannot be read, or cannot be shown.
    """
    return render(choices(profile, policies, scenario, loop))


def render(found: Choices) -> str:
    """Return the page that offers these choices."""
    wasm = base64.b64encode(read_wasm()).decode()
    data = {**found.content(), "version": __version__, "wasm": wasm, "hex": read_hex()}
    style, script = _read(STYLE), "\n".join([_yaml(), core_script(), *(_read(f"{name}.js") for name in SCRIPTS)])
    if "</script" in script or "</style" in style:
        raise AmulettError("a script of the page holds '</script'; an HTML page would end it there")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_read(TEMPLATE)).render(
        policy=Markup(content_policy(style, script)),
        style=Markup(style),
        script=Markup(script),
        data=Markup(to_script(data)),
        version=__version__,
    )


def content_policy(style: str, script: str) -> str:
    """Return the page's content security policy: its style, its script, WebAssembly, and nothing from elsewhere."""
    return "; ".join(
        (
            "default-src 'none'",
            f"script-src {_hash(script)} 'wasm-unsafe-eval'",
            f"style-src {_hash(style)}",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def to_script(data: Any) -> str:
    """Return data as JSON that may stand in a script element, whatever text it holds."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _read(name: str) -> str:
    return resources.files("amulett_gym.live").joinpath("page", name).read_text(encoding="utf-8")


def _yaml() -> str:
    """Return js-yaml under its licence, without the address of its source map, which nobody has here."""
    return f"/*! js-yaml\n{_read(YAML_LICENCE)}*/\n" + re.sub(r"//# sourceMappingURL=\S+", "", _read(YAML))
