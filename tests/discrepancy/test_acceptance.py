"""Each gate refuses what it is there for, with a reason that a program can compare."""

import numpy as np
import pytest

from groundstation.discrepancy.acceptance import (
    JOINED,
    NAMED,
    SCREENED,
    SHAKEN,
    WEIGHED,
    Last,
    is_significant,
    refusal,
)
from groundstation.discrepancy.proof import Reason, Weight
from groundstation.discrepancy.screening import Evidence, Scored
from groundstation.identification.body_setup import open_delay_s
from groundstation.identification.likelihood.motion import VARIANTS
from groundstation.identification.likelihood.problem import Fit

GYRO_Z, FORCE_Z = 2, 5
VARIANT = {one.effect: one for one in VARIANTS}


def reason(gates, asked):
    found = refusal(gates, asked)
    return None if found is None else found.reason


def scored(drop, size, effect="rate_damping"):
    return Scored(VARIANT[effect], drop, np.array([size]), np.array([1e-7]))


def weighed(point, effect="rate_damping", **found):
    """Why an effect with these sizes and strong evidence, but for ``found``, is refused."""
    found = {"drop": 1000.0, "held_out": 400.0, "expected": 500.0, "t": 30.0, **found}
    return reason(WEIGHED, Evidence(VARIANT[effect], point, channels=(GYRO_Z, FORCE_Z), **found))


def named(fit, effect="rate_damping", **last):
    return reason(NAMED, Last(VARIANT[effect], fit, **last))


def damped(size):
    return {"rate_damping.damping_n_m_s": size}


def fit(point):
    """A joint fit that knows each size to a tenth."""
    return Fit(point, tuple(point), 0.0, np.diag([(0.1 * size) ** 2 for size in point.values()]))


DAMPED = fit(damped(1e-5))


def test_what_the_screening_finds_too_weak_is_not_fitted():
    assert reason(SCREENED, scored(9.0, 1e-6)) is Reason.WEAK
    assert reason(SCREENED, scored(25.0, 1e-6)) is None


def test_a_damping_that_drives_is_no_damping():
    assert reason(SCREENED, scored(900.0, -1e-5)) is Reason.WRONG_SIGN


@pytest.mark.parametrize(
    ("size", "found", "why"),
    [
        (1.0, {}, Reason.IMPLAUSIBLE),
        (1e-5, {"t": 4.0}, Reason.INSIGNIFICANT),
        (1e-5, {"drop": 12.0}, Reason.INSIGNIFICANT),
        (1e-5, {"held_out": 50.0}, Reason.NOT_HELD_OUT),
        (1e-5, {}, None),
    ],
)
def test_evidence_has_to_be_plausible_strong_and_hold_on_other_rows(size, found, why):
    assert weighed(damped(size), **found) is why


def test_what_the_others_do_as_well_without_leaves():
    assert reason(JOINED, 5.0) is Reason.SUPERFLUOUS
    assert reason(JOINED, 50.0) is None


def test_what_other_rows_would_not_choose_is_possible_and_not_named():
    assert named(DAMPED, recurrence=0.59) is Reason.NOT_RECURRENT
    assert named(DAMPED, recurrence=0.6) is None


def test_a_size_by_which_flights_differ_as_much_is_possible_and_not_named():
    (key,) = VARIANT["rate_damping"].sizes
    assert named(DAMPED, errors={key: 4e-6}) is Reason.RECORDINGS_DISAGREE
    assert named(DAMPED, errors={key: 3e-6}) is None


def test_a_size_that_is_doubtful_for_its_shape_alone_is_sure():
    gain, reach = VARIANT["ground_effect"].sizes[0], "ground_effect.height_m"
    for correlation, why in ((0.99, None), (0.5, Reason.RECORDINGS_DISAGREE)):
        spread = np.array([[0.15, 0.0], [0.0, 0.02]])
        known = spread @ np.array([[1.0, correlation], [correlation, 1.0]]) @ spread
        place = Fit({gain: 0.3, reach: 0.1}, (gain, reach), 0.0, known)
        assert named(place, "ground_effect", errors={gain: 0.15}) is why


def test_of_several_sizes_one_that_is_sure_is_enough():
    sizes = VARIANT["accelerometer_bias"].sizes
    place = Fit(dict.fromkeys(sizes, 0.02), tuple(sizes), 0.0, 1e-8 * np.eye(len(sizes)))
    doubtful = dict.fromkeys(sizes, 0.02)
    kinds = (doubtful, Reason.RECORDINGS_DISAGREE), (doubtful | {sizes[1]: 0.001}, None)
    for errors, why in kinds:
        assert named(place, "accelerometer_bias", errors=errors) is why


