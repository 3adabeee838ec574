"""The files of a reproduction: numbers, figures, a page that needs nothing else, and a document's generated part."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from amulett_gym.storage.writing import after_results, write_json, write_text
from amulett_gym.studies.paper import document
from amulett_gym.studies.paper.evidence import Evidence
from amulett_gym.studies.paper.figures import CAPTIONS, paper_figures
from amulett_gym.studies.paper.page import render
from amulett_gym.studies.paper.results import as_csv, content, readings_content, rows_content

if TYPE_CHECKING:
    from amulett_gym.reporting.style import Figure

REPRODUCTION_MARKS = ("reproduction.json",)
"""The file by which a reproduction's folder is recognised: the first that is written."""


def draw(evidence: Evidence) -> dict[str, Figure]:
    """Return the paper's figures on our devices, by the names of `figures.CAPTIONS`."""
    return paper_figures(evidence.reproduction.profiles, evidence.reproduction.readings)


def write_numbers(evidence: Evidence, folder: str | Path) -> dict[str, Any]:
    """Write ``reproduction.json`` and the CSV files into a folder, before anything is drawn.

    Each file is written whole or not at all. A folder in which only some have been written, because the process was
    killed, is recognised and can be used again.

    Parameters
    ----------
    evidence : Evidence
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
    write_json(folder / "reproduction.json", result)
    write_text(folder / "rows.csv", as_csv(rows_content(evidence, result)))
    write_text(folder / "readings.csv", as_csv(readings_content(reproduction)))
    write_text(folder / "claims.csv", as_csv(result["claims"]))
    return result


def write_pictures(evidence: Evidence, folder: str | Path) -> dict[str, Figure]:
    """Draw the figures, and write them and ``reproduction.html`` into the folder of the numbers.

    Returns
    -------
    dict of str to Figure
        From `draw`.

    Raises
    ------
    AmulettError
        If a file cannot be written.
    """
    from amulett_gym.reporting.style import save_figures

    with after_results(f"reproduction.json and CSV files in {folder}"):
        figures = draw(evidence)
        save_figures(figures, Path(folder))
        write_text(Path(folder) / "reproduction.html", render(evidence, figures))
    return figures


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
    from amulett_gym.reporting.style import save_figures

    path = Path(path)
    text = document.block(evidence, {f"{document.IMAGES}/{name}.png": caption for name, caption in CAPTIONS.items()})
    document.update(path, text)
    save_figures(figures, path.parent / document.IMAGES)
