"""The sealed bench itself: what it hides, what it lets be seen, its bound, its judgement."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from bench.sealed.bound import significances
from bench.sealed.cases import GROUPS, PLAIN, Case, matrix, named
from bench.sealed.flights import (
    CARRY,
    CARRY_TODAY,
    PROGRAMME,
    Sealed,
    constants_alone,
    flown,
    record,
)
from bench.sealed.hidden import CHANNELS, LISTED, OUTSIDE, REGIMES, planted, scaled
from bench.sealed.judge import judge, points_at
from bench.sealed.run import judged_again, run
from bench.sealed.signals import Signals, effect_signals
from bench.sealed.tables import tables
from firmware_sim.effects.catalogue import EFFECTS, draw
from firmware_sim.layout import TRUTH
from firmware_sim.physics import present_effects
from firmware_sim.settings import StandInSettings
from groundstation.comparison.gap import motion_of, regimes_of
from groundstation.dynamics.model import THESIS, EffectTerm, Estimate, load_model, save_model
from groundstation.identification.runs import Run
from support.plant import plant, slopes

RANGES = {
    "dead_time": (1e-3, 12e-3),
    "gyro_low_pass": (12.0, 60.0),
    "rotor_gyroscopic_torque": (2e-8, 1.5e-7),
    "rotor_acceleration_torque": (2e-8, 1.5e-7),
    "inertia_coupling": (1.0, 1.0),
    "rate_damping": (3e-6, 3e-5),
    "quadratic_rate_damping": (5e-6, 4e-5),
    "yaw_damping": (1e-6, 1e-5),
    "centre_of_gravity_offset": (0.2e-3, 2e-3),
    "rotor_mismatch": (0.01, 0.1),
    "motor_dead_voltage": (100.0, 350.0),
    "motor_braking_asymmetry": (0.4, 0.9),
    "supply_sag": (0.05, 0.35),
    "battery_reading_lag": (0.15, 0.6),
    "gyro_bias": (0.2, 3.0),
    "accelerometer_bias": (0.01, 0.08),
    "imu_misalignment": (0.5, 7.0),
    "rotor_drag": (0.003, 0.02),
    "velocity_moment": (2.0, 30.0),
    "climb_inflow": (0.01, 0.05),
    "imu_lever_arm": (1e-3, 6e-3),
    "ground_effect": (0.03, 0.15),
    "attitude_filter_lean": (1.0, 1.0),
    "slung_load": (2.0, 12.0),
    "motor_coasting": (0.3, 1.0),
}
"""The acceptance list, typed by hand."""


UNEQUAL = ("created", "crc32")
"""What two recordings' metadata may differ in: their date."""


def size(name, values):
    if name in ("ground_effect", "slung_load"):
        return values["height_m" if name == "ground_effect" else "percent"]
    return math.hypot(*(value for key, value in values.items() if key != "rotor"))


@pytest.mark.parametrize("name", LISTED)
def test_sizes_are_drawn_from_the_acceptance_list(name):
    low, high = RANGES[name]
    generator = np.random.default_rng(7)
    sizes = [size(name, draw(name, generator)) for _ in range(300)]
    assert low * (1 - 1e-9) <= min(sizes)
    assert max(sizes) <= high * (1 + 1e-9)
    if high > low:
        assert min(sizes) < low * 1.2
        assert max(sizes) > high / 1.2


@pytest.mark.parametrize("name", [*LISTED, *OUTSIDE])
def test_what_is_drawn_is_what_flies(name):
    values = draw(name, np.random.default_rng(3))
    settings = StandInSettings(plant="reduced", effects=planted(name, values, alone=True))
    present = present_effects(settings)
    if name == "bent_propeller":
        assert list(present) == ["propeller_imbalance"]
    elif name in OUTSIDE:
        assert present == {}
    else:
        assert list(present) == [name]
        assert present[name] == pytest.approx(values, rel=1e-6)
    assert CHANNELS[name]


def test_half_of_the_rotor_inertias_act_as_a_craft_has_them():
    values = {"rotor_inertia_kg_m2": 5e-8}
    both = planted("rotor_acceleration_torque", values, alone=False)
    assert set(present_effects(StandInSettings(plant="reduced", effects=both))) == {
        "rotor_acceleration_torque",
        "rotor_gyroscopic_torque",
    }


