"""Predictions a few rows ahead: with the true model nothing is left but noise."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from groundstation.dynamics.effect import FAR_M
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.identification.runs import CHANNELS as CHANNELS_OF_RUNS
from groundstation.prediction.drive import fresh_rows, height_of, reckoned_height
from groundstation.prediction.observer import Noise, gains_of
from groundstation.prediction.prediction import (
    airborne,
    fly_ahead,
    noise_of,
    observe_run,
    predict_ahead,
)
from support.flights import BASE, MEDIUM, affected, flown

HORIZONS = (10, 25)
SHOWS = {
    "dead_time": ("gyro z", 1.7),
    "gyro_low_pass": ("yaw", 5.0),
    "rotor_gyroscopic_torque": ("gyro y", 1.15),
    "rotor_acceleration_torque": ("gyro z", 10.0),
    "inertia_coupling": ("gyro y", 1.03),
    "rate_damping": ("gyro x", 1.4),
    "quadratic_rate_damping": ("gyro x", 1.6),
    "centre_of_gravity_offset": ("gyro y", 20.0),
    "rotor_mismatch": ("gyro x", 15.0),
    "motor_dead_voltage": ("accelerometer z", 8.0),
    "motor_braking_asymmetry": ("gyro z", 5.0),
    "supply_sag": ("accelerometer z", 2.0),
    "battery_reading_lag": ("accelerometer z", 1.01),
    "gyro_bias": ("yaw", 10.0),
    "accelerometer_bias": ("accelerometer z", 2.5),
    "imu_misalignment": ("accelerometer x", 3.0),
    "rotor_drag": ("accelerometer x", 1.1),
    "velocity_moment": ("gyro x", 4.0),
    "yaw_damping": ("gyro z", 2.0),
    "climb_inflow": ("accelerometer z", 1.02),
    "imu_lever_arm": ("accelerometer y", 1.01),
    "ground_effect": ("accelerometer z", 1.08),
    "attitude_filter_lean": ("roll", 5.0),
    "mass_change": ("accelerometer z", 3.0),
}
"""effect -> a channel in which the base model fails, and its error over the noise at least."""
USUAL = Noise()
ROUGH = replace(USUAL, torque=tuple(6.0 * one for one in USUAL.torque), force=6.0 * USUAL.force)
NOISIER = {name: 2.0 * getattr(USUAL, name) for name in ("accelerometer", "attitude")}
ROUGH = replace(ROUGH, gyro=tuple(2.0 * one for one in USUAL.gyro), **NOISIER)
CHANNELS = [f"{s} {a}" for s in ("gyro", "accelerometer") for a in "xyz"] + ["roll", "pitch", "yaw"]


def over_noise(model, run, noise=None):
    """RMS of prediction errors (2, 9) over what noise alone makes of a perfect model's."""
    error = predict_ahead(model, run, HORIZONS, noise=noise).errors(run)
    gains = gains_of(BASE, run.period_s, noise)
    floor = np.array([gains.expected(rows) for rows in HORIZONS])
    return np.sqrt(np.mean(error**2, axis=0)) / floor


@pytest.fixture(scope="module")
def clean():
    run, _ = flown(40.0, 1)
    return run


def test_on_a_clean_flight_errors_are_what_the_noise_makes_them(clean):
    assert over_noise(BASE, clean) == pytest.approx(1.0, abs=0.05)


def test_on_a_rough_flight_they_are_too():
    run, _ = flown(40.0, 2, torque_noise=6.0, sensor_noise=2.0)
    assert over_noise(BASE, run, ROUGH) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("name", MEDIUM)
def test_with_the_true_effect_in_the_model_only_noise_is_left(name):
    run, _ = flown(40.0, 3, name)
    channel, least = SHOWS[name]
    without, within = over_noise(BASE, run), over_noise(affected(name), run)
    assert without[:, CHANNELS.index(channel)].max() > least
    assert within.max() < 1.1


