"""`amulett wearer`: when stiffness matters to the wearer of an exoskeleton."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from amulett_gym.cli.options import add_figures, add_json, add_options, command_words
from amulett_gym.cli.output import print_json, printer

HELP = "measure when stiffness matters to a wearer: headroom, tuned baselines, policies; resumes by itself"
EXAMPLES = """  amulett wearer --quick
  amulett wearer --config configs/wearer.yaml --out runs/wearer
  amulett wearer --out runs/wearer --policy runs/worn --doc docs/wearer.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--config", metavar="FILE", help="description in YAML (default: as configs/wearer.yaml)")
    parser.add_argument("--quick", action="store_true", help="a test of seconds: one loop, few wearers, tiny searches")
    policy = "learned policy of Amulett/Worn-v0 to compare, also its training run; may be repeated"
    parser.add_argument("--policy", metavar="FOLDER", action="append", default=[], help=policy)
    parser.add_argument("--out", metavar="DIR", help="folder; finished stages in it are not repeated")
    add_options(parser, "--doc")
    add_figures(parser, into=("out", "doc"))
    add_json(parser, "the content of results.json")
    parser.set_defaults(resolved=None)  # settings of a folder, for `amulett rerun`


def run(arguments: argparse.Namespace) -> int:
    """Run the stages that are not finished, print the tables, and write the files."""
    from amulett_gym.reporting.document import check_document, image, marks, update_document
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.reporting.style import save_figures
    from amulett_gym.storage.provenance import machine, write_provenance
    from amulett_gym.storage.writing import output_folder, write_json, write_text
    from amulett_gym.studies.wearer import description as described
    from amulett_gym.studies.wearer.comparison import load_learned
    from amulett_gym.studies.wearer.figures import CAPTIONS, draw
    from amulett_gym.studies.wearer.results import content
    from amulett_gym.studies.wearer.study import parts
    from amulett_gym.studies.wearer.study import run as run_study
    from amulett_gym.studies.wearer.tables import answer, tables

    own = marks("amulett wearer")
    if arguments.doc is not None:
        check_document(arguments.doc, [own], images=True)
    if arguments.resolved is None:
        description = described.load_description(arguments.config)
        description = described.quick(description) if arguments.quick else description
    else:
        description = described.Description.model_validate(arguments.resolved["description"])
    policies = [load_learned(name, description.device()) for name in described.distinct(arguments.policy)]
    words = ["amulett", "wearer", *command_words(arguments, "config", "quick")]
    words += [word for name in arguments.policy for word in ("--policy", name)]
    out, marked = arguments.out, [["results.json"], ["command.json"]]
    with nullcontext() if out is None else output_folder(out, "study of wearers", marked):
        if out is not None:
            config = {"description": description.model_dump(mode="json"), "policies": arguments.policy}
            write_provenance(out, "wearer", config, [description.seed], words)
        with Progress(parts(description, policies), "wearer", "parts") as progress:
            folder = None if out is None else Path(out)
            study = run_study(description, policies, folder, lambda part: progress.update(note=part))
        found = {"command": " ".join(words), "machine": machine(), **content(study)}
        shown, lines = tables(found), answer(found)
        figures = {} if out is None and arguments.doc is None else draw(found)
        page = "\n\n".join(["\n".join(f"- {line}" for line in lines), *(table.markdown() for table in shown.values())])
        if out is not None:
            write_json(Path(out) / "results.json", found)
            write_text(Path(out) / "tables.md", f"{page}\n")
            save_figures(figures, Path(out))
    if arguments.doc is not None:
        pictures = "\n\n".join(image(name, CAPTIONS[name]) for name in figures)
        text = f"`{' '.join(words)}` on {machine()}\n\n{page}\n\n{pictures}"
        update_document(arguments.doc, {own: text}, figures)
    if arguments.json:
        print_json(found)
    show = printer(arguments)
    for line in lines:
        show(line.replace("**", ""))
    for table in shown.values():
        show(f"\n{table.text()}", wrap=False)
    for option in ("out", "doc"):
        if getattr(arguments, option) is not None:
            show(f"Written to {getattr(arguments, option)}.")
    return 0