def test_the_matrix_has_every_name_in_both_modes_and_conditions_on_a_third_of_the_seeds():
    cases = list(matrix(GROUPS[:2], ("clean", "affected"), 12))
    assert len(cases) == 2 * 2 * len(LISTED) * 12
    assert len({case.name for case in cases}) == len(cases)
    met = [case for case in cases if case.condition]
    assert len(met) == len(cases) / 3
    assert {case.condition for case in met} == {"loss", "restart", "low_battery", "other_mass"}
    assert all(named(case.name) == case for case in cases)
    counts = {group: len(list(matrix((group,), ("clean",), 10))) for group in GROUPS}
    assert counts["pair"] == 30
    assert counts["triple"] == 15
    assert counts["quiet"] == counts["quiet_noise"] == 100
    assert counts["faithful"] == 20


def test_a_case_of_another_craft_says_which():
    (case, *others) = matrix(("single",), ("clean",), 1, craft="crazyflie21")
    assert case.name.startswith(f"single@crazyflie21:{case.names[0]}:0:clean")
    assert all(named(one.name) == one for one in (case, *others))
    assert named("single:rotor_drag:0:clean").craft == PLAIN


def test_today_s_craft_is_heard_as_its_radio_logs_it():
    """250 rows a second, each with the mean of the two settings that acted before it."""
    common = {"plant": "reduced", "craft": "crazyflie21", "program": PROGRAMME, "seed": 4}
    samples, truth = flown({**common, "gains": CARRY_TODAY, "loss": {"good_loss": 0.0}}, 8.0)
    assert (np.diff(samples.ticks) == 4000).all()
    acted = {round(1e3 * row["time_s"]): row["duty"] for row in truth}
    rows = [(round(1e3 * t), duty) for t, duty in zip(samples.time_s, samples.duty, strict=True)]
    both = [(duty, 0.5 * (acted[t] + acted[t - 2])) for t, duty in rows[1:] if t in acted]
    found, expected = map(np.array, zip(*both, strict=True))
    assert len(found) > 1800
    assert found.max() > 0.5
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        "nonsense",
        "single:flutter:0:clean",
        "single:dead_time:0:odd",
        "single@kite:dead_time:0:clean",
    ],
)
def test_a_case_that_does_not_exist_is_refused(name):
    with pytest.raises(ValueError, match=r"case|no effect|no craft"):
        named(name)


def test_a_recording_of_a_hidden_effect_has_nothing_that_another_has_not(tmp_path):
    common = {"plant": "reduced", "program": PROGRAMME, "gains": CARRY, "copies": 1, "seed": 4}
    parts = {}
    for label, effects in (("clean", {}), ("hidden", {"rotor_drag": {"drag_n_s_m": 0.01}})):
        record(tmp_path / f"{label}.mcap", flown({**common, "effects": effects}, 8.0)[0])
        with (tmp_path / f"{label}.mcap").open("rb") as file:
            reader = make_reader(file)
            records = {
                item.name: {k: v for k, v in item.metadata.items() if k not in UNEQUAL}
                for item in reader.iter_metadata()
            }
            topics = {channel.topic for _, channel, _ in reader.iter_messages()}
            text = b"".join(message.data for _, _, message in reader.iter_messages())
            attachments = list(reader.iter_attachments())
        assert attachments == []
        parts[label] = records, topics
        assert not any(name.encode() in text for name in EFFECTS)
    assert parts["clean"] == parts["hidden"]


BODY = {
    "rotor_gyroscopic_torque": {"rotor_inertia_kg_m2": 5e-8},
    "inertia_coupling": {"fraction": 1.0},
    "rate_damping": {"damping_n_m_s": 1e-5},
    "quadratic_rate_damping": {"damping_n_m_s2": 1.5e-5},
    "yaw_damping": {"damping_n_m_s": 4e-6},
    "centre_of_gravity_offset": {"x_m": 5e-4, "y_m": -3e-4},
    "rotor_mismatch": {"rotor": 2.0, "excess": 0.05},
    "rotor_drag": {"drag_n_s_m": 0.008},
    "velocity_moment": {"moment": 10.0},
    "climb_inflow": {"loss_g_per_m_s": 0.03},
    "ground_effect": {"height_m": 0.08, "gain": 0.25},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 5e-8},
}