def test_two_filters_behind_the_gyro_are_both_followed_in_slow_rows():
    """An observer that corrected both by one number was three times as far off a row ahead."""
    half = {f"pid_rate.{axis}_kp": 125.0 for axis in ("roll", "pitch")}
    lag = {"gyro_low_pass": {"bandwidth_hz": 40.0}}
    run, _ = flown(40.0, 3, craft="crazyflie21", gains=half, effects=lag)
    chip = affected("gyro_low_pass", lag["gyro_low_pass"])
    board = affected("gyro_filter", {"corner_hz": 80.0})
    model = msgspec.structs.replace(
        vehicle_model(BUILT_IN["crazyflie21"]), effects=(*board.effects, *chip.effects)
    )
    slow = every_second_row(run)
    error = predict_ahead(model, slow, (1,)).errors(slow)[..., :3]
    assert (np.sqrt(np.mean(error**2, axis=0)) < 2.0 * np.array(Noise().gyro)).all()


def every_second_row(run):
    """The same at half the rate, with both settings of the motors."""
    rows = slice(1, None, 2)
    first, second = run.duty[:-1:2], run.duty[1::2]
    parts = {name: getattr(run, name)[rows] for name in CHANNELS_OF_RUNS}
    mean, step = 0.5 * (first + second), second - first
    return replace(run, **{**parts, "duty": mean, "duty_step": step}, period_s=2 * run.period_s)


def test_a_slung_load_is_predicted_from_the_ground_on():
    """Where its line is slack at first."""
    load = {"percent": 7.0, "length_m": 0.3, "damping_per_s": 0.4, "below_m": 0.01}
    run, _ = flown(40.0, 3, effects={"slung_load": load})
    without, within = over_noise(BASE, run), over_noise(affected("slung_load", load), run)
    assert without[:, CHANNELS.index("gyro x")].max() > 1.5
    assert within.max() < 1.1


def test_an_observer_follows_what_drifts_slowly():
    """Knowing spread and pace, it keeps moment and force, and a prediction begins with them."""
    blown = dict.fromkeys(("moment_x", "moment_y", "moment_z"), 2.0)
    blown |= dict.fromkeys(("force_x", "force_y", "force_z"), 0.3) | {"time_s": 2.0}
    run, _ = flown(40.0, 3, effects={"wind": blown})
    without, within = over_noise(BASE, run), over_noise(affected("wind", blown), run)
    assert without.max() > 2.0
    assert within.max() < 1.0 + 0.4 * (without.max() - 1.0)
    assert (within < without + 0.05).all()


def test_the_attitude_filter_of_2014_smooths_the_accelerometer_and_todays_does_not(clean):
    """Release 2014.01.0 takes an eighth of each sample; today's estimator what its sensors give."""
    felt = clean.accelerometer
    lean = affected("attitude_filter_lean")
    profile = msgspec.structs.replace(BUILT_IN["crazyflie1"], firmware="2.x")
    today = msgspec.structs.replace(lean, vehicle_profile=profile)
    old, new = (observe_run(model, clean).filters[:, 4:7] for model in (lean, today))
    aloft = slice(5000, 15000)
    change, expected = old[1:] - old[:-1], 0.125 * (felt[1:] - old[:-1])
    np.testing.assert_allclose(change[aloft], expected[aloft], atol=1e-9)
    np.testing.assert_allclose(new[aloft], felt[aloft], atol=1e-9)


def test_two_effects_at_once_are_both_accounted_for():
    names = ("dead_time", "velocity_moment")
    run, _ = flown(30.0, 4, effects={name: MEDIUM[name] for name in names})
    both = replace_effects(*names)
    assert over_noise(both, run).max() < 1.1
    assert over_noise(affected(names[0]), run).max() > 2.0


def replace_effects(*names):
    return msgspec.structs.replace(
        BASE, effects=tuple(term for name in names for term in affected(name).effects)
    )


