"""A table as text of 80 columns, Markdown, HTML or CSV."""

from __future__ import annotations

import csv
import io
import math
import re
import textwrap
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from amulett_gym.reporting.words import html, pretty

TEXT_WIDTH = 80
"""Columns of a terminal."""

_GAP = 2
_NARROW = 16
"""Least width of a column of words that had to be made narrower."""


@dataclass(frozen=True)
class Table:
    """A table with a title and a note, which may be empty.

    Attributes
    ----------
    head : tuple of str
        Headings of all columns; not shown if all are empty.
    rows : sequence of sequence of str
        Cells; in HTML all but `Markup` are escaped.
    left : collection of int
        Columns of words, aligned on the left and wrapped; the others are numbers.
    """

    title: str
    head: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""
    left: Collection[int] = (0,)

    def text(self, width: int = TEXT_WIDTH) -> str:
        """Return the title, the aligned table and the note, in lines of at most `width` characters.

        Lines are broken between words only. In a table that is too wide, headings are wrapped, then columns of words;
        if that is not enough, the remaining columns follow in blocks below, each with the first column repeated.
        """
        blocks = ["\n".join(self._block(columns, width)) for columns in self._blocks(width)]
        parts = [fill(self.title, width), "\n\n".join(blocks), fill(self.note, width)]
        return "\n".join(part for part in parts if part)

    def markdown(self) -> str:
        """Return the table as Markdown, under its title as a heading, with the note below."""
        rule = ["---" if k in self.left else "---:" for k in range(len(self.head))]
        lines = [[cell.replace("|", "\\|") for cell in line] for line in (self.head, rule, *self.rows)]
        body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return "\n\n".join(part for part in (self.title and f"### {self.title}", body, self.note) if part)

    def html(self, classes: str = "stack lines narrow") -> Markup:
        """Return the table and the note as HTML; `classes`: see ``page.css``. Narrow screens stack labelled cells."""
        words = [Markup(' class="words"') if k and k in self.left else "" for k in range(len(self.head))]
        labels = [
            Markup(' data-label="{}:"').format(pretty(cell)) if k and cell else "" for k, cell in enumerate(self.head)
        ]
        head = _joined("<th{}>{}</th>", zip(words, map(_heading, self.head), strict=True))
        rows = ([_joined("<td{}{}>{}</td>", zip(words, labels, map(html, row), strict=True))] for row in self.rows)
        body = _joined("<tr>{}</tr>\n", rows)
        table = Markup(
            '<div class="scroll"><table class="{}">\n<thead><tr>{}</tr></thead>\n<tbody>\n{}</tbody></table></div>'
        ).format(classes, head, body)
        return table + (Markup("\n<p>{}</p>").format(html(self.note)) if self.note else Markup(""))

    def csv(self) -> str:
        """Return headings and rows as CSV."""
        return csv_text(self.head, self.rows)

    def _cells(self, column: int) -> list[str]:
        return [str(row[column]) for row in self.rows]

    def _widths(self, columns: Sequence[int], width: int) -> list[int]:
        """Return the widths of columns: with the fewest lines of headings that fit, then with narrower words."""
        room = width - _GAP * (len(columns) - 1)
        longest = [max((len(cell) for cell in self._cells(k)), default=0) for k in columns]
        widths: list[int] = []
        for lines in range(1, 7):
            heads = [_narrowest(self.head[k], lines) for k in columns]
            widths = [max(pair) for pair in zip(longest, heads, strict=True)]
            if sum(widths) <= room:
                return widths
        narrowest = [
            min(width, max(_NARROW, *map(_longest_word, (self.head[k], *self._cells(k))))) if k in self.left else width
            for k, width in zip(columns, widths, strict=True)
        ]
        while sum(widths) > room and widths != narrowest:
            place = max(range(len(widths)), key=lambda place: widths[place] - narrowest[place])
            widths[place] -= 1
        return widths

    def _blocks(self, width: int) -> list[list[int]]:
        """Return the columns of each block."""
        first, *others = range(len(self.head))
        blocks = [[first]]
        for column in others:
            columns = [*blocks[-1], column]
            if len(columns) > 2 and sum(self._widths(columns, width)) + _GAP * (len(columns) - 1) > width:
                blocks.append([first, column])
            else:
                blocks[-1] = columns
        return blocks

    def _block(self, columns: Sequence[int], width: int) -> list[str]:
        widths = self._widths(columns, width)
        lines: list[str] = []
        if any(self.head[k] for k in columns):
            heads = [_wrap(self.head[k], size) for k, size in zip(columns, widths, strict=True)]
            height = max(map(len, heads))
            lines += self._lines([[""] * (height - len(head)) + head for head in heads], columns, widths)
            lines.append("-" * (sum(widths) + _GAP * (len(columns) - 1)))
        for row in self.rows:
            cells = [
                _wrap(str(row[k]), size) if k in self.left else [str(row[k])]
                for k, size in zip(columns, widths, strict=True)
            ]
            height = max(map(len, cells))
            lines += self._lines([cell + [""] * (height - len(cell)) for cell in cells], columns, widths)
        return lines

    def _lines(self, cells: list[list[str]], columns: Sequence[int], widths: Sequence[int]) -> list[str]:
        return [
            (" " * _GAP)
            .join(
                word.ljust(width) if k in self.left else word.rjust(width)
                for k, word, width in zip(columns, words, widths, strict=True)
            )
            .rstrip()
            for words in zip(*cells, strict=True)
        ]


def csv_text(head: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV with a header; None and NaN are empty, floats have all their digits."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow("" if isinstance(cell, float) and math.isnan(cell) else cell for cell in row)
    return buffer.getvalue()


def _heading(text: str) -> Markup:
    """Return a heading with its unit below it."""
    name, bracket, unit = text.partition(" [")
    return html(name) + (
        Markup('<span class="unit">{}</span>').format(pretty(unit.removesuffix("]"))) if bracket else ""
    )


def _joined(template: str, items: Iterable[Iterable[str]]) -> Markup:
    return Markup("").join(Markup(template).format(*item) for item in items)


def fill(text: str, width: int = TEXT_WIDTH) -> str:
    """Return a text wrapped between words; line breaks and the lines' indentation are kept."""
    return "\n".join("\n".join(_wrap(line, width)) for line in text.split("\n"))


def _wrap(text: str, width: int) -> list[str]:
    """Return a text's lines; neither words nor texts in brackets are cut."""
    indent = text[: len(text) - len(text.lstrip(" "))]
    kept = re.sub(r"\[[^\]]*\]", lambda match: match[0].replace(" ", "\0"), text)
    lines = textwrap.wrap(kept, max(width, 1), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines] or [""]


def _longest_word(text: str) -> int:
    return max(map(len, _wrap(text, 1)))


def _narrowest(text: str, lines: int) -> int:
    """Return the least width for at most this number of lines."""
    widths = range(_longest_word(text), len(text) + 1)
    return next((width for width in widths if len(_wrap(text, width)) <= lines), 0)
