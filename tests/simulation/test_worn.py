"""A device on a wearer's arm against an independent reference, closed forms, and the device alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import HELD_DRIVES
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import welch

from amulett_gym.errors import AmulettError
from amulett_gym.fitting import Fitting
from amulett_gym.model.wearer import PASSIVE_DAMPING, forearm, muscle_damping, muscle_stiffness, muscle_torque
from amulett_gym.profile import Profile, load_profile
from amulett_gym.settings import merge
from amulett_gym.simulation.batch import Simulation
from amulett_gym.simulation.reference import arm, decay_rate, string_force
from amulett_gym.simulation.reference_worn import replay_worn
from amulett_gym.simulation.trajectory import Trajectory, record
from amulett_gym.simulation.worn_batch import WornSimulation
from amulett_gym.tasks.scenario import Payload, Scenario, pack
from amulett_gym.tasks.wearer import Wearer, pack_wearer

REACH = Scenario(
    initial_angle_deg=30,
    moves=[{"time": 0.1, "angle_deg": 60, "duration": 0.6}],
    pushes=[{"time": 0.9, "duration": 0.4, "torque": -1.0, "rise": 0.1}],
    noise_seed=3,
)
REST = Scenario(initial_angle_deg=30, noise_seed=3)
PERIOD = 0.0025
STILL = Wearer(tremor_torque=0.0)


def device_of(substeps: int = 4, changes: dict[str, Any] | None = None, **fitting: Any) -> Profile:
    content = {"base": "testbed", "name": "worn", "loop": {"substeps": substeps}, "wearer": fitting}
    return load_profile(merge(content, changes or {}))


def worn(
    profile: Profile, wearer: Wearer, scenario: Scenario = REACH, devices: int = 1, control: Any = "decentralized"
) -> WornSimulation:
    simulation = WornSimulation(profile, devices, control)
    vertical = profile.plant.orientation == "vertical"
    held = scenario.payload  # not of the device: it is in the hand
    rows = np.repeat(pack(scenario.model_copy(update={"payload": None}), profile), devices)
    load = (0.0, 0.0) if held is None else (held.mass, held.arm)
    simulation.reset(rows, wearers=np.repeat(pack_wearer(wearer, PERIOD, vertical, *load), devices))
    simulation.command_tension(6.0)
    simulation.assist(0.8)
    return simulation


def deviations(profile: Profile, wearer: Wearer, ticks: int) -> dict[str, float]:
    trajectory = record(worn(profile, wearer), ticks)
    expected = replay_worn(profile, pack(REACH, profile)[0], wearer, trajectory)
    return {name: float(np.abs(values - trajectory[name]).max()) for name, values in expected.items()}


@pytest.mark.parametrize(
    ("wearer", "changes"),
    [
        (Wearer(), {}),
        (Wearer(mass=95, height=1.9, strength=1.6, reflex_delay=0.03, co_contraction=0.05, tremor_torque=0.2), {}),
        (Wearer(worn=False, co_contraction=0.2, tone=0.4, rest_angle_deg=30), {}),
        (Wearer(guided=True, tone=0.3), {}),
        (Wearer(), {"plant": {"orientation": "vertical"}}),
        (Wearer(), {"structure": {"stiffness": 2e4}}),
    ],
)
def test_motion_is_that_of_the_reference(wearer: Wearer, changes: dict[str, Any]) -> None:
    found = deviations(device_of(changes=changes), wearer, 500)
    assert found["angle"] < 2e-7
    assert found["elbow"] < 2e-7
    assert found["velocity"] < 3e-5
    assert found["elbow_rate"] < 3e-6
    assert found["flexor"] < 1e-6
    assert found["cuff_torque"] < 3e-5
    assert found["drive_biceps"] < 1e-10


@pytest.mark.parametrize(
    "fitting", [{"cable": {"friction": 0.2}}, {"cable": {"friction": 0.1, "bend_triceps_deg": 360.0}}]
)
def test_cables_converge_to_the_reference(fitting: dict[str, Any]) -> None:
    coarse, fine = (deviations(device_of(substeps, **fitting), Wearer(), 300) for substeps in (4, 16))
    assert coarse["angle"] < 5e-5  # the loss is held within an integration step: first order
    assert fine["angle"] < 0.5 * coarse["angle"]
    assert fine["loss_biceps"] < 0.5 * coarse["loss_biceps"] < 0.01


def test_cables_before_the_springs_change_nothing_but_the_drives_load() -> None:
    strong = {"drives": {"stall_torque": 1e4}}  # which hardly yield
    before = record(worn(device_of(changes=strong, cable={"friction": 0.3, "side": "drive"}), Wearer()), 300)
    without = record(worn(device_of(changes=strong), Wearer()), 300)
    np.testing.assert_allclose(before["angle"], without["angle"], atol=1e-7)
    assert np.ptp(before["loss_biceps"]) > 0.3
    drives = {"stall_torque": 0.285}
    before = record(
        worn(device_of(changes={"drives": drives}, cable={"friction": 0.5, "side": "drive"}), Wearer()), 300
    )
    without = record(worn(device_of(changes={"drives": drives}), Wearer()), 300)
    assert np.abs(before["angle"] - without["angle"]).max() > 2e-5


def test_drive_work_counts_the_friction_of_cables_at_the_drives() -> None:
    changes = {"drives": {"stall_torque": 0.6}}
    simulation = worn(device_of(changes=changes, cable={"friction": 0.3, "side": "drive"}), Wearer())
    radius = simulation.profile.plant.drive_pulley_radius
    work = against_springs = 0.0
    for _ in range(400):
        before = {name: float(value) for name, value in simulation.live(0).items() if name[:5] in ("drive", "force")}
        simulation.advance(1)
        after = simulation.live(0)
        for side, sign in (("biceps", 1.0), ("triceps", -1.0)):
            force = 0.5 * (before[f"force_{side}"] + after[f"force_{side}"])
            done = max(radius * force * sign * (after[f"drive_{side}"] - before[f"drive_{side}"]), 0.0)
            against_springs += done
            work += done / (1.0 - after[f"loss_{side}"])
    assert simulation.read("drive_work")[0] == pytest.approx(work, rel=1e-9)
    assert work > 1.2 * against_springs > 0.0


def test_loose_cuff_converges_to_the_reference() -> None:
    found = deviations(device_of(16, cuff={"slack_deg": 4.0}), Wearer(), 400)
    assert found["angle"] < 1e-4  # the padding's damper acts at once when it is touched
    assert found["elbow"] < 1e-5


def test_without_a_cuff_device_and_arm_know_nothing_of_each_other() -> None:
    profile = device_of(cuff={"stiffness": 0.0, "damping": 0.0}, torque_sensor={"noise": 0.0})
    simulation = worn(profile, Wearer())
    simulation.assist(0.0)  # the device's own motion would carry its setpoint on
    apart = record(simulation, 400)
    doffed = record(worn(profile, Wearer(worn=False)), 400)
    alone = Simulation(profile)
    alone.reset(pack(REST, profile))
    alone.command_tension(6.0)
    device = record(alone, 400)
    for name in ("angle", "velocity", "drive_biceps", "force_triceps", "measured_angle", "tension_ise"):
        np.testing.assert_array_equal(apart[name], device[name])
    for name in ("elbow", "elbow_rate", "flexor", "effort", "tracking_ise"):
        np.testing.assert_array_equal(apart[name], doffed[name])
    assert np.degrees(np.ptp(apart["elbow"])) > 20.0


def test_stiff_cuff_makes_one_rigid_body() -> None:
    profile, wearer = device_of(40, cuff={"stiffness": 10_000.0, "damping": 5.0}), STILL
    trajectory = record(worn(profile, wearer), 300)
    expected = one_body(profile, wearer, trajectory)
    assert np.abs(trajectory["angle"] - trajectory["elbow"]).max() < 1e-4
    assert np.abs(trajectory["elbow"] - expected).max() < 3e-4
    assert np.degrees(np.ptp(expected)) > 15.0


def one_body(profile: Profile, wearer: Wearer, trajectory: Trajectory) -> NDArray[np.float64]:
    """Return the angle of joint and elbow as one body, under the recorded commands and activations."""
    bare, _ = arm(profile)
    force, radius, pulley = string_force(profile), profile.plant.joint_pulley_radius, profile.plant.drive_pulley_radius
    _, _, inertia = forearm(wearer.mass, wearer.height)
    times = np.arange(len(trajectory)) * PERIOD

    def rates(time: float, state: NDArray[np.float64]) -> tuple[float, float]:
        angle, velocity = state
        names = ("drive_biceps", "drive_triceps", "flexor", "extensor")
        biceps, triceps, flexor, extensor = (np.interp(time, times, trajectory[name]) for name in names)
        tick = int(time / PERIOD + 1e-9)
        hand = trajectory["hand_torque"][min(tick + 1, len(trajectory) - 1)]
        balance = trajectory["intention"][min(tick, len(trajectory) - 1)]
        pulls = force(biceps * pulley - angle * radius), force(angle * radius - triceps * pulley)
        preload = sum(pulls) / 2 if profile.damping.preload == "mean" else min(pulls)
        torque = (pulls[0] - pulls[1]) * radius - 2 * decay_rate(profile, preload) * bare * velocity + hand
        torque += muscle_torque(flexor, extensor, angle - balance, velocity, wearer.tone, wearer.strength)
        torque -= PASSIVE_DAMPING * velocity
        return velocity, torque / (bare + inertia)

    start = trajectory["elbow"][0], trajectory["elbow_rate"][0]
    return np.asarray(solve_ivp(rates, (0, times[-1]), start, t_eval=times, rtol=1e-8, max_step=PERIOD).y[0])


def test_energy_is_lost_to_the_dampers_alone() -> None:
    """A relaxed arm that was pushed swings back on held drives: what energy is gone, the dampers have taken."""
    profile = device_of(
        8, changes={"loop": HELD_DRIVES}, cuff={"stiffness": 80.0, "damping": 0.5}, admittance={"rest_gain": 0.0}
    )
    passive = {"co_contraction": 0.0, "feedback_stiffness": 0.0, "feedback_damping": 0.0, "anticipation": 0.0}
    wearer = Wearer(tone=1.0, strength=1.0, tremor_torque=0.0, **passive)
    push = Scenario(pushes=[{"time": 0.0, "duration": 0.2, "torque": 1.0}], noise_seed=1)
    simulation = worn(profile, wearer, push)
    simulation.assist(0.0)
    t = record(simulation, 400)
    assert (t["flexor"] == 0.0).all()
    assert np.ptp(t["drive_biceps"]) == 0.0
    bare, _ = arm(profile)
    _, _, inertia = forearm(wearer.mass, wearer.height)
    force, plant, cuff = string_force(profile), profile.plant, (profile.wearer or Fitting()).cuff
    x, q, apart = t["angle"], t["elbow"], t["angle"] - t["elbow"]
    stretches = (
        t["drive_biceps"] * plant.drive_pulley_radius - x * plant.joint_pulley_radius,
        x * plant.joint_pulley_radius - t["drive_triceps"] * plant.drive_pulley_radius,
    )
    stored = 0.5 * bare * t["velocity"] ** 2 + 0.5 * inertia * t["elbow_rate"] ** 2 + 0.5 * cuff.stiffness * apart**2
    stored += 0.5 * muscle_stiffness(0.0, 0.0, 1.0, 1.0) * q**2
    for stretch in stretches:
        grid = np.linspace(min(stretch.min(), 0.0), stretch.max(), 4001)
        forces = np.array([force(each) for each in grid])
        work = np.append(0.0, np.cumsum(0.5 * (forces[1:] + forces[:-1]) * np.diff(grid)))
        stored += np.interp(stretch, grid, work)
    preload = 0.5 * (t["force_biceps"] + t["force_triceps"])
    decay = np.array([decay_rate(profile, each) for each in preload])
    power = 2 * decay * bare * t["velocity"] ** 2 + cuff.damping * (t["velocity"] - t["elbow_rate"]) ** 2
    power += (PASSIVE_DAMPING + muscle_damping(0.0, 0.0, 1.0, 1.0)) * t["elbow_rate"] ** 2
    lost = np.append(0.0, np.cumsum(0.5 * (power[1:] + power[:-1]) * PERIOD))
    free = np.arange(len(t)) * PERIOD >= 0.2
    total = (stored + lost)[free]
    assert stored[free][0] - stored[-1] > 1e-3
    assert np.abs(total - total[0]).max() < 2e-3 * (stored[free][0] - stored[-1])


def test_reflex_answers_after_its_delay() -> None:
    wearer = Wearer(reflex_delay=0.05, worn=False, tremor_torque=0.0)
    push = Scenario(initial_angle_deg=45, pushes=[{"time": 0.1, "duration": 0.5, "torque": 1.0}], noise_seed=1)
    t = record(worn(device_of(), wearer, push), 100)
    moved = np.flatnonzero(t["elbow"] != t["elbow"][0])[0]
    answered = np.flatnonzero(t["excitation_flexor"] != t["excitation_flexor"][1])[0]
    assert moved == round(0.1 / PERIOD) + 1
    # The excitation in row k + 1 is that of the tick that began at row k.
    assert answered == moved + round(0.05 / PERIOD) + 1
    assert t["excitation_flexor"][answered] < t["excitation_flexor"][1]  # it resists a push in flexion


def test_tremor_has_the_strength_and_frequency_asked_for() -> None:
    t = record(worn(device_of(), Wearer(worn=False, tremor_torque=0.3, tremor_frequency=6.0), REST), 24_000)
    assert np.std(t["tremor"]) == pytest.approx(0.3, rel=0.15)
    frequency, spectrum = welch(t["tremor"], 1 / PERIOD, nperseg=2000)
    assert frequency[np.argmax(spectrum)] == pytest.approx(6.0, rel=0.1)
    assert spectrum[frequency < 2.0].sum() < 0.02 * spectrum.sum()  # it does not move the arm slowly


def test_payload_put_into_the_hand_is_that_of_the_reference() -> None:
    profile = device_of(changes={"plant": {"orientation": "vertical"}})
    wearer, load = Wearer(payload_time=0.3), (0.4, 0.3)
    scenario = REACH.model_copy(update={"payload": Payload(mass=load[0], arm=load[1])})
    bare = pack(REACH, profile)[0]  # the device carries none of it
    trajectory = record(worn(profile, wearer, scenario), 400)
    expected = replay_worn(profile, bare, wearer, trajectory, payload=load)
    for name in ("angle", "elbow"):
        assert np.abs(expected[name] - trajectory[name]).max() < 2e-7
    without = record(worn(profile, wearer), 400)
    np.testing.assert_array_equal(without["elbow"][:121], trajectory["elbow"][:121])
    assert np.degrees(np.abs(without["elbow"] - trajectory["elbow"]).max()) > 3.0


def test_relaxed_arm_is_led_by_the_device() -> None:
    wearer = Wearer(guided=True, tone=0.3)
    t = record(worn(device_of(), wearer), 700)
    np.testing.assert_array_equal(t["setpoint"], t["intention"])
    assert (t["flexor"] == wearer.co_contraction).all()
    assert (t["extensor"] == wearer.co_contraction).all()
    assert np.degrees(t["elbow"][-1]) > 50.0


def test_wearer_moves_as_intended() -> None:
    move = {"time": 0.1, "angle_deg": 60, "duration": 0.8}
    scenario = Scenario(initial_angle_deg=40, moves=[move], noise_seed=1)
    t = record(worn(device_of(), Wearer(worn=False, anticipation=1.0), scenario), 700)
    assert np.degrees(np.abs(t["intention"] - t["elbow"])).max() < 3.0
    assert np.degrees(abs(t["intention"][-1] - t["elbow"][-1])) < 0.1
    assert np.degrees(t["intention"][-1]) == pytest.approx(60.0)


def test_admittance_lets_the_wearer_lead() -> None:
    led, held = (worn(device_of(), Wearer(), control="equilibrium-point") for _ in range(2))
    held.assist(0.0)
    led.assist(1.0)
    for simulation in (led, held):
        simulation.advance(600)
    assert led.read_worn("cuff_ise")[0] < 0.2 * held.read_worn("cuff_ise")[0]
    assert led.read_worn("effort")[0] < held.read_worn("effort")[0]


def test_devices_do_not_depend_on_their_neighbours() -> None:
    profile = device_of(cable={"friction": 0.2})
    many = WornSimulation(profile, 11)
    wearers = [Wearer(mass=60 + 3 * k, strength=0.7 + 0.1 * k, tremor_torque=0.02 * k) for k in range(11)]
    # Arms with and without weight in one block
    packed = np.concatenate([pack_wearer(each, PERIOD, k % 2 > 0, 0.1 * k, 0.2) for k, each in enumerate(wearers)])
    many.reset(np.repeat(pack(REACH, profile), 11), wearers=packed)
    many.command_tension(6.0)
    many.assist(0.8)
    many.advance(300)
    for device in (0, 7, 8, 10):
        one = WornSimulation(profile, 1)
        one.reset(pack(REACH, profile), wearers=packed[[device]])
        one.command_tension(6.0)
        one.assist(0.8)
        one.advance(300)
        assert one.read("angle")[0] == many.read("angle")[device]
        assert one.read_worn("effort")[0] == many.read_worn("effort")[device]


def test_snapshot_goes_on_with_the_same_bits() -> None:
    simulation = worn(device_of(cable={"friction": 0.2}), Wearer(tremor_torque=0.1))
    simulation.advance(123)
    state = simulation.get_state()
    simulation.advance(200)
    after = simulation.read_worn("elbow"), simulation.read_worn("tremor"), simulation.read("angle")
    simulation.set_state(state)
    simulation.advance(200)
    np.testing.assert_array_equal(
        after, (simulation.read_worn("elbow"), simulation.read_worn("tremor"), simulation.read("angle"))
    )
    with pytest.raises(AmulettError, match="has no wearers"):
        simulation.set_state(Simulation(device_of()).get_state())


def test_second_episode_equals_the_first() -> None:
    profile = device_of()
    simulation = worn(profile, Wearer())
    simulation.advance(300)
    first = simulation.read_worn("elbow")
    simulation.reset(pack(REACH, profile))
    simulation.command_tension(6.0)
    simulation.assist(0.8)
    simulation.advance(300)
    np.testing.assert_array_equal(first, simulation.read_worn("elbow"))


@pytest.mark.parametrize("assistance", [-0.1, 1.1, np.nan])
def test_assistance_out_of_range_is_refused(assistance: float) -> None:
    with pytest.raises(AmulettError, match="assistance"):
        worn(device_of(), Wearer()).assist(assistance)


def test_delay_that_is_too_long_is_refused() -> None:
    with pytest.raises(AmulettError, match=r"wearer.reflex_delay' is 0.4 s, 160 control ticks"):
        pack_wearer(Wearer(reflex_delay=0.4), PERIOD, False)


def test_cable_that_changes_too_fast_for_the_step_is_refused() -> None:
    cable = {"friction": 0.2, "bend_biceps_deg": 360.0, "bend_triceps_deg": 360.0}
    worn(device_of(substeps=1, cable=cable), Wearer())  # the most of the study
    sudden = cable | {"presliding": 3e-5}
    with pytest.raises(AmulettError, match=r"mu theta 1.26.*loop.substeps has to be at least 3$"):
        worn(device_of(substeps=1, cable=sudden), Wearer())
    worn(device_of(substeps=3, cable=sudden), Wearer())
    yields = {"drives": {"stall_torque": 0.285}}
    worn(device_of(substeps=1, changes=yields, cable=sudden | {"side": "drive"}), Wearer())


@pytest.mark.parametrize("drives", [{}, {"stall_torque": 0.3, "lag": 0.0}])
def test_cables_before_drives_that_do_not_yield_are_refused(drives: dict[str, float]) -> None:
    with pytest.raises(AmulettError, match=r"wearer.cable.side is drive.*drives.stall_torque.*set wearer.cable.side"):
        device_of(changes={"drives": drives}, cable={"friction": 0.1, "side": "drive"})
    device_of(changes={"drives": drives}, cable={"friction": 0.0, "side": "drive"})
    device_of(changes={"drives": drives}, cable={"friction": 0.1, "side": "joint"})


@pytest.mark.parametrize(
    ("cuff", "least"), [({"stiffness": 10_000.0, "damping": 0.0}, 2), ({"stiffness": 0.0, "damping": 50.0}, 12)]
)
def test_cuff_that_is_too_stiff_for_the_step_is_refused(cuff: dict[str, float], least: int) -> None:
    with pytest.raises(AmulettError, match=rf"loop.substeps has to be at least {least}$"):
        worn(device_of(1, cuff=cuff), Wearer())
    simulation = worn(device_of(least, cuff=cuff), Wearer())
    simulation.advance(400)
    assert simulation.read("failure")[0] == 0
    assert abs(simulation.read_worn("elbow")[0]) < 1.3


def test_arm_that_is_too_fast_for_the_step_is_refused_and_a_cuff_that_is_not_worn_is_not() -> None:
    light = Wearer(mass=20, height=1, tone=20, strength=20, co_contraction=1)
    with pytest.raises(AmulettError, match=r"the muscles \(tone and strength\) .* loop.substeps has to be at least 3$"):
        worn(device_of(1), light)
    loose = device_of(1, cuff={"stiffness": 10_000.0})
    with pytest.raises(AmulettError, match="wearer.cuff.stiffness"):
        worn(loose, Wearer())
    worn(loose, Wearer(worn=False))


def test_first_reset_needs_wearers_and_a_later_one_checks_the_last_ones() -> None:
    profile = device_of()
    with pytest.raises(AmulettError, match="has no wearer yet"):
        WornSimulation(profile).reset(pack(REACH, profile))
    simulation = worn(profile, Wearer())
    light = pack(REACH, profile)
    light["inertia"] *= 1e-4
    with pytest.raises(AmulettError, match="loop.substeps"):
        simulation.reset(light)
