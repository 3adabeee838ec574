"""Memory layout of a wearer in the exoskeleton: records beside those of :mod:`amulett_gym.simulation.layout`.

A batch without a wearer has none of them. Units as there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulett_gym.fitting import Fitting
from amulett_gym.jit.compiled import record
from amulett_gym.profile import Profile
from amulett_gym.settings import Group
from amulett_gym.simulation.layout import block, fields

DELAY = 128
"""Length of the line of a reflex [control ticks]: the largest delay is one less."""

FITTING = record(
    fields("stiffness damping slack")  # of the cuff
    + fields("noise filter resolution")  # of its torque sensor
    + fields("bend_biceps bend_triceps presliding")  # of the cables; mu theta is 0 without
    + fields("at_drive", "i8")  # the cables are between drive and spring instead of between spring and joint
    + fields("gain carry lead rate_filter dead_band rest_gain")  # of the admittance
)
"""What the kernel reads of `profile.wearer` (`amulett_gym.fitting.Fitting`)."""

_PERSON_FIELDS = [
    *fields("mass height"),  # of the body; the simulation does not read them
    *fields("inertia weight tone strength rest_angle co_contraction"),
    *fields("feedback_stiffness feedback_damping correction_time relaxation_time anticipation"),
    *fields("delay", "i8"),  # [control ticks]
    *fields("tremor_torque tremor_frequency"),
    *fields("load_inertia load_weight"),  # of the payload, which is in the hand from this tick on
    *fields("load_tick", "i8"),
    *fields("worn"),  # 0: the arm is outside the exoskeleton
    *fields("guided"),  # 1: the moves are the device's, and the wearer is relaxed
]

PERSON = record(_PERSON_FIELDS)
"""One packed wearer (`amulett_gym.tasks.wearer.Wearer`), with what is in the hand."""

_METRICS = fields("effort cuff_ise cuff_peak tracking_ise moving_cuff_ise moving_time load_deflection")

_WORN_FIELDS = [
    # the arm
    *fields("elbow elbow_rate flexor extensor excitation_flexor excitation_extensor"),
    *fields("correction tremor tremor_lag hand_torque cuff_torque"),
    *fields("loss_biceps loss_triceps"),  # of the cables, 1 - T_out/T_in
    # what the wearer wants, and the past errors that the reflex answers
    *fields("intention intention_rate intention_acceleration"),
    *fields("error_line rate_line", "f8", DELAY),
    # what the device knows: the cuff's torque, and the setpoint that follows it
    *fields("measured_cuff cuff_rate followed"),
    # the agent's assistance in [0, 1], which moves by `assistance_step` a tick
    *fields("assistance assistance_step"),
    *_METRICS,
]
WORN_NAMES = tuple(name for name, _, *shape in _WORN_FIELDS if not shape)
"""Names of the wearer's state, without the lines of the reflex."""

PERSON_BLOCK = block(_PERSON_FIELDS)
WORN_BLOCK = block(_WORN_FIELDS)

ARM_BLOCK = block(
    fields("elbow elbow_rate flexor extensor")
    # with what is in the hand; the weight's torque now; the posture in which the muscles are in balance
    + fields("inertia weight weight_torque rest")
    + fields("elbow_slope elbow_rate_slope flexor_slope extensor_slope")
    + fields("elbow_sum elbow_rate_sum flexor_sum extensor_sum")
)
"""The wearer's motion within a tick, as `layout.MOTION_BLOCK`."""

Worn = tuple[NDArray[np.void], NDArray[np.void], NDArray[np.void]]
"""`FITTING` of each profile, blocks of `PERSON_BLOCK` and of `WORN_BLOCK`."""


def pack_fitting(profile: Profile) -> NDArray[np.void]:
    """Return how a device is worn as a record of `FITTING`, shape (1,)."""
    fitting = profile.wearer or Fitting()
    cuff, sensor, cable, admittance = fitting.cuff, fitting.torque_sensor, fitting.cable, fitting.admittance
    packed = np.zeros(1, dtype=FITTING)
    put(packed, cuff)
    packed["slack"] = np.radians(cuff.slack_deg)
    put(packed, sensor)
    packed["bend_biceps"] = cable.friction * np.radians(cable.bend_biceps_deg)
    packed["bend_triceps"] = cable.friction * np.radians(cable.bend_triceps_deg)
    packed["presliding"], packed["at_drive"] = cable.presliding, cable.side == "drive"
    put(packed, admittance)
    return packed


def put(packed: NDArray[np.void], group: Group) -> None:
    """Copy the values of a group that have a field of the same name."""
    put_values(packed, dict(group))


def put_values(packed: NDArray[np.void], values: Mapping[str, Any]) -> None:
    """Copy the values that have a field of the same name."""
    for name, value in values.items():
        if name in (packed.dtype.names or ()):
            packed[name] = value
