"""A wearer in a scenario: who is in the exoskeleton, and how they move. What they intend are the scenario's moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from amulett_gym.errors import AmulettError
from amulett_gym.model.plant import GRAVITY
from amulett_gym.model.wearer import forearm
from amulett_gym.settings import Group
from amulett_gym.simulation.worn_layout import DELAY, PERSON, put


class Wearer(Group):
    """A person's arm; the sources of the defaults and of the population's ranges are in `POPULATION`."""

    mass: float = Field(default=70.0, ge=20, le=250, description="of the body [kg]")
    height: float = Field(default=1.75, ge=1.0, le=2.5, description="of the body [m]")
    tone: float = Field(default=0.5, ge=0.05, le=20, description="factor of the relaxed muscles' stiffness [1]")
    strength: float = Field(
        default=1.0, ge=0.05, le=20, description="factor of the stiffness and torque of the muscles' activation [1]"
    )
    rest_angle_deg: float = Field(
        default=45.0,
        ge=-180,
        le=180,
        description="posture in which the muscles of a guided wearer are in balance [deg]; else the intended one",
    )
    co_contraction: float = Field(
        default=0.05, ge=0, le=1, description="activation of both muscles that is always there [1]"
    )
    reflex_delay: float = Field(default=0.05, ge=0, le=0.5, description="from an error to its answer [s]")
    feedback_stiffness: float = Field(default=4.0, ge=0, le=500, description="of the delayed answer [N m/rad]")
    feedback_damping: float = Field(default=0.4, ge=0, le=50, description="of the delayed answer [N m s/rad]")
    anticipation: float = Field(
        default=0.9, ge=0, le=2, description="share of the own inertia and friction that the wearer feeds forward [1]"
    )
    tremor_torque: float = Field(default=0.0, ge=0, le=10, description="standard deviation of the tremor [N m]")
    tremor_frequency: float = Field(default=9.0, ge=1, le=20, description="of the tremor [Hz]")
    payload_time: float = Field(
        default=0.0, ge=0, le=1e6, description="from when on the scenario's payload is in the hand [s]"
    )
    guided: bool = Field(
        default=False,
        description="true: the scenario's moves are the device's setpoint instead of an intention, and the wearer is "
        "relaxed: the co-contraction is all that the muscles do",
    )
    worn: bool = Field(default=True, description="false: the same arm outside the exoskeleton, to compare")


def pack_wearer(
    wearer: Wearer, control_period: float, vertical: bool, payload_mass: float = 0.0, payload_arm: float = 0.0
) -> NDArray[np.void]:
    """Return a wearer with a payload in the hand as a record of `simulation.worn_layout.PERSON`, shape (1,).

    Parameters
    ----------
    wearer : Wearer
    control_period : float
        Of the device [s]; the reflex delay is rounded to it.
    vertical : bool
        Whether gravity acts on the arm.
    payload_mass, payload_arm : float
        A point mass [kg] and its distance from the elbow [m].

    Raises
    ------
    AmulettError
        If the reflex delay has too many control ticks.
    """
    delay = round(wearer.reflex_delay / control_period)
    if delay >= DELAY:
        raise AmulettError(
            f"scenario: 'wearer.reflex_delay' is {wearer.reflex_delay} s, {delay} control ticks of the device; at most "
            f"{(DELAY - 1) * control_period:g} s are possible"
        )
    mass, centre, inertia = forearm(wearer.mass, wearer.height)
    packed = np.zeros(1, dtype=PERSON)
    put(packed, wearer)
    packed["inertia"], packed["load_inertia"] = inertia, payload_mass * payload_arm**2
    if vertical:
        packed["weight"], packed["load_weight"] = GRAVITY * mass * centre, GRAVITY * payload_mass * payload_arm
    packed["rest_angle"] = np.radians(wearer.rest_angle_deg)
    packed["load_tick"] = round(wearer.payload_time / control_period)
    packed["delay"] = delay
    return packed