def test_a_prediction_does_not_see_the_future(clean):
    """Measurements after a row change nothing that is predicted from it."""
    row = 8000
    seen = observe_run(BASE, clean)
    before = fly_ahead(clean, seen, [row], HORIZONS)
    gyro, attitude = clean.gyro.copy(), clean.attitude.copy()
    gyro[row + 1 :] += 1.0
    attitude[row + 1 :] *= 0.5
    changed = replace(clean, gyro=gyro, attitude=attitude)
    after = fly_ahead(changed, observe_run(BASE, changed), [row], HORIZONS)
    np.testing.assert_array_equal(before.gyro, after.gyro)
    np.testing.assert_array_equal(before.attitude, after.attitude)


def test_a_flight_in_pieces_is_observed_as_in_one(clean):
    whole = observe_run(BASE, clean)
    part = observe_run(BASE, clean[:9000])
    np.testing.assert_array_equal(whole.states[:9000], part.states)


def test_velocity_is_found_where_an_effect_shows_it():
    run, truth = flown(40.0, 5, "velocity_moment")
    seen = observe_run(affected("velocity_moment"), run)
    rows = airborne(seen, 1)
    error = seen.states[rows, 3:5] - truth["velocity_m_s"][rows, :2]
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert truth["velocity_m_s"][rows, :2].std() > 0.15


def test_height_is_reckoned_after_a_take_off_and_unknown_later():
    run, truth = flown(15.0, 6)
    seen = observe_run(BASE, run)
    height = height_of(reckoned_height(run), seen.flying)
    first = np.flatnonzero(seen.flying)[0]
    part = slice(first, first + 1000)
    np.testing.assert_allclose(height[part], truth["position_m"][part, 2], atol=0.05)
    assert height[-1] == FAR_M


def test_height_is_reckoned_from_where_motors_lift_not_from_where_they_idle():
    """An armed Brushless idles at 7000 of 65535 before it flies."""
    run, _ = flown(15.0, 6)
    height = reckoned_height(run)
    start = int(np.flatnonzero(np.isfinite(height))[0])
    duty = run.duty.copy()
    duty[start - 1000 : start] = 7000 / 65535
    idling = reckoned_height(replace(run, duty=duty))
    np.testing.assert_allclose(idling[start:], height[start:], atol=0.02)
    assert np.isinf(idling[:start]).all()


LOW = """name = "low"
[[segment]]
kind = "rest"
seconds = 3.0
[[segment]]
kind = "fly"
seconds = 4.0
height_m = 0.05
[[segment]]
kind = "fly"
seconds = 5.0
height_m = 0.8
"""


def test_a_low_hover_is_flight_to_a_model_that_has_too_little_thrust_there(tmp_path):
    path = tmp_path / "low.toml"
    path.write_text(LOW)
    strong = {"height_m": 0.08, "gain": 0.25}
    run, truth = flown(11.0, 6, program=str(path), effects={"ground_effect": strong})
    up = truth["position_m"][:, 2] > 0.02
    for model in (BASE, affected("ground_effect", strong)):
        np.testing.assert_array_equal(observe_run(model, run).flying[up][50:], True)


@pytest.mark.parametrize("offset_g", [0.05, -0.05])
def test_an_offset_of_the_accelerometer_is_not_taken_for_height(offset_g):
    """Integrated for 4 s, 0.05 g are 4 m: the ground would be missed, or seen high above it."""
    hidden = {"accelerometer_bias": {"z_g": offset_g}, "ground_effect": MEDIUM["ground_effect"]}
    run, truth = flown(9.0, 7, effects=hidden)
    terms = [term for name, sizes in hidden.items() for term in affected(name, sizes).effects]
    model = msgspec.structs.replace(BASE, effects=tuple(terms))
    height = height_of(reckoned_height(run), observe_run(model, run).flying)
    known = (height < FAR_M) & (height > 0.0)
    assert np.abs(height - truth["position_m"][:, 2])[known].max() < 0.1
    given = truth["position_m"][:, 2].copy()
    errors = [
        predict_ahead(model, run, HORIZONS, height_m=one).errors(run)[..., 5]
        for one in (None, given)
    ]
    assert np.std(errors[0]) < 1.05 * np.std(errors[1])


