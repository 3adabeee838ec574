"""The firmware as a loop of the page: the hex file of ``amulett export eq6``, which avr8js runs in the browser.

``python -m amulett_gym.live.core.hex`` exports and compiles it anew, with `avr-gcc`. The file is part of the package,
so that only who changes the firmware needs the compiler.
"""

from __future__ import annotations

import tempfile
from importlib import resources
from pathlib import Path

from amulett_gym.firmware.export import export
from amulett_gym.firmware.toolchain import build_hex
from amulett_gym.profile import Profile, load_profile
from amulett_gym.storage.writing import atomic_path

HEX = "firmware.hex"
LAW, DEVICE = "eq6", "testbed"
"""What the file holds: the paper's loop with this law inside, for this device."""

FIRMWARE = "firmware"
"""Name of the loop on the page."""

OTHER_DEVICE = f"its hex file is that of the device '{DEVICE}', whose numbers are compiled into it"


def read_hex() -> str:
    """Return the package's ``firmware.hex``."""
    return resources.files("amulett_gym.live.core").joinpath(HEX).read_text("ascii")


def is_of_hex(profile: Profile) -> bool:
    """Return whether the file was compiled for a device."""
    return profile == load_profile(DEVICE)


def build() -> str:
    """Return the hex file, exported and compiled; AmulettError if the compiler is missing."""
    with tempfile.TemporaryDirectory(prefix="amulett-hex-") as name:
        folder = Path(name)
        export(LAW, DEVICE, None, folder / "firmware")
        return build_hex(folder / "firmware", folder / "build").read_text("ascii").replace("\r\n", "\n")


def main() -> None:
    """Compile the file and write it into the package."""
    path = Path(__file__).with_name(HEX)
    content = build()
    with atomic_path(path) as temporary:
        temporary.write_text(content, encoding="ascii", newline="\n")
    print(f"{path}: {len(content)} bytes")


if __name__ == "__main__":
    main()
