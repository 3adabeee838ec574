"""The console script `amulett`. Each command is a module, which imports large packages only when it runs."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import difflib
import gc
import os
import re
import sys
import textwrap
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from amulett_gym.cli.options import check_figures
from amulett_gym.errors import AmulettError, nearest
from amulett_gym.jit.notice import announce_compilation
from amulett_gym.reporting.figure_files import figures_as

COMMANDS = (
    *("quickstart", "train", "tune", "clone", "tune-law", "evaluate", "benchmark", "rerun", "simulate"),
    *(
        "play",
        "live",
        "record",
        "loops",
        "wearer",
        "reproduce",
        "identify",
        "fit",
        "config",
        "log",
        "check",
        "list",
        "bench",
        "export",
        "hil",
    ),
)

_EXAMPLES = "examples:"


class Formatter(argparse.HelpFormatter):
    """Wraps all text; a long example continues on the next line after a backslash."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if not text.startswith(_EXAMPLES):
            return super()._fill_text(text, width, indent)
        lines = (_wrap(re.sub(r"(?<=\S) (?!--)", "\0", line), width - 2, "      ") for line in text.splitlines())
        return "\n".join(" \\\n".join(line) for line in lines).replace("\0", " ")

    def _split_lines(self, text: str, width: int) -> list[str]:
        return _wrap(" ".join(text.split()), width)


def _wrap(text: str, width: int, indent: str = "") -> list[str]:
    """Return lines that break only at spaces; names stay whole."""
    return textwrap.wrap(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors suggest the nearest valid word; no option may be shortened."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(allow_abbrev=False, **keywords)

    _words: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and store the words: an error may name one that argparse did not reach."""
        self._words = sys.argv[1:] if args is None else args
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print the usage and the message with a suggestion, and exit with 2."""
        self.print_usage(sys.stderr)
        self.exit(2, f"{self.prog}: error: {message}{self._suggestion(message)}\n")

    def _suggestion(self, message: str) -> str:
        if message.startswith("unrecognized arguments: "):
            return self._nearest_option(message.removeprefix("unrecognized arguments: ").split()[0])
        if message.startswith("the following arguments are required: "):
            options = (word for word in self._words if word.startswith("--") and word != "--")
            unknown = [word for word in options if word.split("=")[0] not in self._option_string_actions]
            return f"; unrecognized: {unknown[0]}{self._nearest_option(unknown[0])}" if unknown else ""
        if "invalid choice: '" in message:
            word = message.split("invalid choice: '")[1].split("'")[0]
            choices = [str(choice) for action in self._actions for choice in action.choices or ()]
            return nearest(word, choices)
        return ""

    def _nearest_option(self, word: str) -> str:
        """Suggest only an option that is very similar: all of them share their dashes."""
        close = difflib.get_close_matches(word.split("=")[0], self._option_string_actions, n=1, cutoff=0.7)
        return f"; did you mean '{close[0]}'?" if close else ""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; the command's own parser reports unknown words."""
        arguments, unknown = self.parse_known_args(args, namespace)
        if unknown:
            getattr(arguments, "parser", self).error(f"unrecognized arguments: {' '.join(unknown)}")
        return arguments


def build_parser() -> Parser:
    """Return the parser of all commands."""
    parser = Parser(
        prog="amulett",
        description="Learn how stiff an antagonistic joint should be, moment by moment.",
        epilog="Start with: amulett quickstart",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command")
    for name in COMMANDS:
        module = import_module(f"amulett_gym.cli.{name.replace('-', '_')}")
        command = commands.add_parser(
            name,
            help=module.HELP,
            description=module.HELP,
            epilog=f"{_EXAMPLES}\n{module.EXAMPLES.rstrip()}",
            formatter_class=Formatter,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run, parser=command)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command in `argv`, the words after ``amulett`` (those of the process if None), and return its exit code.

    It is 0 for success, 1 if a check failed or training diverged, 2 for wrong input, 130 if interrupted, and 141 if the
    reader of the output is gone.
    """
    if argv is None:  # the process ends with it, and would first search for garbage, up to a second
        atexit.register(gc.freeze)
    try:
        return _run(argv)
    except AmulettError as error:
        print(f"amulett: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("amulett: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # of `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python reports it at its exit
        return 141
    except OSError as error:  # one that no reader or writer of ours describes
        where = "" if error.filename is None else f" '{error.filename}'"
        print(f"amulett: error: the system refuses{where}: {error.strerror or error}", file=sys.stderr)
        with contextlib.suppress(OSError):  # else Python tries again at its exit
            sys.stdout.close()
        return 2


def _home(word: str) -> str:
    """Return a word of the command line with the ``~`` of ``~/x`` and ``--out=~/x`` expanded."""
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    return option + equals + os.path.expanduser(value)  # noqa: PTH111  (text stays text)


def _run(argv: Sequence[str] | None) -> int:
    parser = build_parser()
    try:
        arguments = parser.parse_args([_home(word) for word in (sys.argv[1:] if argv is None else argv)])
    finally:
        sys.stdout.flush()  # a help
    if arguments.version:
        from importlib.metadata import version

        print(f"amulett-gym {version('amulett-gym')}")
        return 0
    if arguments.command is None:
        parser.print_help()
        return 2
    check_figures(arguments)
    announce_compilation(lambda text: print(text, file=sys.stderr, flush=True))
    with figures_as(getattr(arguments, "format", None), getattr(arguments, "columns", None)):
        code = int(arguments.run(arguments))
    sys.stdout.flush()
    return code
