"""`amulett reproduce`: the paper's results next to ours."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from amulett_gym.cli.options import add_figures, add_json, add_options, command_words
from amulett_gym.cli.output import print_json, printer
from amulett_gym.reporting.progress import Progress
from amulett_gym.storage.writing import output_folder

HELP = "run the paper's experiments, and compare Tables 2-5 with ours"
EXAMPLES = """  amulett reproduce --out runs/reproduction
  amulett reproduce --json
  amulett reproduce --doc docs/reproduction.md
  amulett reproduce --study runs/identify --out runs/mine
"""

STUDY = "study"
"""Subfolder of a reproduction with a copy of its study."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--out", metavar="DIR", help="folder for reproduction.html, its figures, JSON and CSV files")
    add_options(parser, "--doc")
    parser.add_argument("--study", metavar="DIR", help="folder of `amulett identify`, instead of the shipped devices")
    add_figures(parser, into=("out", "doc"))
    add_json(parser, "the content of reproduction.json")


def run(arguments: argparse.Namespace) -> int:
    """Reproduce, print the tables, and write the files."""
    from amulett_gym.reporting.document import check_document
    from amulett_gym.studies.paper.own_study import read_study
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

    out = arguments.out
    study = None if arguments.study is None else read_study(arguments.study)
    if arguments.doc is not None:
        check_document(arguments.doc, [MARKS], images=True)
    with nullcontext(False) if out is None else output_folder(out, "reproduction", [REPRODUCTION_MARKS]) as earlier:
        with Progress(PARTS, "reproduce", "parts") as progress:
            evidence = gather(study, lambda part: progress.update(note=part))
        result = content(evidence) if out is None else write_numbers(evidence, out)
        if out is not None:
            _describe(arguments)
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
        replaced = ", instead of the earlier reproduction" if earlier else ""
        show(f"Written to {out}: reproduction.html, reproduction.json, CSV files and figures{replaced}.")
    if arguments.doc is not None:
        show(f"Renewed: {arguments.doc}")
    return 0


def _describe(arguments: argparse.Namespace) -> None:
    """Write what `amulett rerun` needs: the command, and a copy of the study."""
    from amulett_gym.storage.provenance import write_provenance
    from amulett_gym.studies.paper.own_study import copy_study

    out, study = arguments.out, arguments.study
    if study is not None:
        copy_study(study, Path(out) / STUDY)
    words = ["amulett", "reproduce", *command_words(arguments, "out", "study")]
    write_provenance(out, "reproduce", {"study": study}, [], words)
