"""Minimal motion ([8] Huang et al., their second approach): the least motion of the drives that gives a torque.

With the torque fixed, the drive angles that give it are a curve: one pair for each co-contraction. Of the pairs with at
least the co-contraction asked for, each drive goes to the pair nearest to where both are (according to their model).
The torque, the co-contraction that it leaves, and the low level that moves the drives, are those of
`control.computed_torque`. Strings once tight stay tight until the motion lets them go: softening alone is a motion that
is not needed. The encoder's noise moves the pair to and fro, and of each such motion a little goes towards softer: at
rest the co-contraction drifts slowly down to the one asked for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.spring import find_positions, look_up, look_up_curve

STEPS = 3
_LEAST = 0.3, 1e-9  # of a curvature, so that a step goes towards the minimum; of a squared slope [N2], if slack


@compiled
def nearest_pair(
    force_table: NDArray[np.float64],
    position_table: NDArray[np.float64],
    difference: float,
    least: float,
    max_force: float,
    biceps: float,
    triceps: float,
) -> tuple[float, float]:
    """Return the deflections of biceps and triceps, nearest to given ones, that give a difference of forces.

    With positions y in the force table, half the squared distance is least on the curve ``f(y_g) - f(y_a) = |dF|`` of
    agonist and antagonist where the slope of ``((y_a - y_a0)^2 + (y_g - y_g0)^2)/2 + mu (f(y_g) - f(y_a) - |dF|)`` is
    zero. Three of Newton's steps for both positions and mu find it to 1e-8 of the table's range if the pair moves by a
    hundredth of that, and to about a hundredth if drives that lag far behind have let a string go slack. The
    antagonist's force, limited, and the difference then give the pair, so that the torque is exact in any case.

    Parameters
    ----------
    force_table, position_table : ndarray
        f and its inverse (`model.spring.find_position`).
    difference : float
        dF, force of the biceps minus that of the triceps [N]; limited to ``max_force - least``.
    least : float
        Smallest force of the antagonist [N], 0 to `max_force`.
    max_force : float
        Force at which the springs saturate [N].
    biceps, triceps : float
        Given deflections as shares of the table's; negative if slack.
    """
    apart = min(abs(difference), max_force - least)
    flexes = difference >= 0.0
    near_agonist = biceps if flexes else triceps
    near_antagonist = triceps if flexes else biceps
    # From slack or far beyond the table the middle is nearer to the curve. A branch would prevent vectorisation.
    middle = 0.5 * (near_agonist + near_antagonist)
    outside = max(abs(near_agonist - 0.5), abs(near_antagonist - 0.5)) - 0.5
    share = min(max(20.0 * outside, 0.0), 1.0)
    antagonist = min(max(near_antagonist + share * (middle - near_antagonist), 0.0), 1.0)
    agonist = min(max(near_agonist + share * (middle - near_agonist), 0.0), 1.0)
    multiplier = 0.0
    for _ in range(STEPS):
        pull, slope, bend = look_up_curve(force_table, antagonist)
        agonist_pull, agonist_slope, agonist_bend = look_up_curve(force_table, agonist)
        share = 1.0 / max(1.0 - multiplier * bend, _LEAST[0])
        agonist_share = 1.0 / max(1.0 + multiplier * agonist_bend, _LEAST[0])
        far, agonist_far = antagonist - near_antagonist, agonist - near_agonist
        lack = agonist_pull - pull - apart
        lack += share * slope * far - agonist_share * agonist_slope * agonist_far
        multiplier = lack / max(share * slope * slope + agonist_share * agonist_slope * agonist_slope, _LEAST[1])
        antagonist = min(max(antagonist - share * (far - multiplier * slope), 0.0), 1.0)
        agonist = min(max(agonist - agonist_share * (agonist_far + multiplier * agonist_slope), 0.0), 1.0)
    tension = min(max(look_up(force_table, antagonist), least), max_force - apart)
    antagonist, agonist = find_positions(force_table, position_table, tension, tension + apart)
    return agonist if flexes else antagonist, antagonist if flexes else agonist
