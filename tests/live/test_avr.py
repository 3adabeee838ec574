"""The firmware's hex file in JavaScript (`avr.py`) answers as it does in simavr."""

from __future__ import annotations

import shutil

import pytest
from live.avr import in_node, job_of, same

TOOLS = ("avr-gcc", "simavr", "node")


@pytest.mark.skipif(any(shutil.which(tool) is None for tool in TOOLS), reason=f"needs {', '.join(TOOLS)}")
def test_the_hex_file_answers_on_avr8js_as_in_simavr(tmp_path):
    job = job_of(tmp_path, 400)
    found = in_node(job)
    equal = same(job["exchanges"], found["answers"])
    assert len(equal) == 400 and all(equal)
    changed = [[*answer[:5], answer[5] ^ 1, *answer[6:]] if len(answer) > 20 else answer for answer in found["answers"]]
    assert not any(same(job["exchanges"], changed)[1:])  # what is compared can differ
