"""Designs: on the front that an independent search finds, robust to what the fit is unsure of."""

import functools
import json
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.optimize import differential_evolution
from scipy.signal import lfilter

from firmware_sim.craft import StandIn, StandInSettings
from groundstation.control.design import (
    DESIGN_BAND,
    OVERSHOOT,
    OVERSHOOT_MORE,
    RMS,
    SENSITIVITY,
    SETTLING,
    WINDOW_S,
    Budget,
    Limits,
    Robustness,
    cascade_limits,
    corners,
    criterion,
    design_cascade,
    design_direct,
    direct_bounds,
    draws,
    limits_beside,
    moved,
    pareto_front,
    require_certain,
    robustness,
)
from groundstation.control.firmware_loop import (
    CascadeJudge,
    cascade_loop,
    firmware_of_gains,
    gains_text,
    load_gains,
    plant_of_model,
    require_gains_of,
    run_cascade,
    step_response,
)
from groundstation.control.firmwares import PLATFORMS, RELEASE_2014, PidGains
from groundstation.control.linear_loop import axis_plant
from groundstation.control.metrics import step_metrics
from groundstation.control.report import firmware_page, firmware_report
from groundstation.dynamics.model import (
    THESIS,
    EffectTerm,
    Estimate,
    load_model,
    save_model,
    vehicle_model,
)
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import SAMPLE_PERIOD_S
from groundstation.telemetry.samples import RawBatch

DATA = Path(__file__).parent / "data"
MODEL = load_model(DATA / "body.json")
TS = 0.002
SMALL = Budget(first=200, population=16, generations=20)
"""Enough to find good gains, not the best."""
LIMITS = cascade_limits()


