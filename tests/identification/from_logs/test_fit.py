"""A hidden device is found again from its log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import fork_processes

from amulett_gym.fleet import load_fleet
from amulett_gym.identification.from_logs.fit import Fit, fit
from amulett_gym.identification.from_logs.model import Model
from amulett_gym.identification.from_logs.physics import physics_of
from amulett_gym.identification.from_logs.profile import draw_fleet, profile_content
from amulett_gym.identification.from_logs.result import channel_rms, undetermined
from amulett_gym.identification.from_logs.sensors import bits_of, encoder, sliders
from amulett_gym.profile import load_profile
from amulett_gym.simulation.layout import LANES
from amulett_gym.workers.call import Workers
from tests.identification.from_logs.conftest import simulate_log


@pytest.fixture(scope="module")
def found(base, fleet, log) -> Fit:
    return fit(base, [replace(log, end=13.0)], fleet, tried=1)


def test_workers_find_the_same(base, fleet, log, monkeypatch):
    fork_processes(monkeypatch)
    monkeypatch.setattr("amulett_gym.identification.from_logs.fit._CLEAR", 0.0)  # all starts
    few = [replace(log, end=4.0)]
    one, two = (fit(base, few, fleet[:12], tried=3, workers=workers) for workers in (Workers(), Workers(2)))
    assert len(one.starts) == 3 and one.starts == two.starts
    assert one.place.tolist() == two.place.tolist() and one.covariance.tolist() == two.covariance.tolist()


def test_the_hidden_device_predicts_its_log_up_to_the_noise(hidden, log):
    model = Model(hidden, [log])
    apart = model.predict([physics_of(hidden)], hidden.sensors.potentiometer_noise)[0] - model.measured
    angles = model.channel_of() == 0
    assert np.std(apart[angles]) < 1.3 * np.hypot(np.radians(hidden.sensors.encoder_noise_deg), 2 * np.pi / 2**14 / 3)
    assert np.std(apart[~angles]) == pytest.approx(hidden.sensors.potentiometer_noise, rel=0.1)


def test_what_the_log_determines_is_found(found, hidden):
    truth = physics_of(hidden)
    known = {each.seen.name: each for each in found.estimates if each.determined}
    assert {"radius_ratio", "lag"} <= set(known)
    assert known["radius_ratio"].value == pytest.approx(truth["radius_ratio"], rel=2e-3)
    assert known["lag"].value == pytest.approx(truth["lag"], rel=2e-2)
    deviations = np.sqrt(np.diag(found.covariance))
    places = [each.place(truth.get(each.name, 0.0)) for each in found.prior.seen]
    assert (np.abs(places - found.place) < 4.0 * deviations).all()


def test_forces_inertia_and_the_dampings_preload_change_together(found):
    names = [each.name for each in found.prior.seen]
    correlation = found.covariance / np.sqrt(np.outer(np.diag(found.covariance), np.diag(found.covariance)))
    for one in ("inertia", "stall_torque"):  # a scale of all forces moves nothing
        assert correlation[names.index(one), names.index("damping_preload")] > 0.8
    widest = undetermined(found)[0]
    assert {"inertia", "damping_preload"} <= set(widest)


def test_what_was_held_out_is_predicted(found, hidden, log):
    held = replace(log, begin=13.0)
    model = Model(found.model.template, [held], whole=True)
    best = Model(hidden, [held], whole=True)
    apart = [model.predict([found.values])[0] - model.measured, best.predict([physics_of(hidden)])[0] - best.measured]
    ours, theirs = (np.sqrt(np.mean(each[model.channel_of() == 0] ** 2)) for each in apart)
    assert ours < 1.5 * theirs


def test_noise_and_resolution_of_the_sensors_are_found(found, hidden):
    angle, slider = encoder(found), sliders(found)
    assert slider is not None
    assert bits_of(angle, 2.0 * np.pi) == 14
    assert np.degrees(angle.noise) == pytest.approx(hidden.sensors.encoder_noise_deg, rel=0.1)
    assert slider.noise == pytest.approx(hidden.sensors.potentiometer_noise, rel=0.1)
    assert slider.low < slider.noise < slider.high


def test_the_residuals_are_white(found):
    assert all(abs(each.largest) < 0.15 for each in found.whiteness.values())


def test_the_profile_has_value_interval_and_source(found, base):
    content = profile_content(found, base, "mine")
    profile = load_profile(content)
    assert profile.name == "mine"
    assert profile.loop == base.loop
    assert profile.drives.command_limit_deg == base.drives.command_limit_deg  # not that of a plausible device
    assert physics_of(profile)["lag"] == pytest.approx(found.values["lag"], rel=1e-5)
    assert "90 %), from steps.csv" in profile.drives.sources["lag"]
    blind = profile_content(replace(found, covariance=found.prior.covariance), base, "mine")
    assert "most of it is the prior" in blind["drives"]["sources"]["lag"]
    assert profile.sensors.encoder_bits == 14
    assert "residuals of steps.csv" in profile.sensors.sources["encoder_noise_deg"]


def test_a_fleet_is_drawn_from_the_posterior(found, base):
    drawn = draw_fleet(found, base, "mine", 30, seed=0)
    fleet = load_fleet(drawn)
    assert [fleet[0].name, fleet[-1].name] == ["mine-01", "mine-30"]
    values = np.log([physics_of(each)["inertia"] for each in fleet])
    k = [each.name for each in found.prior.seen].index("inertia")
    assert np.std(values) == pytest.approx(np.sqrt(found.covariance[k, k]), rel=0.4)
    assert draw_fleet(found, base, "mine", 2, seed=0)[1] != draw_fleet(found, base, "mine", 2, seed=1)[1]


@pytest.fixture(scope="module")
def quiet(hidden):
    """Return the hidden device with a fifth of its noise: at the coarse period the loop makes a degree of it."""
    noise = {"encoder_noise_deg": 0.005, "encoder_bits": 0, "potentiometer_noise": 4e-5}
    return hidden.model_copy(update={"sensors": hidden.sensors.model_copy(update=noise)})


@pytest.fixture(scope="module")
def closed(quiet):
    log = simulate_log(quiet)
    return replace(log, columns={name: values for name, values in log.columns.items() if "command" not in name})


def test_forces_and_setpoints_do_where_commands_and_sliders_are_missing(closed, quiet, fleet):
    columns = {name: values for name, values in closed.columns.items() if "slider" not in name}
    model = Model(quiet, [replace(closed, columns=columns, end=6.0)])
    assert {part.channel for part in model.parts} == {"angle", "force_biceps", "force_triceps"}
    assert "command_delay" not in {each.name for each in model.seen}
    apart = model.predict([physics_of(quiet), physics_of(fleet[0])]) - model.measured
    own, other = np.sqrt(np.mean(apart[:, model.channel_of() == 0] ** 2, axis=1))
    assert own < np.radians(0.5)
    assert own < 0.8 * other


def test_in_closed_loop_draws_of_the_noise_differ_as_logs_do(quiet, closed):
    model, values = Model(quiet, [closed]), physics_of(quiet)
    draws, predicted, angles = model.draws(values, 2), model.predict([values])[0], model.channel_of() == 0
    assert len(draws) == 2 * LANES
    *others, own = (np.sqrt(np.mean((each - predicted)[angles] ** 2)) for each in (*draws, model.measured))
    assert 0.5 * min(others) < own < 1.5 * max(others)
    assert not model.open_cells.any()


def test_commands_need_no_draws(hidden, log):
    assert not Model(hidden, [log]).draws(physics_of(hidden), 1).any()


def test_a_fit_in_closed_loop_predicts_and_does_not_claim_too_much(base, fleet, quiet, closed):
    found = fit(base, [replace(closed, end=13.0)], fleet, tried=1)
    held, truth = [replace(closed, begin=13.0)], physics_of(quiet)
    ours, theirs = (
        channel_rms(model, model.predict([values])[0] - model.measured)["angle"]
        for model, values in (
            (Model(found.model.template, held, whole=True), found.values),
            (Model(quiet, held, whole=True), truth),
        )
    )
    assert ours < 1.5 * theirs
    deviations = np.sqrt(np.diag(found.covariance))
    places = [each.place(truth.get(each.name, 0.0)) for each in found.prior.seen]
    assert (np.abs(places - found.place) < 4.0 * deviations).all()
    assert {"radius_ratio", "lag"} <= {each.seen.name for each in found.estimates if each.determined}
    sensors = quiet.sensors  # not the residuals, which the moving joint makes larger
    assert np.degrees(encoder(found).noise) == pytest.approx(sensors.encoder_noise_deg, rel=0.3)
    assert sliders(found).noise == pytest.approx(sensors.potentiometer_noise, rel=0.3)
    assert found.noise["angle"] > 3.0 * encoder(found).noise
