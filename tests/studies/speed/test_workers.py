"""What workers gain and cost is measured, and missed limits are named."""

from amulett_gym.studies.speed import workers as module
from amulett_gym.workers.call import Workers


def test_everything_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TASK", 0.01)
    monkeypatch.setattr(module, "SIZES", dict.fromkeys((10, 100, 1000), 20))
    monkeypatch.setattr(module, "_search", lambda folder, workers: 2.0 if workers.number == 1 else 1.0)
    monkeypatch.setattr(module, "_rate", lambda workers, size, count: float(count))
    monkeypatch.setattr(module, "_files", lambda folder, count: {"kept files (.json)": float(count)})
    found = module.measure(Workers(2), 2)
    assert found["gain"] == [2.0, 2.0] and len(found["overhead"]) == len(found["free_cores"]) == 2
    assert all(0.0 < cores < 2.1 for cores in found["free_cores"])
    said = module.text({**found, "overhead": [0.01]})
    assert "two workers are 2.00 times as fast as one" in said and "MISSED" not in said
    assert module.text({**found, "gain": [1.7], "overhead": [0.06]}).count("MISSED") == 2


def test_rates_are_those_of_all_but_the_first_tasks(tmp_path):
    assert 0.0 < module._rate(Workers(1), 10, 20) < float("inf")
    assert set(module._files(tmp_path, 3)) == {"kept files (.json)", "kept files (.npz)"}
    assert len(list(tmp_path.iterdir())) == 6