def independent(plant, gains, omega=np.geomspace(0.1, 1570, 300), rows=1000):
    """Overshoot %, settling s, offset, maximum sensitivity, RMS, by polynomials and roots alone."""
    kp, ki, kd = gains
    law = np.array([kp + kd / TS, ki * TS - kp - 2 * kd / TS, kd / TS])
    forward = np.concatenate([np.zeros(plant.nk), np.convolve(plant.b, law)])
    alone = np.convolve([1.0, *plant.a], [1, -1])
    whole = np.zeros(max(len(forward), len(alone)))
    whole[: len(alone)] += alone
    whole[: len(forward)] += forward
    if np.abs(np.roots(whole)).max() >= 1:
        return None
    y = lfilter(forward, whole, np.ones(rows))
    q = np.exp(-1j * omega * TS)
    loop = np.polyval(forward[::-1], q) / np.polyval(alone[::-1], q)
    end = y[-rows // 10 :].mean()
    outside = np.flatnonzero(np.abs(y - end) > 0.05)
    last = outside[-1] + 1 if len(outside) else 0
    settling = last * TS if last < rows - rows // 10 else np.inf
    peak, rms = 1 / np.abs(1 + loop).min(), np.sqrt(np.mean((1 - y) ** 2))
    return 100 * max(y.max() - 1, 0), settling, abs(1 - end), peak, rms


def smallest_product(plant):
    """ln of RMS x settling x (overshoot + 5) x maximum sensitivity, the smallest that an
    independent search finds with a maximum sensitivity of 2 at most."""
    low, high = direct_bounds(plant)

    def cost(logarithms):
        found = independent(plant, np.exp(logarithms))
        if found is None:
            return 1e3
        high_by, settling, offset, peak, rms = found
        missed = max(peak / 2 - 1, 0) + max(offset / 0.02 - 1, 0)
        if not np.isfinite(settling):
            return 100 + missed
        return np.log(rms * settling * (high_by + 5) * peak) if missed == 0 else 20 + missed

    bounds = list(zip(np.log(low), np.log(high), strict=True))
    return differential_evolution(cost, bounds, seed=1, maxiter=60, popsize=12, tol=1e-6)


def test_the_design_is_the_best_of_an_independent_search():
    """(7.27): no gains within the limits have a product that is 5 % smaller. With eight samples an
    unstable pole costs overshoot whatever the gains: known before this code and without it."""
    plant = axis_plant(THESIS, "roll", 8)
    gains, design, margins = design_direct(plant, Limits(delay_s=0.0))
    assert margins.max_sensitivity <= 2.005
    assert design.calmest == pytest.approx(69, abs=1)
    assert design.fastest == pytest.approx(0.256, abs=0.004)
    ours = independent(plant, gains.as_tuple())
    assert ours[3] <= 2.005
    assert ours[0] == pytest.approx(design.judgement[OVERSHOOT], rel=1e-6)
    assert ours[1] == pytest.approx(design.judgement[SETTLING])
    assert ours[4] == pytest.approx(design.judgement[RMS])
    theirs = smallest_product(plant)
    assert theirs.fun < 20
    assert criterion(design.judgement[None])[0] <= theirs.fun + 0.05


def test_no_figure_of_a_neighbour_is_better_without_another_that_is_worse():
    """As the report shows neighbours: a gain 25 % larger or 20 % smaller."""
    one = designed_yaw()
    plants = [plant_of_model(other) for other in corners(MODEL, "yaw")]
    stock = {"pid_rate.yaw_kp": 50.0, "pid_rate.yaw_ki": 25.0}
    judge = CascadeJudge(plants, "yaw", WINDOW_S, 0.002, band=DESIGN_BAND, beside=stock)
    gains = np.array(list(one.gains.values()))
    scales = [np.where(np.arange(2) == index, by, 1.0) for index in range(2) for by in (1.25, 0.8)]
    own, *others = judge(np.array([gains, *(gains * scale for scale in scales)]))
    figures, most = [RMS, OVERSHOOT, SETTLING, SENSITIVITY], limits_beside(one.before, LIMITS).most
    for other in others:
        assert (other[figures] > own[figures]).any() or (other > most).any()


@pytest.mark.parametrize("axis", ["roll", "yaw"])
def test_no_design_is_worse_than_the_stock_gains_by_the_criterion(axis):
    (one,) = design_cascade(vehicle_model(BUILT_IN["crazyflie1"]), [axis], LIMITS, budget=SMALL)
    assert criterion(one.nominal[None])[0] <= criterion(one.stock_nominal[None])[0]


def test_a_sensitivity_that_somebody_asks_for_is_kept_whatever_the_stock_gains_do():
    model = vehicle_model(BUILT_IN["crazyflie21"])
    (borne,) = design_cascade(model, ["yaw"], cascade_limits(), budget=SMALL)
    (asked,) = design_cascade(model, ["yaw"], cascade_limits(1.8), budget=SMALL)
    assert borne.before[SENSITIVITY] > 2.0
    assert 2.0 < borne.design.judgement[SENSITIVITY] <= 1.001 * borne.before[SENSITIVITY]
    assert asked.design.judgement[SENSITIVITY] <= 1.8


def test_what_no_gains_can_do_is_refused_with_the_best_there_is():
    with pytest.raises(BadInputError, match="smallest maximum sensitivity found is 1"):
        design_direct(axis_plant(THESIS, "roll", 8), Limits(sensitivity=1.3), budget=SMALL)
    with pytest.raises(BadInputError, match="delay is too long"):
        design_direct(axis_plant(THESIS, "roll", 80), Limits(), budget=SMALL)


def test_the_front_holds_what_nothing_beats():
    generator = np.random.default_rng(0)
    costs = generator.random((300, 3)).round(2)
    front = set(pareto_front(costs).tolist())
    for row, cost in enumerate(costs):
        beaten = ((costs <= cost).all(axis=1) & (costs < cost).any(axis=1)).any()
        first = np.flatnonzero((costs == cost).all(axis=1))
        assert (row in front) == (not beaten) or (not beaten and front & set(first.tolist()))


@functools.cache
def designed_yaw():
    (one,) = design_cascade(MODEL, ["yaw"], cascade_limits(), budget=SMALL)
    return one


def test_a_design_for_the_firmware_keeps_its_limits_and_beats_stock_gains():
    """Yaw alone, the cheapest; roll and pitch are designed by the same code in the bench."""
    one = designed_yaw()
    stock = CascadeJudge([plant_of_model(MODEL)], "yaw", WINDOW_S)(np.array([[50.0, 25.0]]))[0]
    assert one.nominal[SENSITIVITY] <= 2.0
    assert one.nominal[SETTLING] < 0.6 * stock[SETTLING]
    assert one.nominal[OVERSHOOT] < stock[OVERSHOOT]
    worst = [plant_of_model(other) for other in corners(MODEL, "yaw")]
    judged = CascadeJudge(worst, "yaw", WINDOW_S, 0.002, band=DESIGN_BAND)
    row = judged(np.array([list(one.gains.values())]))[0]
    assert row[SENSITIVITY] <= 2.0
    assert np.isfinite(row[SETTLING])
    assert len(one.reasons) == len(one.gains) == 2
    assert all(name in reason for name, reason in zip(one.gains, one.reasons, strict=True))


def test_what_cannot_win_is_not_flown_and_nothing_else_changes():
    one = designed_yaw()
    judge = CascadeJudge([plant_of_model(MODEL)], "yaw", WINDOW_S)
    gains = np.array([[50.0, 25.0], list(one.gains.values())])
    whole = judge(gains)
    half = judge(gains, lambda rows, judgements: rows == 1)
    np.testing.assert_array_equal(half[1], whole[1])
    assert np.isinf(half[0]).all()


def pushed_deg_s(gains):
    """What a craft of today, off balance by 3 mm, leans from level in 4 s: the sum."""
    model = vehicle_model(BUILT_IN["crazyflie21"])
    off = EffectTerm("centre_of_gravity_offset", {"x_m": Estimate(0.0), "y_m": Estimate(0.003)})
    plant = plant_of_model(msgspec.structs.replace(model, effects=(off,)), fusion=False)
    flown = run_cascade(plant, gains, np.zeros((round(4.0 / SAMPLE_PERIOD_S), 3)))
    return float(np.degrees(np.abs(flown.angles[:, 0])).sum() * SAMPLE_PERIOD_S)


def test_designed_gains_answer_a_moment_that_lasts_as_soon_as_the_stock_gains():
    model = vehicle_model(BUILT_IN["crazyflie21"])
    (one,) = design_cascade(model, ["roll"], cascade_limits(), budget=SMALL)
    gains, judged, stock = one.gains, one.design.judgement, one.before
    assert (judged[[RMS, SETTLING]] < stock[[RMS, SETTLING]]).all()
    assert judged[OVERSHOOT] <= stock[OVERSHOOT] + OVERSHOOT_MORE
    assert pushed_deg_s(gains) <= 1.1 * pushed_deg_s({})
    lazy = {**gains, "pid_rate.roll_ki": 2.0}
    assert pushed_deg_s(lazy) > 1.5 * pushed_deg_s({})


def test_the_stored_gains_hold_on_models_drawn_from_the_covariance():
    gains = load_gains(DATA / "gains.toml")
    tried = robustness(MODEL, gains, ["roll", "pitch", "yaw"], count=60)
    assert tried.stable == {"roll": 60, "pitch": 60, "yaw": 60}
    assert all(table[:, SENSITIVITY].max() < 2.0 for table in tried.judgements.values())
    assert robustness(THESIS, gains, ["roll"], count=5) is None


def test_stand_ins_drawn_from_the_covariance_fly(tmp_path):
    gains = load_gains(DATA / "gains.toml")
    crafts = []
    for number, model in enumerate(draws(MODEL, 20, seed=5)):
        path = tmp_path / f"{number}.json"
        save_model(msgspec.structs.replace(model, fit={}), path)
        crafts.append(
            StandInSettings(plant="reduced", craft=str(path), gains=dict(gains), seed=number)
        )

    def steady(craft):
        packets, heard_s = craft.advance(16.0)
        samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
        tilt = np.degrees(np.abs(samples.attitude[:, :2])).max()
        assert samples.duty[-2000:].min(axis=1).mean() > 0.2, "it flies to the end"
        return 3 < tilt < 35 and np.degrees(np.abs(samples.gyro)).max() < 400

    with ThreadPoolExecutor() as pool:  # kernels hold no interpreter lock
        assert sum(pool.map(steady, map(StandIn, crafts))) == len(crafts)


def test_draws_have_the_covariance_of_the_fit():
    several = draws(MODEL, 4000, seed=1)
    table = np.array([[m.body.c0, m.body.c1, m.body.c2] for m in several])
    names = MODEL.fit["body"]["estimates"]["names"]
    rows = [names.index(name) for name in ("c0", "c1", "c2")]
    covariance = np.array(MODEL.fit["body"]["estimates"]["covariance"])[np.ix_(rows, rows)]
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.cov(table.T))), np.sqrt(np.diag(covariance)), rtol=0.05
    )
    np.testing.assert_allclose(table.mean(axis=0), [0.004258, 0.004262, 0.000491], rtol=1e-3)


