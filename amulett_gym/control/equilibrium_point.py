"""Equilibrium-point control ([13] Muralidharan et al.): feed-forward alone, no feedback.

The drives turn together to where the strings hold the joint at its reference, and apart for the co-contraction. They
lead the reference by about their lag. Where the arm's weight leaves too little of the springs' force for the
co-contraction, that is lowered. Without feedback, an error of the model stays.
"""

from __future__ import annotations

from amulett_gym.jit.compiled import compiled


@compiled
def equilibrium(reference: float, rate: float, lead: float) -> float:
    """Return the joint angle [rad] at which the drives shall hold the joint.

    Parameters
    ----------
    reference, rate : float
        Reference of the joint angle [rad] and its rate [rad/s].
    lead : float
        Lead time [s].
    """
    return reference + lead * rate
