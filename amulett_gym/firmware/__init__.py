"""Loop and law as C for a microcontroller: export, the host's build, and the comparison with the simulation."""

from amulett_gym.firmware.env import HardwareEnv

__all__ = ["HardwareEnv"]
