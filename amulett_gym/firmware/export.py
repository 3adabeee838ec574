"""Write the firmware's folder: C texts of the package, and generated numbers."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from contextlib import closing
from importlib import resources
from pathlib import Path

from amulett_gym.c.build import find_compiler
from amulett_gym.envs.settings import Settings
from amulett_gym.errors import ToolMissing
from amulett_gym.firmware.control import APART, LOOP_FILES, TABLES, check_cycles, loop_tables, loop_texts
from amulett_gym.firmware.description import MANIFEST
from amulett_gym.firmware.device import device_header, slider_readings, tables_header
from amulett_gym.firmware.host import FLAGS, Controller, firmware_id
from amulett_gym.firmware.laws import FirmwareLaw, choose, delay_remark, firmware_law, fitting_remark, with_delay
from amulett_gym.firmware.measuring import OnChip, check_fits, measure
from amulett_gym.firmware.network import Numbers
from amulett_gym.firmware.readme import README, compare, needs, readme
from amulett_gym.firmware.recording import Recording, record
from amulett_gym.firmware.toolchain import BOARD_FILES
from amulett_gym.firmware.vectors import vectors_header
from amulett_gym.laws.contenders import Contender
from amulett_gym.laws.copies import NO_COPIES, Copies, copy_policies
from amulett_gym.profile import Profile, load_profile
from amulett_gym.simulation.layout import pack_parameters
from amulett_gym.storage.writing import files_together, output_folder, to_json

TEXTS = (
    *("controller.h", "controller.c", "loop.h", "law.h", "law_action.h", "law_curve.h", "flash.h"),
    *("host.c", "check.c"),
)
"""Files of `amulett_gym.c` that are copied unchanged, beside the law's and the Makefile."""

OTHERS = ("weights.h", "curves.h", *LOOP_FILES)
"""Files that not every firmware has: an earlier export's are deleted."""

_STEPS, _DEVICES = 50, 8  # of the recording that the firmware is compared with


def export(
    law: str,
    profile: str | Path | Profile,
    control: str | None,
    folder: str | Path,
    numbers: Numbers | None = None,
    note: Callable[[str], object] = lambda sentence: None,
) -> dict[str, str]:
    """Write the firmware of a law with its loop on a device.

    Parameters
    ----------
    law : str
        As `laws.contenders.contender_names` lists them, such as ``constant:10``, ``eq6`` or a policy bundle's folder.
    profile : str, Path or Profile
    control : str, optional
        Loop; None: that of the law, in general the paper's.
    folder : str or Path
        New, empty, or of an earlier export, which is replaced.
    numbers : {"float", "int16", "int8"}, optional
        Of a network's weights and activations; None: see `network.choose_numbers`.
    note : callable
        Called with a sentence about the law's delay in the firmware and in the simulation in which it was made, and of
        a worn device with one about what the firmware lacks.

    Returns
    -------
    dict
        The files: name -> content.

    Raises
    ------
    AmulettError
        If law, loop or profile is unknown, does not fit the microcontroller, or the folder cannot be written.
    """
    device = load_profile(profile)
    contender, settings = choose(law, device, control)
    copies = copy_policies([contender.name])  # in memory: their place may be in `folder`
    with output_folder(folder, "firmware", [("device.h", "controller.c")]):
        check_cycles(settings.control, device.loop.control_period)
        found = firmware_law(contender, device, settings, numbers)
        check_cycles(settings.control, device.loop.control_period, found.cycles)
        own, settings = settings, with_delay(settings, found.slices)
        remarks = [remark for remark in (delay_remark(own, settings), fitting_remark(device)) if remark]
        files = firmware_files(device, settings, found)
        recording = record_mixed(contender, settings)
        packed = pack_parameters(device, settings.control)[0]
        resolutions = float(packed["encoder_resolution"]), float(packed["slider_resolution"])
        loop = [name for name in LOOP_FILES if name in files]
        files["vectors.h"] = vectors_header(recording, *resolutions, found.apart + (APART if loop else 0.0))
        period, ticks = device.loop.control_period, settings.ticks(device)
        with files_together(folder, OTHERS) as new:
            _write(new, files)
            chip = _on_chip(new, recording)
            if isinstance(chip, OnChip):
                check_fits(chip.measurement, period)
            needed = needs(chip.measurement, period, _run(recording)) if isinstance(chip, OnChip) else chip
            checked = "\n\n".join([_checked(new, recording, chip), *found.remarks, *remarks])
            about = contender.name, settings.control, device.name, period, ticks
            files[README] = readme(*about, needed, checked, loop)
            files[MANIFEST] = manifest(contender, settings, files, copies)
            _write(new, {name: files[name] for name in (README, MANIFEST)})
            copies.write(folder)  # while the old files are still there: a manifest names its copies
    for remark in remarks:
        note(remark)
    return files


