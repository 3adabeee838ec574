"""The tables' notes in the document are those that the code writes."""

from __future__ import annotations

from pathlib import Path

from amulett_gym.reporting.words import pretty
from amulett_gym.studies.benchmark.tables import references

DOCUMENT = (Path(__file__).parents[3] / "docs" / "benchmark.md").read_text()


def test_the_note_on_references_says_first_which_columns_cannot_be_compared():
    found = {"clairvoyant": {}, "foresight": {}, "causal": {}, "from": "parametric"}
    note = references({"best_learned": "ppo", "references": found}).note
    assert note.startswith('In the row foresight, "cost" is with the scenarios\' own sensor noise')
    assert pretty(note) in DOCUMENT
