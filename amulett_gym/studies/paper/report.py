"""The files of a reproduction: numbers, figures, a page that needs nothing else, and a document's generated part."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from amulett_gym.evaluation.plots import save_figure
from amulett_gym.storage.writing import write_json, write_text
from amulett_gym.studies.paper import document
from amulett_gym.studies.paper.evidence import Evidence
from amulett_gym.studies.paper.figures import CAPTIONS, paper_figures
from amulett_gym.studies.paper.page import render
from amulett_gym.studies.paper.results import as_csv, content, readings_content, rows_content

REPRODUCTION_MARKS = ("reproduction.json",)
"""The file by which a reproduction's folder is recognised: the first that is written."""


def draw(evidence: Evidence) -> dict[str, Figure]:
    """Return the paper's figures on our devices, by the names of `figures.CAPTIONS`."""
    return paper_figures(evidence.reproduction.profiles, evidence.reproduction.readings)


def write_report(evidence: Evidence, figures: Mapping[str, Figure], folder: str | Path) -> dict[str, Any]:
    """Write ``reproduction.json``, CSV files, the figures and ``reproduction.html`` into a folder.

    Everything but the figures' files is made before the first file is written, and each is written whole or not at all.
    A folder in which only some have been written, because the process was killed, is recognised and can be used again.

    Parameters
    ----------
    evidence : Evidence
    figures : mapping of str to Figure
        From `draw`.
    folder : str or Path
        ``rows.csv`` has the rows with their spread and nearest reading, ``readings.csv`` every row under every reading,
        ``claims.csv`` the paper's claims.

    Returns
    -------
    dict
        The content of ``reproduction.json``.

    Raises
    ------
    AmulettError
        If a file cannot be written.
    """
    folder, reproduction = Path(folder), evidence.reproduction
    result = content(evidence)
    page = render(evidence, figures)
    write_json(folder / "reproduction.json", result)
    write_text(folder / "rows.csv", as_csv(rows_content(evidence, result)))
    write_text(folder / "readings.csv", as_csv(readings_content(reproduction)))
    write_text(folder / "claims.csv", as_csv(result["claims"]))
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    write_text(folder / "reproduction.html", page)
    return result


def write_document(evidence: Evidence, figures: Mapping[str, Figure], path: str | Path) -> None:
    """Renew the generated part of a document, and its figures in a folder beside it (`document.IMAGES`).

    Parameters
    ----------
    evidence : Evidence
    figures : mapping of str to Figure
        From `draw`.
    path : str or Path

    Raises
    ------
    AmulettError
        If a file cannot be read or written, or the document has no place for what is generated.
    """
    path = Path(path)
    text = document.block(evidence, {f"{document.IMAGES}/{name}.png": caption for name, caption in CAPTIONS.items()})
    document.update(path, text)
    for name, figure in figures.items():
        save_figure(figure, path.parent / document.IMAGES / f"{name}.png")
