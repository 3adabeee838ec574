"""Friction of a Bowden cable: the capstan equation, with presliding by Dahl's model.

A string that slides through a bent sheath loses tension to friction: T_out = T_in exp(-mu theta) if T_in pulls it, and
T_out = T_in exp(mu theta) if it is pulled out against T_in. Between the two it sticks. The *loss* 1 - T_out/T_in is the
one state of a cable. While the string moves, the loss approaches that of sliding within the presliding length: the
string stretches and its contact gives way. A loss relative to the tension, unlike Dahl's force, needs no limit where
the tension falls, and a string without tension has no friction.
"""

from __future__ import annotations

import math

from amulett_gym.jit.compiled import compiled


@compiled
def sliding_loss(bend: float, pulled: bool) -> float:
    """Return 1 - T_out/T_in of a sliding string [1] by mu theta [1]; negative if it is pulled out against T_in."""
    return 1.0 - math.exp(-bend if pulled else bend)


@compiled
def next_loss(loss: float, bend: float, moved: float, presliding: float) -> float:
    """Return 1 - T_out/T_in [1] after the string has moved: exact for any way, so that every step is stable.

    Parameters
    ----------
    loss : float
        Before [1].
    bend : float
        mu theta [1].
    moved : float
        Motion of the string in the direction of T_in [m].
    presliding : float
        Way in which the difference to the loss of sliding falls to 37 % [m].
    """
    end = sliding_loss(bend, moved > 0.0)
    return loss + (end - loss) * (1.0 - math.exp(-abs(moved) / presliding))