@pytest.mark.parametrize("name", sorted(BODY))
def test_the_bound_knows_what_each_effect_does_to_the_plant(name):
    """At one state the plant's slopes with and without the effect differ by the bound's signal."""
    changed, state = plant(effects={name: BODY[name]})
    unchanged, _ = plant()
    generator = np.random.default_rng(11)
    y = state["y"][0]
    y[2] = 0.1
    y[3:6] = 0.4, -0.3, 0.2
    y[6:10] = generator.normal(size=4)
    y[6:10] /= np.linalg.norm(y[6:10])
    y[10:13] = 0.7, -0.9, 1.1
    y[13:17] = 230.0, 250.0, 240.0, 225.0
    state["duty"], state["supply_mv"] = (0.55, 0.62, 0.6, 0.53), 3700.0
    differences = []
    for p in (changed, unchanged):
        found = slopes(p, state)
        differences.append([*found[10:13], *state["force"][0]])
    truth = np.zeros(1, TRUTH)
    truth["position_m"], truth["velocity_m_s"] = y[:3], y[3:6]
    truth["quaternion"], truth["rate_rad_s"] = y[6:10], y[10:13]
    truth["rotor_rev_s"], truth["duty"] = y[13:17], state["duty"][0]
    truth["supply_mv"] = 3700.0
    total = np.zeros(6)
    for signal in effect_signals(Signals(changed[0], truth), name, BODY[name]).values():
        total[:3] += signal.get("rate", np.zeros((1, 3)))[0]
        total[3:] += signal.get("force", np.zeros((1, 3)))[0]
    assert np.abs(total).max() > 0
    np.testing.assert_allclose(
        total, np.subtract(*differences), rtol=1e-9, atol=1e-9 * np.abs(total).max()
    )


@pytest.fixture(scope="module")
def damped_flights():
    settings = {
        "plant": "reduced",
        "program": PROGRAMME,
        "gains": CARRY,
        "copies": 1,
        "loss": {"good_loss": 0.0},
        "effects": {"rate_damping": {"damping_n_m_s": 1e-5}},
    }
    return settings, [flown({**settings, "seed": seed}, 60.0)[1] for seed in range(2)]


def test_the_bound_is_what_least_squares_on_the_truth_scatters_by(damped_flights):
    """Pure process noise on true rates, base constants known: the textbook formula by hand."""
    settings, flights = damped_flights
    craft = StandInSettings(
        plant="reduced", effects=settings["effects"], torque_noise=50.0, sensor_noise=1e-3
    )
    found = significances(craft, flights)["rate_damping"]
    squares = 0.0
    for truth in flights:
        up = truth["position_m"][:, 2] > 0.012
        squares += np.sum(truth["rate_rad_s"][up][:, :2] ** 2)
    sigma_torque = 2.0 * 50.0
    by_hand = 1e-5 / 1.0e-5 * math.sqrt(squares) / sigma_torque
    assert found == pytest.approx(by_hand, rel=0.25)
    assert found < by_hand  # the base model's constants take their share


def test_six_times_the_torque_noise_leaves_nearly_a_sixth_of_the_significance(damped_flights):
    settings, flights = damped_flights
    one, six = (
        significances(
            StandInSettings(plant="reduced", effects=settings["effects"], torque_noise=noise),
            flights,
        )["rate_damping"]
        for noise in (1.0, 6.0)
    )
    assert 4.5 < one / six < 6.1


def test_a_scaled_effect_is_scaled_in_significance(damped_flights):
    settings, flights = damped_flights
    small = {"rate_damping": scaled("rate_damping", settings["effects"]["rate_damping"], 0.1)}
    full, tenth = (
        significances(StandInSettings(plant="reduced", effects=effects), flights)["rate_damping"]
        for effects in (settings["effects"], small)
    )
    assert tenth == pytest.approx(0.1 * full, rel=1e-6)


def report(
    *effects, verdict="effects_found", where="gyro x", regime="high roll or pitch rate", **channels
):
    return {
        "verdict": verdict,
        "residual": "white",
        "effects": [
            {
                "name": name,
                "parameters": {
                    key: {"value": value, "stderr": error, "unit": ""}
                    for key, (value, error) in parameters.items()
                },
                "alternatives": [{"name": other, "margin": 1.0} for other in others],
                "recurrence": 1.0,
            }
            for name, parameters, others in effects
        ],
        "possible": [],
        "candidates": [],
        "where": [{"channel": where, "regime": regime, "rms": 2.0, "expected_rms": 1.0}],
        "gap": {
            "channels": {
                key.replace("_", " "): {"before": b, "after": a, "noise_floor": f}
                for key, (b, a, f) in channels.items()
            }
        },
    }


