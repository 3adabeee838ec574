"""A measured force-deflection curve: read from a CSV file once, checked, and kept with the profile by its content."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from pydantic import Field, ValidationError, model_validator

from amulett_gym.settings import Group, describe
from amulett_gym.storage.table import read_columns

COLUMNS = ("deflection_m", "force_N", "spring_deflection_m")
MOST_POINTS = 1000
_MOST_BYTES = 1_000_000
_LEAST_RISE = 1e-9  # [m]: far below what can be measured, and far above where slopes overflow


class Curve(Group):
    """A curve from rest on, or joined to it: deflections rise by a nanometre or more, the force never falls."""

    deflection_m: list[float] = Field(min_length=3, max_length=MOST_POINTS, description="of the string, 0 to 10 [m]")
    force_N: list[float] = Field(description="of the string, 0 to 1e6 [N]")
    spring_deflection_m: list[float] | None = Field(
        default=None, description="of the linear spring, 0 to 10 [m]; null: the potentiometer sees the string's"
    )

    @model_validator(mode="after")
    def _check_points(self) -> Curve:
        columns = {name: values for name, values in self if values is not None}
        for name, values in columns.items():
            if len(values) != len(self.deflection_m):
                raise ValueError(f"'{name}' has {len(values)} values, 'deflection_m' has {len(self.deflection_m)}")
            if values[0] < 0.0:
                raise ValueError(f"'{name}' starts at {values[0]}; it has to be >= 0")
            least, most = (0.0, 1e6) if name == "force_N" else (_LEAST_RISE, 10.0)
            for before, value in pairwise(values):
                if value - before < least:
                    raise ValueError(f"'{name}' has to rise from row to row; {value} follows {before}")
            if values[-1] > most:
                raise ValueError(f"'{name}' reaches {values[-1]}; it has to be at most {most:g}")
        if self.force_N[-1] <= 0.0:
            raise ValueError("'force_N' has no force above 0")
        starts = {name: values[0] for name, values in columns.items()}
        if any(starts.values()) and not all(starts.values()):
            raise ValueError(f"it starts at {starts}; all of them have to be 0, or all above")
        return self


def read_curve(path: str | Path) -> Curve:
    """Read a measured curve.

    Parameters
    ----------
    path : str or Path
        CSV file (comma or semicolon) with a header and the columns ``deflection_m``, ``force_N`` and optionally
        ``spring_deflection_m`` (without it the potentiometer is taken to measure the string's deflection itself). A
        curve that starts above zero is joined to the origin. Average repeated and noisy measurements first.

    Raises
    ------
    AmulettError
        If `read_columns` refuses the file, or `Curve` the values.
    """
    columns = read_columns(path, "measured spring curve", COLUMNS[:2], _MOST_BYTES, COLUMNS[2:])
    try:
        return Curve.model_validate(dict(zip(COLUMNS, columns, strict=False)))
    except ValidationError as error:
        raise describe(error, Curve, f"measured spring curve '{path}'") from error
