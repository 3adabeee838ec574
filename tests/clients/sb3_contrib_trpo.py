"""sb3-contrib's TRPO on the native vector environment."""

from __future__ import annotations

from functools import partial

from judging import run
from sb3 import train
from sb3_contrib import TRPO

if __name__ == "__main__":
    run(partial(train, TRPO), 100_000)