def uncertain(name, share):
    """The model with one standard error made a share of its value."""
    fit = json.loads(json.dumps(MODEL.fit))
    estimates = fit["body"]["estimates"]
    place = estimates["names"].index(name)
    size = share * abs(estimates["values"][place])
    covariance = np.array(estimates["covariance"])
    covariance[place, :] = covariance[:, place] = 0.0
    covariance[place, place] = size**2
    estimates["covariance"] = covariance.tolist()
    return msgspec.structs.replace(MODEL, fit=fit)


@pytest.mark.parametrize(
    ("name", "axis", "advice"),
    [
        ("c0", "roll", "roll doublets"),
        ("c2", "yaw", "yaw rate doublets"),
        ("dead_time.delay_s", "roll", "--with dead_time"),
    ],
)
def test_a_model_too_uncertain_is_refused_with_what_to_record(name, axis, advice):
    with pytest.raises(BadInputError, match=advice) as refusal:
        require_certain(uncertain(name, 0.9), [axis])
    assert name in str(refusal.value)
    require_certain(uncertain(name, 0.05), [axis])


def test_a_report_says_what_draws_do_that_are_lost_or_never_settle():
    gains = load_gains(DATA / "gains.toml")
    one = designed_yaw()
    tried = robustness(MODEL, gains, ["yaw"], count=20)
    spoiled = tried.judgements["yaw"].copy()
    spoiled[:3] = np.inf
    lost = Robustness(20, {"yaw": 17}, {"yaw": spoiled})
    report = firmware_report(MODEL, "2014", [one], lost, cascade_limits())
    assert report["axes"]["yaw"]["draws"]["settling_s_95"] is None
    assert "more than 5 % of them do not settle" in report["axes"]["yaw"]["notes"][-1]
    for several in (lost, Robustness(20, {"yaw": 0}, {"yaw": np.full_like(spoiled, np.inf)})):
        page = firmware_page(MODEL, "body", [one], several, report)
        assert "<svg" in page.html()
    untried = firmware_report(MODEL, "2014", [one], None, cascade_limits())
    assert not any("covariance" in line for line in untried["notes"])


