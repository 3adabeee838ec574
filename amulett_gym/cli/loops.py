"""`amulett loops`: the control loops on the paper's step."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from amulett_gym.cli.options import add_figures, add_json, add_options, check_least, command_words
from amulett_gym.cli.output import print_json, printer

HELP = "compare the control loops on the paper's step"
EXAMPLES = """  amulett loops --out runs/loops
  amulett loops --profile configs/my_device.yaml --out runs/loops
  amulett loops --doc docs/loops.md
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_options(parser, "--profile")
    parser.add_argument("--episodes", type=int, default=20, help="repetitions with other sensor noise (default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first repetition (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for loops.json and figures")
    add_options(parser, "--doc")
    add_figures(parser, into=("out", "doc"))
    add_json(parser, "the content of loops.json")
    parser.set_defaults(resolved=None)  # settings of a folder, for `amulett rerun`


def run(arguments: argparse.Namespace) -> int:
    """Play, print the table, and write the files."""
    from amulett_gym.profile import load_profile
    from amulett_gym.reporting.document import check_document, marks, update_document
    from amulett_gym.reporting.progress import Progress
    from amulett_gym.reporting.style import save_figures
    from amulett_gym.storage.provenance import machine, write_provenance
    from amulett_gym.storage.writing import output_folder, write_json
    from amulett_gym.studies.loops.figures import draw
    from amulett_gym.studies.loops.study import measure, parts, table

    check_least(arguments, episodes=1, seed=0)
    own = marks("amulett loops")
    if arguments.doc is not None:
        check_document(arguments.doc, [own], images=True)
    profile = load_profile(arguments.profile if arguments.resolved is None else arguments.resolved["profile"])
    words = ["amulett", "loops", *command_words(arguments, "profile", "episodes", "seed")]
    out, marked = arguments.out, [["loops.json"]]
    with nullcontext() if out is None else output_folder(out, "comparison of loops", marked):
        with Progress(parts(profile), "loops", "parts") as progress:
            study = measure(profile, arguments.episodes, arguments.seed, lambda part: progress.update(note=part))
        found, figures = study.content(), {} if out is None and arguments.doc is None else draw(study)
        if out is not None:
            write_json(Path(out) / "loops.json", found)
            config = {key: getattr(arguments, key) for key in ("episodes", "seed")}
            config = {"profile": profile.model_dump(mode="json"), **config}
            write_provenance(out, "loops", config, [arguments.seed], words)
            save_figures(figures, Path(out))
    shown = table(study)
    if arguments.doc is not None:
        text = f"`{' '.join(words)}` on {machine()}\n\n{shown.markdown()}"
        update_document(arguments.doc, {own: text}, figures)
    if arguments.json:
        print_json(found)
    show = printer(arguments)
    show(shown.text(), wrap=False)
    for option in ("out", "doc"):
        if getattr(arguments, option) is not None:
            show(f"Written to {getattr(arguments, option)}.")
    return 0