def sealed(significance, **present):
    return Sealed("", present, present, significance, "", {})


DAMPED = Case("single", ("rate_damping",), 0)
DAMPING = {"rate_damping": {"damping_n_m_s": 1e-5}}
CERTAIN = {"rate_damping": 50.0}


def test_the_right_name_alone_is_right():
    said = report(("rate_damping", {"damping_n_m_s": (1.1e-5, 1e-6)}, []), gyro_x=(3.0, 1.1, 1.0))
    line = judge(DAMPED, sealed(CERTAIN, **DAMPING), said)
    assert line["right"]
    assert line["counted"]
    assert line["where_right"]
    assert line["explained"] == pytest.approx((9 - 1.21) / 8)
    assert [p["inside"] for p in line["parameters"]] == [True]


def test_the_lag_of_the_chips_own_filter_may_be_fitted_and_is_then_no_part_of_the_delay():
    lag_s = 0.85e-3
    present = {"dead_time": {"delay_s": 3.2e-3}}
    also = {"gyro_low_pass": {"bandwidth_hz": 1.0 / (2.0 * np.pi * lag_s)}}
    chip = replace(sealed({"dead_time": 50.0}, **present), also=also)
    case = Case("faithful", (), 0)
    whole = judge(case, chip, report(("dead_time", {"delay_s": (3.2e-3, 1e-5)}, [])))
    split = report(
        ("dead_time", {"delay_s": (2.35e-3, 1e-5)}, []),
        ("gyro_low_pass", {"bandwidth_hz": (187.2, 0.2)}, []),
    )
    unnamed = report(("dead_time", {"delay_s": (2.35e-3, 1e-5)}, []))
    unnamed["candidates"] = [{"name": "gyro_low_pass", "refused_by": "negligible"}]
    for line in (whole, judge(case, chip, split), judge(case, chip, unnamed)):
        assert line["right"]
        assert all(p["inside"] for p in line["parameters"])
    assert not judge(case, sealed({"dead_time": 50.0}, **present), split)["right"]


@pytest.mark.parametrize(
    "said",
    [
        report(("dead_time", {}, [])),
        report(("rate_damping", {}, []), ("dead_time", {}, [])),
        report(verdict="no_discrepancy"),
    ],
)
def test_another_name_an_extra_name_or_none_is_wrong(said):
    assert not judge(DAMPED, sealed(CERTAIN, **DAMPING), said)["right"]


def test_a_size_below_five_standard_errors_is_left_out_but_a_false_name_still_shows():
    line = judge(DAMPED, sealed({"rate_damping": 4.9}, **DAMPING), report(("dead_time", {}, [])))
    assert not line["counted"]
    assert line["false"] == ["dead_time"]


def test_of_two_rotor_torques_the_visible_ones_are_asked_for():
    case = Case("single", ("rotor_gyroscopic_torque",), 0)
    inertia = {"rotor_inertia_kg_m2": 4e-8}
    truth = sealed(
        {"rotor_gyroscopic_torque": 3.0, "rotor_acceleration_torque": 300.0},
        rotor_gyroscopic_torque=inertia,
        rotor_acceleration_torque=inertia,
    )
    assert judge(case, truth, report(("rotor_acceleration_torque", {}, [])))["right"]
    line = judge(case, truth, report(("rotor_gyroscopic_torque", {}, [])))
    assert line["missed"] == ["rotor_acceleration_torque"]
    assert line["counted"]


def test_outside_the_list_any_name_is_wrong():
    case = Case("outside", ("side_gust",), 0)
    line = judge(case, sealed({}), report(verdict="unexplained", gyro_x=(3.0, 3.0, 1.5)))
    assert line["right"]
    assert line["loudness"] == pytest.approx(2.0)
    assert not judge(case, sealed({}), report(("rotor_drag", {}, [])))["right"]
    assert points_at(case.names, "accelerometer_y")
    assert not points_at(case.names, "gyro z")


@pytest.mark.parametrize(
    ("channel", "regime", "right"),
    [
        ("gyro y", "roll or pitch torque", True),
        ("gyro z", "roll or pitch torque", False),
        ("gyro y", "near ground", False),
    ],
)
def test_where_must_point_at_the_channel_and_the_regime(channel, regime, right):
    said = report(("rate_damping", {}, []), where=channel, regime=regime)
    assert judge(DAMPED, sealed(CERTAIN, **DAMPING), said)["where_right"] is right


