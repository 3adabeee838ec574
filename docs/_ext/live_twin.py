"""The live twin of the first page: one HTML file, as `amulett live` writes it."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from sphinx.application import Sphinx

from amulett_gym.cli import main


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("build-finished", write, priority=100)  # before the site is checked
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write(app: Sphinx, error: Exception | None) -> None:
    """Write ``twin.html`` beside the pages."""
    if error is None and app.builder.format == "html":
        file = Path(app.outdir) / "twin.html"
        with redirect_stdout(StringIO()):
            failed = main(["live", "--out", str(file), "--no-open"])
        if failed:
            raise RuntimeError(f"amulett live did not write {file}")
