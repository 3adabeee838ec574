"""Settings of the imitation with which a policy of a worn device begins."""

from __future__ import annotations

from pydantic import Field

from amulett_gym.settings import Group


class TeacherSettings(Group):
    """A teacher that knows when the wearer's intention moves, which no device measures.

    While it moves, the teacher assists fully; while it rests, the device keeps its place, unless that is wrong and the
    wearer would correct it.
    """

    moving_tension: float = Field(1.0, ge=0, le=1e6, description="teacher's co-contraction in movements [N]")
    holding_tension: float = Field(12.0, ge=0, le=1e6, description="teacher's co-contraction at rest [N]")
    moving_speed: float = Field(2.0, gt=0, le=1e3, description="speed of the intention that is a movement [deg/s]")
    assistance_margin: float = Field(
        0.0,
        ge=0,
        le=10,
        description="distance of the assistance's action, which is then clipped, beyond the ends of its range: a "
        "policy that imitates it roughly still has exactly none at rest [1]",
    )
    correction: float | None = Field(
        None,
        gt=0,
        le=180,
        description="distance of the setpoint from the intention beyond which the teacher assists at rest, too, while "
        "the cuff's torque moves the setpoint there; null: never [deg]",
    )
    rounds: int = Field(
        5, ge=1, le=100, description="rounds of playing and imitating; the teacher acts in the first [1]"
    )
    episodes: int = Field(192, ge=1, le=10**5, description="scenarios in a round [1]")
    gradient_steps: int = Field(1200, ge=1, le=10**6, description="gradient steps in a round [1]")
    batch_size: int = Field(512, ge=1, le=10**6, description="samples in a gradient step [1]")
    learning_rate: float = Field(3e-3, gt=0, le=1, description="Adam's learning rate, which falls to 0 in a round [1]")