def test_a_rotors_inertia_that_acts_by_both_torques_may_show_first_in_either():
    case = Case("single", ("rotor_gyroscopic_torque",), 0)
    inertia = {"rotor_inertia_kg_m2": 4e-8}
    significant = {"rotor_gyroscopic_torque": 30.0, "rotor_acceleration_torque": 300.0}
    said = report(("rotor_gyroscopic_torque", {}, []), where="gyro z", regime="rotor acceleration")
    both = sealed(significant, rotor_gyroscopic_torque=inertia, rotor_acceleration_torque=inertia)
    assert judge(case, both, said)["where_right"]
    alone = sealed(significant, rotor_gyroscopic_torque=inertia)
    assert not judge(case, alone, said)["where_right"]


def test_every_regime_that_is_expected_is_one_that_reports_have():
    flight = Run(
        name="",
        start_s=0.0,
        period_s=0.002,
        duty=np.full((3000, 4), 0.6),
        supply_v=np.full(3000, 3.7),
        gyro=np.zeros((3000, 3)),
        accelerometer=np.tile([0.0, 0.0, 9.8], (3000, 1)),
        attitude=np.zeros((3000, 3)),
        rotor_rev_s=np.full((3000, 4), np.nan),
        debug_s=np.zeros(3000),
        duty_step=np.full((3000, 4), np.nan),
    )
    assert set().union(*REGIMES.values()) <= set(regimes_of(flight, motion_of(flight, THESIS)))
    assert set(REGIMES) == set(LISTED)


def test_a_line_of_results_is_json():
    line = judge(DAMPED, sealed(CERTAIN, **DAMPING), report(("rate_damping", {}, [])))
    assert json.loads(json.dumps(line)) == line


def kept(folder, said, **more):
    """A results folder with one judged case, as ``run`` leaves it."""
    truth = sealed(CERTAIN, **DAMPING)
    line = {**judge(DAMPED, truth, said), **more}
    (folder / "opened").mkdir(parents=True)
    (folder / "results.jsonl").write_text(json.dumps(line) + "\n")
    opened = folder / "opened" / f"{DAMPED.name.replace(':', '-')}.json"
    opened.write_text(json.dumps([asdict(truth), said]))
    return line


def test_a_mended_judge_judges_what_was_said_without_another_search(tmp_path):
    line = kept(tmp_path, report(("rate_damping", {}, [])))
    (tmp_path / "results.jsonl").write_text(json.dumps({**line, "right": False}) + "\n")
    (again,) = judged_again(tmp_path)
    assert again == line


def test_a_case_that_was_refused_stays_as_it_is(tmp_path):
    line = kept(tmp_path, report(), right=False, error="refused: no gyro")
    assert judged_again(tmp_path) == [line]


def test_the_tables_count_what_was_named():
    right = report(("rate_damping", {"damping_n_m_s": (1e-5, 1e-6)}, []), gyro_x=(3.0, 1.0, 1.0))
    wrong = report(("dead_time", {}, []))
    truth = sealed(CERTAIN, **DAMPING)
    lines = [
        judge(DAMPED, truth, right),
        judge(Case("single", ("rate_damping",), 1), truth, wrong),
    ]
    text = tables(lines)
    assert "| single | clean | 1 | 2 | 0 | 1 | 0 |" in text
    assert "| `rate_damping` | `dead_time` 1 |" in text
    assert "| explained part at least 0.9 | 1 | 1 |" in text


def test_what_a_bench_fitted_along_is_not_told_to_the_search(tmp_path):
    lag = EffectTerm("battery_reading_lag", {"time_constant_s": Estimate(0.15, 0.01, "s")})
    path = tmp_path / "motor.json"
    save_model(msgspec.structs.replace(THESIS, effects=(lag,)), path)
    constants_alone(path)
    assert load_model(path) == THESIS


def test_a_run_goes_on_where_it_was(tmp_path):
    done = {"case": "quiet:nothing:0:clean", "right": True}
    lines = [json.dumps(one) for one in ({**done, "error": "died (-9)"}, done)]
    (tmp_path / "results.jsonl").write_text("\n".join(lines) + "\n")
    assert list(run([named(done["case"])], tmp_path, workers=1)) == []
    assert (tmp_path / "results.jsonl").read_text().splitlines() == lines