def test_what_predictions_hardly_need_is_possible_and_not_named():
    for carried, why in (
        (Weight(0.1, 0.01, 0.5), None),
        (Weight(0.1, 0.01, 0.01), Reason.WITHOUT_WEIGHT),
        (Weight(-0.001, 0.01, 0.5), Reason.WITHOUT_WEIGHT),
        (None, None),
    ):
        assert named(DAMPED, weight=carried) is why


def test_a_bias_within_the_firmwares_own_rounding_is_no_effect():
    small, large = (dict.fromkeys(VARIANT["gyro_bias"].keys, size) for size in (0.05, 0.2))
    for point, why in ((small, Reason.NEGLIGIBLE), (large, None)):
        place = Fit(point, tuple(point), 0.0, np.eye(len(point)))
        assert named(place, "gyro_bias") is why


def test_a_gyro_that_lags_no_more_than_its_chip_always_does_is_no_effect():
    # 218 and 282 Hz were named on a faithful craft without one, whose delay was told apart by
    # half a millisecond in the gyro and in the accelerometer
    (key,) = VARIANT["gyro_low_pass"].keys
    for hz, why in ((218.0, Reason.NEGLIGIBLE), (60.0, None)):
        place = Fit({key: 1.0 / (2.0 * np.pi * hz)}, (key,), 0.0, np.eye(1))
        assert named(place, "gyro_low_pass") is why


def test_what_the_model_has_without_a_name_is_told_with_its_size():
    (key,) = VARIANT["gyro_low_pass"].keys
    place = Fit({key: 0.9e-3}, (key,), 0.0, np.eye(1))
    found = refusal(NAMED, Last(VARIANT["gyro_low_pass"], place))
    assert found.words.startswith("bandwidth_hz 177 Hz fitted, but no effect: the chip")


@pytest.mark.parametrize(
    ("drop", "beyond", "why"),
    [
        (700.0, 25.0, Reason.BETWEEN_ROWS),  # battery_reading_lag, clean flights at 100 rows/s
        (25.0, 15.0, Reason.BETWEEN_ROWS),
        (700.0, 650.0, None),
        (700.0, np.inf, None),
    ],
)
def test_what_settings_that_no_row_shows_can_do_as_well_has_no_name(drop, beyond, why):
    assert weighed(damped(1e-6), drop=drop, beyond=beyond) is why


@pytest.mark.parametrize(
    ("rows_hz", "delay_s", "why"),
    [
        (250.0, 0.0005, Reason.NEGLIGIBLE),
        (250.0, 0.0015, None),
        (500.0, 0.0005, None),
        (100.0, 0.003, Reason.NEGLIGIBLE),
    ],
)
def test_a_delay_that_slow_rows_leave_open_is_no_effect(rows_hz, delay_s, why):
    late = fit({"dead_time.delay_s": delay_s})
    assert named(late, "dead_time", open_s=open_delay_s(1.0 / rows_hz)) is why


@pytest.mark.parametrize(
    ("effect", "point", "why"),
    [
        ("supply_sag", {"resistance_ohm": -0.0036}, Reason.IMPLAUSIBLE),
        ("supply_sag", {"resistance_ohm": 0.05}, None),
        ("ground_effect", {"gain": 0.3, "height_m": 0.01}, Reason.IMPLAUSIBLE),
        ("ground_effect", {"gain": 0.3, "height_m": 0.05}, None),
        ("ground_effect", {"gain": 0.08, "height_m": 0.05}, None),
    ],
)
def test_a_size_has_to_be_one_that_a_craft_can_have(effect, point, why):
    assert weighed({f"{effect}.{size}": value for size, value in point.items()}, effect) is why


@pytest.mark.parametrize(
    ("t", "drop", "is_more"), [(4.0, 90.0, False), (9.0, 12.0, False), (9.0, 90.0, True)]
)
def test_what_drifts_has_to_last(t, drop, is_more):
    assert is_significant(t, drop) is is_more


def test_every_gate_has_a_reason_of_its_own():
    for gates in ((*SCREENED, *WEIGHED, *JOINED, *NAMED), SHAKEN):
        assert len({why for why, _ in gates}) == len(gates)
