"""The simulation in a browser: the control tick as WebAssembly, what is around it in JavaScript."""

from __future__ import annotations

from importlib import resources

SCRIPTS = ("base.js", "records.js", "laws.js", "policy.js", "arm.js", "core.js")
"""Classic scripts, in this order."""


def script() -> str:
    """Return the scripts as one: it sets ``globalThis.Amulett``, whose ``load`` takes the WebAssembly's bytes."""
    folder = resources.files("amulett_gym.live.core")
    return "\n".join(folder.joinpath(name).read_text("utf-8") for name in SCRIPTS)
