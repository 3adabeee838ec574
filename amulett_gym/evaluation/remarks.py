"""What a reader has to know about results on a device of one's own: printed once, and kept with the results."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

from amulett_gym.envs.action import TENSION_RANGE
from amulett_gym.envs.reward import divisors_owner
from amulett_gym.evaluation.diagnosis import diagnose
from amulett_gym.laws.parametric import tuned_names
from amulett_gym.profile import Profile, is_shipped


def device_remarks(
    profile: Profile, contenders: Iterable[str] = (), tension_range: tuple[float, float] = TENSION_RANGE
) -> list[str]:
    """Return remarks on a device of one's own: borrowed divisors and parameters, and what `diagnose` finds.

    Parameters
    ----------
    profile : Profile
    contenders : iterable of str
        Names of what acts on it.
    tension_range : tuple of float
        Tension setpoint at action -1 and +1 [N].

    Returns
    -------
    list of str
        Sentences without a full stop; none for a shipped device.
    """
    if is_shipped(profile):
        return []
    owner = divisors_owner(profile)
    remarks = [
        f"costs on the {profile.name} are divided by what eq6 costs on the {owner}, so eq6's own need not be about 1, "
        "and a term whose cost is small here, often the effort, hardly counts"
    ]
    tuned = [name for name in contenders if name in tuned_names()]
    if tuned:
        act = "act" if len(tuned) > 1 else "acts"
        remarks.append(f"{', '.join(tuned)} {act} with the parameters tuned on the {owner}, not on the {profile.name}")
    return remarks + [f"on the {profile.name}, {finding.text}" for finding in diagnose(profile, tension_range)]


def print_remarks(remarks: Sequence[str]) -> None:
    """Print remarks on stderr, one a line."""
    for remark in remarks:
        print(f"Note: {remark}.", file=sys.stderr, flush=True)
