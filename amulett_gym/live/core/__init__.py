"""The simulation in a browser: the control tick as WebAssembly, what is around it in JavaScript."""

from __future__ import annotations

from importlib import resources

AVR8JS, AVR8JS_LICENCE = "vendor/avr8js.min.js", "vendor/avr8js.LICENSE"
"""avr8js 0.21.1, the package of that name on npm (its archive has the SHA-512
``lS1vPaB0gB2GXoPrHFQOUG/5CRORjvnmjbs8SiPZdJpt4HkV0+v6HnNeXxo/X9lPqumqphls2Qyql8zsw9rBaw==``). esbuild 0.25.0 has
bundled what `chip.js` needs of it: ``echo 'export { CPU, AVRUSART, avrInstruction, usart0Config } from "avr8js"' |
esbuild --bundle --minify --format=iife --global-name=avr8js --target=es2022 --legal-comments=none``."""

SCRIPTS = ("base.js", "records.js", "laws.js", "policy.js", "chip.js", "firmware.js", "arm.js", "core.js")
"""Classic scripts, in this order."""


def script() -> str:
    """Return the scripts as one: it sets ``globalThis.Amulett``, whose ``load`` takes the WebAssembly's bytes."""
    avr8js = f"/*! avr8js\n{_read(AVR8JS_LICENCE)}*/\n{_read(AVR8JS)}"
    return "\n".join([avr8js, *(_read(name) for name in SCRIPTS)])


def _read(name: str) -> str:
    return resources.files("amulett_gym.live.core").joinpath(name).read_text("utf-8")
