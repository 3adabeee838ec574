"""What an environment costs beside the kernel: its memory, and how its time is taken."""

import pytest

from amulett_gym.simulation.layout import LANES, SCENARIO_BLOCK, STATE_BLOCK
from amulett_gym.studies.speed.overhead import memory, race, report


def test_a_device_takes_the_memory_of_its_state_and_its_scenario():
    blocks = (STATE_BLOCK.itemsize + SCENARIO_BLOCK.itemsize) / LANES
    assert memory(1024, 8192).held == pytest.approx(blocks + 18, abs=2)  # a key, its episode's number, two flags


def test_contestants_take_turns():
    played = []

    def player(name):
        def play():
            played.append(name)
            return len(played) * 1e-6

        return play

    times = race({"kernel": player("kernel"), "step": player("step")}, turns=3)
    assert played == ["kernel", "step"] * 4
    assert times == {"kernel": pytest.approx([3, 5, 7]), "step": pytest.approx([4, 6, 8])}  # the first turn compiles


def test_the_report_says_in_words_what_it_returns_as_data():
    lines = []
    found = report([9], 1, lines.append)
    for profile, overheads in found["step"].items():
        for name, overhead in overheads.items():
            (line,) = [line for line in lines if line.startswith(f"{profile}, {name}")]
            assert line.split()[-1] == f"{overhead['ratio']:.3f}"
    assert f"{found['bytes_per_device']['held']:.0f} bytes" in lines[-1]
