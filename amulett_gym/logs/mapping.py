"""The mapping file: which column of a log is what, where its header does not say so."""

from __future__ import annotations

from collections.abc import Mapping as MappingType
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from amulett_gym.errors import AmulettError
from amulett_gym.logs.log import COLUMNS, REQUIRED
from amulett_gym.settings import Group, describe, find_config, to_plain
from amulett_gym.storage.header import Form, Wanted
from amulett_gym.storage.safe_yaml import read_yaml
from amulett_gym.storage.units import check_unit, plain_unit


class ColumnMapping(Group):
    """Where a column is, and what it means: ``sign * scale * (written - offset)``, in `unit`."""

    name: str | int | None = Field(
        default=None, description="header in the file, or number of the column, from 1; null: the log's own name"
    )
    unit: str | None = Field(default=None, description="replaces the unit in the header; null: that of the header")
    scale: float = Field(default=1.0, gt=0, description="value of a written 1 in the unit, e.g. of an encoder's count")
    offset: float = Field(default=0.0, description="what is written where the quantity is 0")
    sign: Literal[1, -1] = Field(default=1, description="-1 where the device counts in the other direction")

    @model_validator(mode="before")
    @classmethod
    def _read_name(cls, content: Any) -> Any:
        return {"name": content} if isinstance(content, str | int) and not isinstance(content, bool) else content

    @field_validator("name")
    @classmethod
    def _check_number(cls, name: str | int | None) -> str | int | None:
        if isinstance(name, int) and name < 1:
            raise ValueError("columns are numbered from 1")
        return name


class File(Group):
    """How the file is written, where that is to be fixed instead of found."""

    separator: Literal["comma", "semicolon", "tab"] | None = Field(default=None, description="null: found")
    decimal: Literal["point", "comma"] | None = Field(default=None, description="null: found")
    header: bool = Field(default=True, description="false: no row has names, so columns have to be given by numbers")
    repeated_stamps: Literal["first", "last", "mean", "refuse"] = Field(
        default="first", description="which of several rows with the same time remains"
    )


class Mapping(Group):
    """Columns by the names of `COLUMNS`; a text or a number alone is the column's name."""

    time: ColumnMapping = ColumnMapping()
    setpoint: ColumnMapping = ColumnMapping()
    angle: ColumnMapping = ColumnMapping()
    slider_biceps: ColumnMapping = ColumnMapping()
    slider_triceps: ColumnMapping = ColumnMapping()
    force_biceps: ColumnMapping = ColumnMapping()
    force_triceps: ColumnMapping = ColumnMapping()
    command_biceps: ColumnMapping = ColumnMapping()
    command_triceps: ColumnMapping = ColumnMapping()
    tension_setpoint: ColumnMapping = ColumnMapping()
    file: File = File()

    @model_validator(mode="after")
    def _check_columns(self) -> Mapping:
        for name, kind in COLUMNS.items():
            column = self.of(name)
            if column.unit is not None:
                check_unit(plain_unit(column.unit), kind.quantity, f"'{name}'")
            if not self.file.header and isinstance(column.name, str):
                raise ValueError(f"'{name}.name' is '{column.name}', but file.header is false: give a column's number")
            if not self.file.header and column.name is None and name in REQUIRED:
                raise ValueError(f"'{name}.name' is missing: file.header is false, so give a column's number")
        return self

    def of(self, name: str) -> ColumnMapping:
        """Return the mapping of one of `COLUMNS`."""
        column: ColumnMapping = getattr(self, name)
        return column

    def wanted(self) -> list[Wanted]:
        """Return the columns that a table is searched for."""
        return [
            Wanted(
                name,
                kind.quantity,
                required=name in REQUIRED,
                may_miss=name != "time",
                header=self.of(name).name,
                unit=self.of(name).unit,
            )
            for name, kind in COLUMNS.items()
            if self.file.header or self.of(name).name is not None
        ]

    def form(self) -> Form:
        """Return what is known of the file."""
        return Form(self.file.separator, self.file.decimal, self.file.header)


def load_mapping(mapping: str | Path | MappingType[str, Any] | Mapping | None) -> Mapping:
    """Return a validated mapping.

    Parameters
    ----------
    mapping : str, Path, mapping, Mapping or None
        A YAML or JSON file, or its content; None: every column has its own name, with its unit in the header.

    Raises
    ------
    AmulettError
        If the file cannot be read, or a key is unknown or a value wrong.
    """
    if mapping is None or isinstance(mapping, Mapping):
        return mapping or Mapping()
    if isinstance(mapping, MappingType):
        content, what = to_plain(mapping), "mapping"
    elif isinstance(mapping, str | Path):
        path = find_config(mapping, "mapping")
        content, what = read_yaml(path, "mapping"), f"mapping '{path}'"
    else:
        raise AmulettError(f"mapping is {mapping!r}; it has to be a YAML file or its content")
    try:
        return Mapping.model_validate(content)
    except ValidationError as error:
        raise describe(error, Mapping, what) from error
