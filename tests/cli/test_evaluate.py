"""`amulett evaluate` in a process of its own: nothing of the environment keeps it from writing its report."""

import json
import os
import subprocess
import sys

INLINE = "module://matplotlib_inline.backend_inline"  # what a notebook leaves in the environment of its shells


def test_a_backend_that_is_not_installed_loses_nothing(tmp_path):
    words = [*("evaluate", "--policies", "eq6", "--episodes", "1"), "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "amulett_gym", *words],
        env=os.environ | {"MPLBACKEND": INLINE},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "eq6" in json.loads((tmp_path / "results.json").read_text())["policies"]
    assert {"report.html", "cost.png", "responses.png"} <= {path.name for path in tmp_path.iterdir()}
