"""The tables' notes in the document are those that the code writes."""

from __future__ import annotations

from pathlib import Path

from amulett_gym.reporting.words import pretty
from amulett_gym.studies.benchmark.claims import Claim
from amulett_gym.studies.benchmark.tables import claims_table, references

DOCUMENT = (Path(__file__).parents[3] / "docs" / "benchmark.md").read_text()


def test_counts_are_whole_numbers():
    claims = [Claim("devices", "a count", 5, None, None, True), Claim("devices", "a ratio", 0.5, 0.4, 1.0, False)]
    assert [row[2:5] for row in claims_table(claims).rows] == [["5", "", "yes"], ["0.500", "[0.400, 1.00]", "NO"]]


def test_the_note_on_references_says_first_which_columns_cannot_be_compared():
    found = {"clairvoyant": {}, "foresight": {}, "causal": {}, "from": "parametric"}
    note = references({"best_learned": "ppo", "references": found}).note
    assert note.startswith('In the row foresight, "cost" is with the scenarios\' own sensor noise')
    assert pretty(note) in DOCUMENT