def test_a_model_without_covariance_cannot_be_drawn_from():
    with pytest.raises(BadInputError, match="no covariance"):
        draws(THESIS, 3)


def test_a_moved_model_stays_physical():
    far = moved(MODEL, {"c0": -1.0, "dead_time.delay_s": -1.0, "a2": 0.001})
    assert far.body.c0 > 0
    assert far.effects[0].parameters["delay_s"].value == 0.0
    assert far.motor.a2 == pytest.approx(MODEL.motor.a2 + 0.001)


def test_gains_survive_their_file(tmp_path):
    path = tmp_path / "gains.toml"
    firmware = {"pid_rate.roll_kp": 5.25, "pid_attitude.roll_kp": 1 / 3}
    thesis = {"roll": PidGains(1.5e6, 0.0, 10200.0), "yaw": PidGains(1 / 7)}
    for gains, release in ((firmware, None), (firmware, "2.x"), (thesis, None)):
        path.write_text(gains_text(gains, release))
        assert load_gains(path) == gains
        assert firmware_of_gains(path) == release


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no gains"),
        ("roll = 3", "roll"),
        ("[roll]\nkp = 1\nkq = 2", "kq"),
        ("[roll]\nkp = nan", "nan"),
        ("[height]\nkp = 1\n[roll]\nkp = 1", "no axis"),
        ("pid_rate.roll_kp = 3", "with quotes"),
        ('"pid_rate.roll_kp" = inf', "inf"),
        ('"pid_rate.roll_kp" = "fast"', "no number"),
        ('"pid_rate.roll_kp" = 5000.0', "0..1000"),
        ("[roll\n", "cannot be read"),
    ],
)
def test_a_bad_gains_file_is_refused_with_what_is_wrong(tmp_path, text, complaint):
    path = tmp_path / "gains.toml"
    path.write_text(text)
    with pytest.raises(BadInputError, match=complaint):
        load_gains(path)


def test_designs_are_the_same_for_a_seed():
    plant = axis_plant(THESIS, "roll", 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first, again = (design_direct(plant, Limits(), 1.0, 4, SMALL)[0] for _ in range(2))
    assert first == again
    assert RELEASE_2014.gain_names("yaw") == ("pid_rate.yaw_kp", "pid_rate.yaw_ki")


@pytest.mark.parametrize(
    ("line", "said", "complaint"),
    [
        ("", None, "taken for firmware 2014, for no line says firmware"),
        ('firmware = "2014"\n', None, "for firmware 2014; the craft flies 2.x"),
        ('firmware = "2014"\n', "2.x", "--firmware says 2.x"),
        ('firmware = "betaflight"\n', None, "firmware is 'betaflight', there are 2014, 2.x"),
    ],
)
def test_gains_of_one_firmware_are_not_for_another(tmp_path, line, said, complaint):
    path = tmp_path / "gains.toml"
    path.write_text(line + '"pid_rate.roll_kp" = 70.0\n')
    with pytest.raises(BadInputError, match=complaint) as refusal:
        require_gains_of(path, "2.x", "the craft", said=said)
    assert "\n" not in str(refusal.value)


def test_a_design_for_todays_firmware_keeps_its_limits_on_todays_loops():
    model = vehicle_model(BUILT_IN["crazyflie21"])
    (one,) = design_cascade(model, ["roll"], cascade_limits(), budget=SMALL)
    assert tuple(one.gains) == PLATFORMS["crazyflie21"].gain_names("roll")
    plant = plant_of_model(model)
    assert cascade_loop(plant, one.gains, "roll").margins.max_sensitivity < 2.0
    ours, stock = (
        step_metrics(step_response(plant, gains, "roll", WINDOW_S), TS).settling_s
        for gains in (one.gains, {})
    )
    assert ours < stock
