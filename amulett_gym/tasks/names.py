"""Names of suites in the environments without a wearer."""

from __future__ import annotations

from typing import Any

from amulett_gym.errors import AmulettError, unknown
from amulett_gym.tasks.suites import suite_names
from amulett_gym.tasks.worn_suites import WORN_SUITES


def check_suite(name: Any) -> str:
    """Return a suite's name.

    Raises
    ------
    AmulettError
        If there is no such suite, or it is one of `Amulett/Worn-v0`: it then says what to use.
    """
    if isinstance(name, str) and name in suite_names():
        return name
    if isinstance(name, str) and name in WORN_SUITES:
        raise AmulettError(
            f"'{name}' is a suite of Amulett/Worn-v0 alone, in which a person wears the device: make that environment, "
            "compare its laws and policies by 'amulett wearer', or train in it by 'amulett train --config "
            f"configs/worn.yaml'; suites without a wearer are {', '.join(sorted(suite_names()))}"
        )
    raise unknown("suite", str(name), suite_names())
