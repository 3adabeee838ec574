"""Logs of a device: what was asked of it and what it measured, row by row (`docs/logs.md`)."""

from amulett_gym.logs.log import COLUMNS, REQUIRED, Log
from amulett_gym.logs.reader import read_log
from amulett_gym.logs.writer import write_log

__all__ = ["COLUMNS", "REQUIRED", "Log", "read_log", "write_log"]