def firmware_files(profile: Profile, settings: Settings, found: FirmwareLaw) -> dict[str, str]:
    """Return the sources, name -> content, of a law; AmulettError if the device does not fit."""
    files = {name: text(name) for name in (*TEXTS, *BOARD_FILES)}
    files |= {"law.c": text(found.source), "tables.h": tables_header(profile, settings), **found.files}
    files["Makefile"] = text("firmware.mk")
    if texts := loop_texts(settings.control):
        readings = slider_readings(profile, pack_parameters(profile, settings.control)[0])
        files |= {name: text(name) for name in texts}
        files[TABLES] = loop_tables(profile, settings.control, readings)
    header = device_header(profile, settings, found.defines)
    digest = zlib.crc32("".join([*(files[name] for name in sorted(files)), header]).encode())
    files["device.h"] = header.replace(
        "\n#define PARAMETERS", f"#define FIRMWARE_ID {digest}u\n\n#define PARAMETERS", 1
    )
    return files


def manifest(contender: Contender, settings: Settings, files: Mapping[str, str], copies: Copies = NO_COPIES) -> str:
    """Return ``manifest.json``: law, loop and device as data, the identity of the sources, and the kept policies."""
    keywords = settings.keywords() | {"tension_range": list(settings.tension_range)}
    about = {
        "law": contender.name,
        "control": settings.control,
        "id": firmware_id(files["device.h"]),
        "keywords": keywords,
        "kept": copies.record,
    }
    return to_json(about | {"profile": settings.profile.model_dump(mode="json")})


def record_mixed(contender: Contender, settings: Settings) -> Recording:
    """Return a second of the simulation's own loop, in scenarios of `mixed` that no policy was trained on."""
    mixed = type(settings)(**{**settings.given, "suite": "mixed", "split": "held-out"})
    return record(contender, mixed, _STEPS, _DEVICES)


def text(name: str) -> str:
    """Return a file of `amulett_gym.c`."""
    return resources.files("amulett_gym.c").joinpath(name).read_text("utf-8")


def _run(recording: Recording) -> str:
    ticks, devices = recording.outputs["biceps"].shape
    return f"with the readings of {devices} simulated episodes of `mixed`, {ticks} control ticks each"


def _on_chip(folder: Path, recording: Recording) -> OnChip | str:
    """Return what the simulated chip measures, or what is missing for it."""
    try:
        return measure(folder, recording)
    except ToolMissing as error:
        missing = str(error).splitlines()[0]
        return f"Not measured: {missing}. Then `amulett hil FOLDER --transport chip --readme` fills in this part."


def _checked(folder: Path, recording: Recording, chip: OnChip | str) -> str:
    """Return what a comparison of the compiled controller with the simulation gives, as Markdown."""
    if find_compiler() is None:
        return "Nothing: there was no C compiler. `make check` compares the controller with the test vectors."
    lines = [
        f"The largest difference from the simulation's own loop, {_run(recording)}:",
        "",
        "| Build | command [rad] | tension setpoint [N] |",
        "|---|---|---|",
    ]
    builds: dict[str, dict[str, float]] = {}
    for real in FLAGS:
        with closing(Controller(folder, real)) as controller:
            builds[real] = compare(controller, recording)
    if isinstance(chip, OnChip):
        builds["float, simulated ATmega2560"] = chip.apart
    lines += [f"| {name} | {found['command']:.2g} | {found['tension']:.2g} |" for name, found in builds.items()]
    return "\n".join(lines)


def _write(folder: Path, files: Mapping[str, str]) -> None:
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
