"""Measure the page's frames: ``python tests/live/frames.py [SECONDS]``, on Linux.

Chromium runs on one core, without a graphics card. Printed are the frames in a second; the time on a core that the
browser takes for one (simulation of both arms, drawing, painting), which other programs hardly change; and how much of
it is the page's own script. With 16.7 ms or less there can be 60 frames in a second.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from live.browser import Page, chromium

from amulett_gym.live.page import build_page


def main(seconds: float) -> None:
    """Print what was measured."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "live.html"
        path.write_text(build_page(), encoding="utf-8")
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # the browser inherits it
        with chromium() as driver:
            page = Page(driver, path)
            page.resize(1440, 900)
            page.open(still=False)
            time.sleep(2.0)
            page.run("app.durations.length = 0; globalThis.began = performance.now()")
            before = used(os.getpid())
            time.sleep(seconds)
            busy = used(os.getpid()) - before
            passed, durations = page.run("return [(performance.now() - globalThis.began) / 1000, app.durations]")
    count, ordered = len(durations), sorted(durations)
    print(f"{count / passed:.1f} frames/s over {passed:.1f} s on one core, 1440 x 900 pixels")
    print(f"{1000 * busy / count:.1f} ms of a core for a frame, {ordered[count // 2]:.1f} ms (median) of it script")


def used(root: int) -> float:
    """Return the time on a core [s] that the descendants of a process have used."""
    parents, times = {}, {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = place.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        process = int(place.parent.name)
        parents[process], times[process] = int(fields[1]), int(fields[11]) + int(fields[12])
    family = {root}
    while more := {process for process, parent in parents.items() if parent in family} - family:
        family |= more
    return sum(times[process] for process in family - {root} if process in times) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 8.0)
