"""The wearer's forearm: two muscles about the elbow, a passive joint, a reflex with delay, tremor.

Flexion is positive. Both muscles are Kawato's (Katayama and Kawato, 1993), lumped about the elbow: stiffness and
damping rise with the activation a, and a shifts the angle at which the muscle is at rest ::

    torque = K_f (r a_f - q) - K_e (r a_e + q) - (B_f + B_e) q',   K = k (tone + strength g a),  B likewise with b

with the joint angle q from the posture in which both are in balance. Co-contraction, a_f = a_e, gives
stiffness without torque there.

The elbow has no range of motion: no stops, and no passive stiffness that grows towards the ends. A person's range is
about 0 to 145 deg (from memory); the intentions of the suites stay between 0 and 90 deg.
"""

from __future__ import annotations

import math
from typing import Any

from amulett_gym.jit.compiled import compiled
from amulett_gym.model.plant import Numbers

STIFFNESS = 1.5
"""k of one muscle without activation [N m/rad]: 810.8 N/m (Katayama and Kawato, 1993), with lever arms of 25 mm (its
mono-articular muscle) and 35 mm (its bi-articular one), 810.8 (0.025^2 + 0.035^2)."""

DAMPING = 0.1
"""b of one muscle without activation [N m s/rad]: 54.1 N s/m with the same lever arms."""

ACTIVE_SHARE = 2.0
"""g [1]: 1621.6 N/m over 810.8 N/m; with tone and strength 1, full activation triples stiffness and damping."""

SHIFT = 0.87
"""r [rad]: the change of a muscle's rest length with full activation over its lever arm, 21.8 mm over 25 mm. assumed"""

ON_TIME = 0.025
OFF_TIME = 0.045
"""Time constants of the activation, rising and falling [s] (as coded publicly after Winters)."""

PASSIVE_DAMPING = 0.5
"""Of the relaxed elbow [N m s/rad] (MyoHub/myo_sim, myoelbow_assets.xml)."""

_MASS_SHARE, _CENTRE_SHARE, _GYRATION_SHARE, _LENGTH_SHARE = 0.022, 0.682, 0.827, 0.146
"""Forearm with hand: mass over that of the body; centre of mass and radius of gyration about the elbow over the length
of the forearm, elbow to wrist; that length over the body height (Winter, 2009, Table 4.1 and Figure 4.1)."""


def forearm(mass: Numbers, height: Numbers) -> tuple[Any, Any, Any]:
    """Return mass [kg], centre of mass from the elbow [m] and inertia about the elbow [kg m2] of forearm with hand.

    From body mass [kg] and height [m], of one or many people. 70 kg and 1.75 m give 1.54 kg, 0.174 m and 0.0688 kg m2.
    """
    length, own = _LENGTH_SHARE * height, _MASS_SHARE * mass
    return own, _CENTRE_SHARE * length, own * (_GYRATION_SHARE * length) ** 2


@compiled
def activation_rate(activation: float, excitation: float) -> float:
    """Return the rate of a muscle's activation [1/s]: a first-order lag of its excitation, both in [0, 1]."""
    return (excitation - activation) / (ON_TIME if excitation > activation else OFF_TIME)


@compiled
def muscle_torque(flexor: float, extensor: float, angle: float, velocity: float, tone: float, strength: float) -> float:
    """Return the torque of both muscles [N m].

    Parameters
    ----------
    flexor, extensor : float
        Activations a_f, a_e in [0, 1].
    angle, velocity : float
        Of the elbow, from the angle at which both muscles without activation are in balance [rad], [rad/s].
    tone, strength : float
        Factors of the relaxed muscles' and of the activation's stiffness and damping [1].
    """
    share = strength * ACTIVE_SHARE
    pull = STIFFNESS * (tone + share * flexor) * (SHIFT * flexor - angle)
    push = STIFFNESS * (tone + share * extensor) * (SHIFT * extensor + angle)
    return pull - push - muscle_damping(flexor, extensor, tone, strength) * velocity


@compiled
def muscle_stiffness(flexor: float, extensor: float, tone: float, strength: float) -> float:
    """Return the stiffness of both muscles about the elbow [N m/rad], minus the derivative of `muscle_torque`."""
    return STIFFNESS * (2.0 * tone + strength * ACTIVE_SHARE * (flexor + extensor))


@compiled
def muscle_damping(flexor: float, extensor: float, tone: float, strength: float) -> float:
    """Return the damping of both muscles about the elbow [N m s/rad]."""
    return DAMPING * (2.0 * tone + strength * ACTIVE_SHARE * (flexor + extensor))


@compiled
def excitations(torque: float, co_contraction: float, tone: float, strength: float) -> tuple[float, float]:
    """Return both muscles' excitations in [0, 1] for a torque [N m] in balance: the inverse of `muscle_torque` there.

    They differ from the co-contraction, in [0, 1], by as much up and down; if the antagonist would fall below 0, it is
    0. A torque beyond that of a fully active muscle is not reached.
    """
    share = strength * ACTIVE_SHARE
    wanted = min(abs(torque) / (STIFFNESS * SHIFT), tone + share)
    half = wanted / (2.0 * (tone + 2.0 * share * co_contraction))
    # One muscle alone: share a^2 + tone a = wanted.
    alone = 2.0 * wanted / (tone + math.sqrt(tone * tone + 4.0 * share * wanted))
    both = half <= co_contraction
    agonist = min(co_contraction + half if both else alone, 1.0)
    antagonist = co_contraction - half if both else 0.0
    return (agonist, antagonist) if torque >= 0.0 else (antagonist, agonist)