def test_lost_gyro_rows_are_bridged_by_the_model(clean):
    gyro = clean.gyro.copy()
    lost = np.random.default_rng(0).random(len(gyro)) < 0.02
    gyro[lost] = np.nan
    run = replace(clean, gyro=gyro)
    error = predict_ahead(BASE, run, HORIZONS).errors(run)
    whole = predict_ahead(BASE, clean, HORIZONS).errors(clean)
    ratio = np.sqrt(np.nanmean(error**2, axis=0) / np.mean(whole**2, axis=0))
    assert ratio.max() < 1.05


def test_without_attitude_or_accelerometer_rates_are_still_predicted(clean):
    nothing = np.full_like(clean.gyro, np.nan)
    run = replace(clean, attitude=nothing, accelerometer=nothing)
    error = predict_ahead(BASE, run, HORIZONS).errors(run)[..., :3]
    floor = gains_of(BASE, run.period_s).expected(25)[:3]
    assert np.sqrt(np.mean(error[:, 1] ** 2, axis=0)) / floor == pytest.approx(1.0, abs=0.06)


def test_a_leaning_filter_is_predicted_as_well_where_held_angles_are_left_out():
    run, _ = flown(30.0, 3, "attitude_filter_lean")
    model = affected("attitude_filter_lean")
    whole = predict_ahead(model, run, HORIZONS)
    fresh = fresh_rows(run.attitude)
    shown = replace(run, attitude=np.where(fresh[:, None], run.attitude, np.nan))
    part = predict_ahead(model, shown, HORIZONS)
    np.testing.assert_array_equal(part.rows, whole.rows)
    angle = np.abs(np.angle(np.exp(1j * (part.attitude - whole.attitude))))
    new = fresh[part.rows[:, None] + part.horizons]
    assert new.any()
    assert angle[new].max() < 1e-9


def test_a_run_without_gyro_or_voltage_is_refused(clean):
    dark = replace(clean, supply_v=np.full(len(clean), np.nan))
    with pytest.raises(BadInputError, match="supply_v is missing"):
        predict_ahead(BASE, dark)
    blind = replace(clean, gyro=np.full_like(clean.gyro, np.nan))
    with pytest.raises(BadInputError, match="gyro is missing"):
        predict_ahead(BASE, blind)


def test_horizons_must_lie_ahead_and_inside_the_run(clean):
    seen = observe_run(BASE, clean)
    with pytest.raises(ValueError, match="1 or more, ascending"):
        fly_ahead(clean, seen, [100], [0, 10])
    with pytest.raises(ValueError, match="leave the run"):
        fly_ahead(clean, seen, [len(clean) - 5], [10])


def test_the_noise_of_a_flight_is_found_from_it(clean):
    found = noise_of(BASE, clean)
    assert found.torque == pytest.approx(Noise().torque, rel=0.2)
    assert found.gyro == pytest.approx(Noise().gyro, rel=0.2)
    rough, _ = flown(20.0, 2, torque_noise=6.0, sensor_noise=2.0)
    found = noise_of(BASE, rough)
    assert found.torque == pytest.approx(ROUGH.torque, rel=0.2)
    assert found.gyro == pytest.approx(ROUGH.gyro, rel=0.2)


def test_gains_that_know_the_vibration_predict_the_attitude_of_a_real_craft_better():
    run, _ = flown(30.0, 9, plant="faithful", effects={})
    angles = []
    for noise in (None, noise_of(BASE, run)):
        error = predict_ahead(BASE, run, HORIZONS, noise=noise).errors(run)[..., 6:8]
        angles.append(np.sqrt(np.mean(error**2)))
    assert angles[1] < 0.8 * angles[0]


def test_noise_cannot_be_judged_on_the_ground(clean):
    with pytest.raises(BadInputError, match="less than a second in the air"):
        noise_of(BASE, clean[:500])
