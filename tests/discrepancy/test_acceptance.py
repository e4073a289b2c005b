"""Each gate refuses what it is there for, with a reason that a program can compare."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.discrepancy.acceptance import (
    GATES,
    LASTING_GATES,
    Lasting,
    Stage,
    Trial,
    lasting_refusal,
    refusal,
)
from groundstation.discrepancy.evidence import Evidence
from groundstation.discrepancy.findings import Reason
from groundstation.discrepancy.screening import Scored
from groundstation.discrepancy.search_state import Accepted, SearchState
from groundstation.discrepancy.settlement import confirm
from groundstation.dynamics.model import Estimate
from groundstation.dynamics.registry import EFFECTS
from groundstation.identification.body.certainty import open_delay_s
from groundstation.identification.likelihood.parameters import VARIANTS
from groundstation.identification.likelihood.problem import Fit

GYRO_Z, FORCE_Z = 2, 5
VARIANT = {one.effect: one for one in VARIANTS}


def evidence(parts=None, drop=1000.0, held_out=400.0, expected=500.0, t=30.0):
    return Evidence(drop, held_out, expected, t, parts or {}, (2.0, 1.0), (GYRO_Z, FORCE_Z))


def said(stage, effect="rate_damping", **trial):
    found = refusal(stage, Trial(VARIANT[effect], **trial))
    return None if found is None else found.reason


def scored(drop, size, effect="rate_damping"):
    return Scored(VARIANT[effect], drop, np.array([size]), np.array([1e-7]))


def fit(**point):
    """A joint fit that knows each size to a tenth."""
    sizes = {key.replace("__", "."): size for key, size in point.items()}
    return Fit(sizes, tuple(sizes), 0.0, np.diag([(0.1 * size) ** 2 for size in sizes.values()]))


def test_what_the_screening_finds_too_weak_is_not_fitted():
    assert said(Stage.SCREENED, scored=scored(9.0, 1e-6)) is Reason.WEAK
    assert said(Stage.SCREENED, scored=scored(25.0, 1e-6)) is None


def test_a_damping_that_drives_is_no_damping():
    assert said(Stage.SCREENED, scored=scored(900.0, -1e-5)) is Reason.WRONG_SIGN


def test_what_another_effect_explains_three_times_as_well_waits():
    assert said(Stage.FITTED, gain=30.0, best=(100.0, "dead_time")) is Reason.EXPLAINS_LESS
    assert said(Stage.FITTED, gain=40.0, best=(100.0, "dead_time")) is None
    assert said(Stage.FITTED, gain=-1.0) is Reason.EXPLAINS_LESS


@pytest.mark.parametrize(
    ("size", "found", "reason"),
    [
        (1.0, {}, Reason.IMPLAUSIBLE),
        (1e-5, {"t": 4.0}, Reason.INSIGNIFICANT),
        (1e-5, {"drop": 12.0}, Reason.INSIGNIFICANT),
        (1e-5, {"held_out": 50.0}, Reason.NOT_HELD_OUT),
        (1e-5, {}, None),
    ],
)
def test_evidence_has_to_be_plausible_strong_and_hold_on_other_rows(size, found, reason):
    place = fit(rate_damping__damping_n_m_s=size)
    assert said(Stage.WEIGHED, fit=place, evidence=evidence(**found)) is reason


def test_the_same_set_of_effects_does_not_join_twice():
    place = fit(rate_damping__damping_n_m_s=1e-5)
    tried = said(Stage.WEIGHED, fit=place, evidence=evidence(), tried=True)
    assert tried is Reason.TRIED_BEFORE


def test_what_the_others_do_as_well_without_leaves():
    assert said(Stage.JOINED, removal=5.0) is Reason.SUPERFLUOUS
    assert said(Stage.JOINED, removal=50.0) is None


def test_channels_that_both_show_an_effect_have_to_agree_on_it():
    parts = {(0, GYRO_Z): (0.2, 0.05), (0, FORCE_Z): (1.4, 0.04), (1, FORCE_Z): (1.4, 0.04)}
    assert said(Stage.STABLE, evidence=evidence(parts)) is Reason.CHANNELS_DISAGREE


def test_recordings_have_to_agree_too():
    parts = {(0, FORCE_Z): (0.3, 0.04), (1, FORCE_Z): (1.6, 0.04)}
    assert said(Stage.STABLE, evidence=evidence(parts)) is Reason.RECORDINGS_DISAGREE


def test_a_channel_is_no_veto_that_is_explained_better_with_the_size_than_without():
    # of a delay of 3 ms eckart12's yaw rate tells twice as much, beside too small a rotor inertia
    parts = {(0, GYRO_Z): (1.8, 0.05), (0, FORCE_Z): (0.87, 0.02)}
    assert said(Stage.STABLE, evidence=evidence(parts)) is None
    parts[0, GYRO_Z] = (-1.8, 0.05)
    assert said(Stage.STABLE, evidence=evidence(parts)) is Reason.CHANNELS_DISAGREE


def test_a_channel_that_hardly_shows_it_is_no_veto():
    # supply_sag beside a dead time that is not quite right yet: the yaw rate knows 0.6 % of it
    parts = {(0, GYRO_Z): (-2.1, 0.32), (0, FORCE_Z): (1.05, 0.03), (1, FORCE_Z): (0.91, 0.04)}
    assert said(Stage.STABLE, evidence=evidence(parts)) is None


def test_a_name_for_a_hundredth_of_what_is_wrong_is_no_explanation():
    assert said(Stage.LEFT, evidence=evidence(), slow={GYRO_Z: 30000.0}) is Reason.DROWNED
    assert said(Stage.LEFT, evidence=evidence(), slow={}) is None
    # ... unless held-out predictions say that it is much of what is wrong
    assert said(Stage.LEFT, evidence=evidence(), slow={GYRO_Z: 30000.0}, predicted=0.5) is None


def test_a_bias_within_the_firmwares_own_rounding_is_no_effect():
    small, large = (dict.fromkeys(VARIANT["gyro_bias"].keys, size) for size in (0.05, 0.2))
    for point, reason in ((small, Reason.NEGLIGIBLE), (large, None)):
        place = Fit(point, (), 0.0, np.eye(0))
        assert said(Stage.NAMED, "gyro_bias", fit=place) is reason


def test_a_gyro_that_lags_no_more_than_its_chip_always_does_is_no_effect():
    # 218 and 282 Hz were named on a faithful craft without one, whose delay was told apart by
    # half a millisecond in the gyro and in the accelerometer
    (key,) = VARIANT["gyro_low_pass"].keys
    for hz, reason in ((218.0, Reason.NEGLIGIBLE), (60.0, None)):
        place = Fit({key: 1.0 / (2.0 * np.pi * hz)}, (), 0.0, np.eye(0))
        assert said(Stage.NAMED, "gyro_low_pass", fit=place) is reason


def test_what_the_model_has_without_a_name_is_told_with_its_size():
    (key,) = VARIANT["gyro_low_pass"].keys
    place = Fit({key: 0.9e-3}, (), 0.0, np.eye(0))
    found = refusal(Stage.NAMED, Trial(VARIANT["gyro_low_pass"], fit=place))
    assert found.words.startswith("bandwidth_hz 177 Hz fitted, but no effect: the chip")


@pytest.mark.parametrize(
    ("drop", "beyond", "reason"),
    [
        (700.0, 25.0, Reason.BETWEEN_ROWS),  # battery_reading_lag, clean flights at 100 rows/s
        (25.0, 15.0, Reason.BETWEEN_ROWS),
        (700.0, 650.0, None),
        (700.0, np.inf, None),
    ],
)
def test_what_settings_that_no_row_shows_can_do_as_well_has_no_name(drop, beyond, reason):
    one = replace(evidence(drop=drop), beyond=beyond)
    place = fit(rate_damping__damping_n_m_s=1e-6)
    assert said(Stage.WEIGHED, fit=place, evidence=one) is reason


@pytest.mark.parametrize(
    ("rows_hz", "delay_s", "reason"),
    [
        (250.0, 0.0005, Reason.NEGLIGIBLE),
        (250.0, 0.0015, None),
        (500.0, 0.0005, None),
        (100.0, 0.003, Reason.NEGLIGIBLE),
    ],
)
def test_a_delay_that_slow_rows_leave_open_is_no_effect(rows_hz, delay_s, reason):
    place = fit(dead_time__delay_s=delay_s)
    open_s = open_delay_s(1.0 / rows_hz)
    assert said(Stage.NAMED, "dead_time", fit=place, open_s=open_s) is reason


@pytest.mark.parametrize(
    ("effect", "point", "reason"),
    [
        ("supply_sag", {"supply_sag__resistance_ohm": -0.0036}, Reason.IMPLAUSIBLE),
        ("supply_sag", {"supply_sag__resistance_ohm": 0.05}, None),
        (
            "ground_effect",
            {"ground_effect__gain": 0.3, "ground_effect__height_m": 0.01},
            Reason.IMPLAUSIBLE,
        ),
        ("ground_effect", {"ground_effect__gain": 0.3, "ground_effect__height_m": 0.05}, None),
        ("ground_effect", {"ground_effect__gain": 0.08, "ground_effect__height_m": 0.05}, None),
    ],
)
def test_a_size_that_the_last_fit_left_has_to_be_one_that_a_craft_can_have(effect, point, reason):
    assert said(Stage.SETTLED, effect, fit=fit(**point)) is reason


@pytest.mark.parametrize(
    ("found", "reason"),
    [({"t": 4.0}, Reason.INSIGNIFICANT), ({"drop": 12.0}, Reason.INSIGNIFICANT), ({}, None)],
)
def test_what_drifts_has_to_last(found, reason):
    given = {"parameters": {"force_x": Estimate(0.5)}, "t": 9.0, "drop": 90.0}
    refused = lasting_refusal(Stage.WEIGHED, Lasting(EFFECTS["wind"], **{**given, **found}))
    assert (refused and refused.reason) is reason


class LastFits(SearchState):
    """The end of a search: the sizes that a fit leaves, by the names that are in it."""

    def __init__(self, left):
        self.accepted = [Accepted(VARIANT[name], evidence(drop=d), []) for name, d in DROPS.items()]
        self.left, self.held, self.refused, self.judge = left, set(), {}, None
        self.now = self.refit(self.accepted, self.held)

    def refit(self, accepted, held):
        return fit(**self.left[tuple(one.variant.effect for one in accepted)])


DROPS = {"rate_damping": 5000.0, "supply_sag": 100.0}


def test_an_impossible_size_leaves_in_the_end_and_the_others_are_fitted_again():
    both = {"rate_damping__damping_n_m_s": -1e-6, "supply_sag__resistance_ohm": -0.0036}
    search = LastFits(
        {tuple(DROPS): both, ("rate_damping",): {"rate_damping__damping_n_m_s": 1e-5}}
    )
    assert confirm(search)
    assert [one.variant.effect for one in search.accepted] == ["rate_damping"]
    assert search.now.point == {"rate_damping.damping_n_m_s": 1e-5}
    assert search.refused["supply_sag"].reason is Reason.IMPLAUSIBLE
    assert not confirm(search)


def test_what_the_last_fits_left_next_to_nothing_of_has_no_name():
    both = {"rate_damping__damping_n_m_s": 1e-5, "supply_sag__resistance_ohm": 0.02}
    search = LastFits(
        {tuple(DROPS): both, ("rate_damping",): {"rate_damping__damping_n_m_s": 1e-5}}
    )
    doubt = np.diag([1e-6**2, 0.02**2])
    search.now = replace(search.now, covariance=doubt)
    assert confirm(search)
    assert [one.variant.effect for one in search.accepted] == ["rate_damping"]
    assert search.refused["supply_sag"].reason is Reason.SUPERFLUOUS


def test_every_gate_has_a_reason_of_its_own():
    for gates in (GATES, LASTING_GATES):
        reasons = [reason for _, reason, _ in gates]
        assert len(set(reasons)) == len(reasons)
