"""`amulett reproduce`: the paper's step responses, and every number of its Tables 2-5 beside ours."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from amulett_gym.cli.output import add_json, print_json, printer
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.writing import output_folder

HELP = "run what the paper measured, and compare Tables 2-5 with ours"
EXAMPLES = """  amulett reproduce --out runs/reproduction
  amulett reproduce --json
  amulett reproduce --doc docs/reproduction.md
  amulett reproduce --study runs/identify --out runs/mine
"""


STUDY = "study"
"""Folder of a reproduction for a copy of the study that it shows."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", metavar="DIR", help="folder for reproduction.html, its figures, JSON and CSV files")
    parser.add_argument("--doc", metavar="FILE.md", help="renew the generated part of a document, and its figures")
    parser.add_argument(
        "--study", metavar="DIR", help="devices that `amulett identify` wrote to a folder, instead of the shipped ones"
    )
    add_json(parser, "the content of reproduction.json")


def run(arguments: argparse.Namespace) -> int:
    """Reproduce, print the tables, and write the files."""
    from amulett_gym.reporting.document import check_document
    from amulett_gym.studies.paper.report import (
        MARKS,
        REPRODUCTION_MARKS,
        draw,
        in_words,
        write_document,
        write_numbers,
        write_pictures,
    )
    from amulett_gym.studies.paper.results import PARTS, content, gather
    from amulett_gym.studies.paper.study import read_study

    out = arguments.out
    study = None if arguments.study is None else read_study(arguments.study)
    if arguments.doc is not None:
        check_document(arguments.doc, [MARKS], images=True)
    with nullcontext(False) if out is None else output_folder(out, "reproduction", [REPRODUCTION_MARKS]) as earlier:
        with Progress(PARTS, "reproduce", "parts") as progress:
            evidence = gather(study, lambda part: progress.update(note=part))
        result = content(evidence) if out is None else write_numbers(evidence, out)
        if out is not None:
            _describe(out, arguments.study)
            figures = write_pictures(evidence, out)
        elif arguments.doc is not None:
            figures = draw(evidence)
    if arguments.doc is not None:
        write_document(evidence, figures, arguments.doc)
    if arguments.json:
        print_json(result)
    show = printer(arguments)
    show(in_words(evidence))
    if out is not None:
        replaced = ", instead of the reproduction that was there" if earlier else ""
        show(f"Written to {out}: reproduction.html, reproduction.json, CSV files and figures{replaced}.")
    if arguments.doc is not None:
        show(f"Renewed: {arguments.doc}")
    return 0


def _describe(out: str, study: str | None) -> None:
    """Write what `amulett rerun` needs: the command, and a copy of the study."""
    from amulett_gym.storage.provenance import write_provenance
    from amulett_gym.studies.paper.study import copy_study

    words = ["amulett", "reproduce", "--out", out]
    if study is not None:
        copy_study(study, Path(out) / STUDY)
        words += ["--study", study]
    write_provenance(out, "reproduce", {"study": study}, [], words)
