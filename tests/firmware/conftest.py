"""Firmware that several tests use, compiled once."""

import hashlib
import shutil
from pathlib import Path

import pytest

from amulett_gym.c.build import NO_COMPILER, find_compiler
from amulett_gym.errors import ToolMissing
from amulett_gym.firmware import export, host
from amulett_gym.firmware.export import firmware_files, manifest
from amulett_gym.firmware.host import Controller, compile_controller
from amulett_gym.firmware.laws import choose, firmware_law, with_delay
from amulett_gym.firmware.recording import record
from amulett_gym.profile import load_profile


class Firmware:
    """A law's sources in a folder, with the contender and settings that they were written for."""

    def __init__(self, folder: Path, law: str, profile="testbed", control=None, numbers=None, **environment):
        self.folder, self.profile = folder, load_profile(profile)
        self.contender, settings = choose(law, self.profile, control)
        given = {key: getattr(settings, key) for key in settings.model_fields_set} | environment
        settings = type(settings)(**given)
        found = firmware_law(self.contender, self.profile, settings, numbers)
        self.settings = with_delay(settings, found.slices)
        self.files = firmware_files(self.profile, self.settings, found)
        for name, content in self.files.items():
            (folder / name).write_text(content)
        (folder / "manifest.json").write_text(manifest(self.contender, self.settings, self.files))

    def controller(self, real="double") -> Controller:
        """Return a controller of its own; sources that did not change are compiled once."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(host, "compile_controller", self._compile)
            return Controller(self.folder, real)

    def _compile(self, folder: Path, library: Path, real) -> None:
        sources = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.glob("*.[ch]"))))
        kept = folder.with_name(f"{folder.name}-{real}-{sources.hexdigest()[:16]}.so")
        if not kept.exists():
            compile_controller(folder, kept, real)
        shutil.copy(kept, library)  # another file is loaded with a memory of its own

    def record(self, steps=60, num_devices=6, **environment):
        options = {key: environment.pop(key) for key in ("seed", "scenarios") if key in environment}
        settings = type(self.settings)(**{**self.settings.given, **environment})
        return record(self.contender, settings, steps, num_devices, **options)


@pytest.fixture
def without_chip(monkeypatch):
    """Measure nothing on the simulated chip while a folder is written: it takes time (see test_measuring)."""

    def missing(*_):
        raise ToolMissing("no chip")

    monkeypatch.setattr(export, "measure", missing)


@pytest.fixture(scope="session")
def firmware(tmp_path_factory):
    """Make the firmware of a law, profile and loop; the same one is made once."""
    if find_compiler() is None:
        pytest.skip(NO_COMPILER)
    made = {}

    def make(law, profile="testbed", control=None, **environment):
        key = (law, str(profile), control, *sorted(environment.items()))
        if key not in made:
            made[key] = Firmware(tmp_path_factory.mktemp("firmware"), law, profile, control, **environment)
        return made[key]

    return make
