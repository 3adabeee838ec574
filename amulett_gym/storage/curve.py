"""A measured force-deflection curve, kept with the profile as CSV text."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from pydantic import Field, ValidationError, ValidationInfo, model_serializer, model_validator

from amulett_gym.errors import AmulettError
from amulett_gym.settings import Group, describe
from amulett_gym.storage.header import Wanted
from amulett_gym.storage.hysteresis import mean_of_branches
from amulett_gym.storage.table import parse_table, read_table_text
from amulett_gym.storage.units import to_si

COLUMNS = ("deflection_m", "force_N", "spring_deflection_m")
_QUANTITIES = dict(zip(COLUMNS, ("length", "force", "length"), strict=True))
MOST_BYTES = 1_000_000
"""Size of the largest CSV file accepted."""
MOST_KEPT = 1_500_000
"""Characters of the longest curve as CSV text: indented in a recipe's YAML, it stays below that file's limit."""
_LEAST_RISE = 1e-9  # [m]: far below what can be measured, and far above where slopes overflow


class Curve(Group):
    """A curve from rest on, or joined to it: deflections rise by a nanometre or more, the force never falls."""

    deflection_m: list[float] = Field(min_length=3, description="of the string, 0 to 10 [m]")
    force_N: list[float] = Field(description="of the string, 0 to 1e6 [N]")
    spring_deflection_m: list[float] | None = Field(
        default=None, description="of the linear spring, 0 to 10 [m]; null: the potentiometer measures the string's"
    )

    @model_validator(mode="after")
    def _check_points(self, info: ValidationInfo) -> Curve:
        rows: list[int] | None = info.context and info.context.get("rows")

        def place(k: int) -> str:
            return f"value {k + 1} of '{name}'" if rows is None else f"row {rows[k]}, column '{name}'"

        columns = {name: values for name, values in self if values is not None}
        for name, values in columns.items():
            if len(values) != len(self.deflection_m):
                raise ValueError(f"'{name}' has {len(values)} values, 'deflection_m' has {len(self.deflection_m)}")
            if values[0] < 0.0:
                raise ValueError(f"{place(0)}: it starts at {values[0]}; it has to be >= 0")
            least, most = (0.0, 1e6) if name == "force_N" else (_LEAST_RISE, 10.0)
            for k, (before, value) in enumerate(pairwise(values), start=1):
                if value - before < least:
                    raise ValueError(f"{place(k)}: it has to rise from row to row; {value} follows {before}")
            if values[-1] > most:
                raise ValueError(f"{place(-1)}: it reaches {values[-1]}; it has to be at most {most:g}")
        if self.force_N[-1] <= 0.0:
            raise ValueError("'force_N' has no force above 0")
        starts = {name: values[0] for name, values in columns.items()}
        if any(starts.values()) and not all(starts.values()):
            raise ValueError(f"it starts at {starts}; all of them have to be 0, or all above")
        if (size := len(self.to_csv())) > MOST_KEPT:
            raise ValueError(f"it has {size} characters as CSV; at most {MOST_KEPT} are allowed")
        return self

    @model_serializer
    def to_csv(self) -> str:
        """Return the curve as CSV text, from which `read_curve` reads the same numbers."""
        columns = {name: values for name, values in self if values is not None}
        rows = (",".join(map(repr, row)) for row in zip(*columns.values(), strict=True))
        return "\n".join([",".join(columns), *rows, ""])


def read_curve(source: str | Path) -> Curve:
    """Return a measured curve; see `read_measurement`."""
    return read_measurement(source)[0]


def read_measurement(source: str | Path) -> tuple[Curve, list[str]]:
    """Read a measured curve.

    Parameters
    ----------
    source : str or Path
        A CSV file as of `storage.table`, or its text: the columns ``deflection_m``, ``force_N`` and optionally
        ``spring_deflection_m`` (without it the potentiometer is taken to measure the string's deflection), also in
        other units, such as ``deflection [mm]``. A curve that starts above zero is joined to the origin. Of loops, in
        which the deflection rises and falls, the mean is taken. Average repeated and noisy measurements first.

    Returns
    -------
    curve : Curve
    notes : list of str
        How the file is written. The last one of loops begins with `hysteresis.MEAN` and names the loss.

    Raises
    ------
    AmulettError
        If the file cannot be read or has more than 1 MB, `parse_table` or `mean_of_branches` refuses the text, or
        `Curve` the values.
    """
    what, text, notes = "measured spring curve", str(source), list[str]()
    if not is_csv(text):
        what = f"{what} '{source}'"
        text, notes = read_table_text(source, "measured spring curve", MOST_BYTES)
    wanted = [Wanted(name, quantity, required=name != COLUMNS[2]) for name, quantity in _QUANTITIES.items()]
    table = parse_table(text, what, wanted)
    columns = {
        name: to_si(table.columns[name], _QUANTITIES[name], found.unit).tolist() for name, found in table.found.items()
    }
    rows, notes = table.rows.tolist(), notes + table.notes
    try:
        mean = mean_of_branches(list(columns.values()), rows, COLUMNS[0])
    except ValueError as error:
        raise AmulettError(f"{what}: {error}") from error
    if mean is not None:
        columns, rows = dict(zip(columns, (values.tolist() for values in mean.columns), strict=True)), mean.rows
        notes.append(mean.in_words())
    try:
        return Curve.model_validate(columns, context={"rows": rows}), notes
    except ValidationError as error:
        raise describe(error, Curve, what) from error


def is_csv(source: str) -> bool:
    """Return whether a source of a curve is CSV text, not the path of a file: it has more than one line."""
    return "\n" in source
