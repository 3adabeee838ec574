"""The measurements that run as modules share their options."""

import pytest

from amulett_gym.studies.speed import overhead, startup, workers, yardstick
from amulett_gym.studies.speed.command import command


def test_options_have_the_defaults_of_the_measurement():
    parser = command("Measure this.\n\nMore.", "name", 5, (2, 8))
    assert vars(parser.parse_args([])) == {"devices": [2, 8], "turns": 5, "json": None}
    chosen = parser.parse_args(["--devices", "3", "--turns", "1", "--json", "file"])
    assert vars(chosen) == {"devices": [3], "turns": 1, "json": "file"}
    assert parser.description == "Measure this."
    assert parser.prog == "python -m amulett_gym.studies.speed.name"


@pytest.mark.parametrize("module", [overhead, startup, workers, yardstick])
def test_only_measurements_of_devices_take_their_number(module, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["name", "--help"])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    assert ("--devices" in capsys.readouterr().out) == (module not in (startup, workers))
