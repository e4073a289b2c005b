"""fit, simulate, attitude and axes as a user types them, on files."""

import json
from pathlib import Path

import numpy as np
import pytest

from groundstation.cli.model_files import model_before
from groundstation.dynamics.model import load_model, save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN, THESIS_MOTOR, load_vehicle
from groundstation.errors import BadInputError
from groundstation.recording.csv_file import write_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.mcap_file import RecordingFile
from groundstation.recording.session import Recording, vehicle_of
from support.commands import run
from support.flights import recorded

RECORDINGS = Path(__file__).parents[2] / "recordings"
RECORDED = {
    "bench": (40.0, {"program": "motor_bench"}),
    "reduced": (50.0, {"plant": "reduced"}),
    "faithful": (50.0, {}),
    "axes": (24.0, {"program": "axis_check"}),
    "hand": (30.0, {"program": "hand_rotation", "sensor": {"gyro_bias_dps": (1.5, -1.2, 0.8)}}),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """name -> a CSV recording of the stand-in."""
    folder = tmp_path_factory.mktemp("recordings")
    found = {}
    for name, (seconds, settings) in RECORDED.items():
        samples, _ = recorded(seconds, seed=41, **settings)
        found[name] = folder / f"{name}.csv"
        write_csv(Recording(found[name], "csv", samples), found[name])
    return found


def test_a_motor_a_body_and_a_simulation_follow_from_recordings(files, tmp_path):
    motor, body = tmp_path / "motor.json", tmp_path / "body.json"
    effects = "battery_reading_lag,supply_sag"
    run("fit", "motor", files["bench"], "-o", motor, "--with", effects)
    model = load_model(motor)
    assert model.motor.a0 == pytest.approx(THESIS_MOTOR.a0, rel=0.02)
    assert model.motor.a2 == pytest.approx(THESIS_MOTOR.a2, rel=0.02)

    text = run(
        *("fit", "body", files["faithful"], "-o", body, "--model", motor, "--json"),
        *("--with", "dead_time,rotor_acceleration_torque"),
    )
    assert json.loads(text) == json.loads(body.read_text())
    model = load_model(body)
    c0, c1, c2 = BUILT_IN["crazyflie1"].body_constants
    assert [model.body.c0, model.body.c1, model.body.c2] == pytest.approx([c0, c1, c2], rel=0.03)
    # What the motor was fitted beside acts on: without it the constants would be off.
    supply = {"battery_reading_lag", "supply_sag"}
    assert {term.name for term in model.effects} == {
        *supply,
        "dead_time",
        "rotor_acceleration_torque",
    }
    assert set(model.fit) == {"motor", "body"}
    account = model.fit["body"]
    assert account["recordings"][0]["file"] == "faithful.csv"
    assert len(account["recordings"][0]["sha256"]) == 64
    assert account["held_out"] == "last third"
    assert account["estimates"]["names"][:3] == ["c0", "c1", "c2"]
    assert account["validation"]["gyro_roll_rms_20ms"] > 0

    table = tmp_path / "simulated.csv"
    report = json.loads(
        run(
            *("simulate", "--model", body, "--recording", files["reduced"], "-o", table),
            *("--window", 0.1, "--json"),
        )
    )
    rows = np.genfromtxt(table, delimiter=",", names=True)
    assert len(rows) == report["rows"]
    assert report["rms"]["roll_deg"] < 0.3
    assert rows["rotor1_rev_s"].max() > 200


def test_held_out_recordings_can_be_named(files, tmp_path):
    model = tmp_path / "body.json"
    run("fit", "body", files["reduced"], "--validate", files["faithful"], "-o", model)
    account = load_model(model).fit["body"]
    assert account["held_out"][0]["file"] == "faithful.csv"
    # The faithful craft has what the model lacks.
    name = "gyro_yaw_rms_20ms"
    assert account["validation"][name] > 2 * account["identification"][name]


def test_a_recording_given_twice_is_refused_whatever_its_name(files, tmp_path):
    copy = tmp_path / "copy.csv"
    copy.write_bytes(files["reduced"].read_bytes())
    for more in ([copy], ["--validate", copy]):
        with pytest.raises(BadInputError, match=r"copy\.csv: the same as .*reduced\.csv"):
            run("fit", "body", files["reduced"], *more, "-o", tmp_path / "body.json")
    assert not (tmp_path / "body.json").exists()


def test_the_vehicle_is_the_one_that_recordings_name_unless_the_user_does(files, tmp_path):
    labelled, other = tmp_path / "labelled.mcap", tmp_path / "other.mcap"
    samples = open_recording(files["reduced"]).samples
    for path, profile, rows in (
        (labelled, "crazyflie21", slice(0, None)),
        (other, "crazyflie1", slice(1, None)),
    ):
        file = RecordingFile(path, {"vehicle": {"profile": profile}})
        file.samples(samples[rows])
        file.finish()
    with pytest.raises(BadInputError, match="not flown by a 'crazyflie21'"):
        run("fit", "body", labelled, "-o", tmp_path / "body.json")
    with pytest.raises(BadInputError, match="recordings of several vehicles"):
        run("fit", "body", labelled, other, "-o", tmp_path / "body.json")
    run("fit", "body", labelled, "--vehicle", "crazyflie1", "-o", tmp_path / "body.json")
    assert load_model(tmp_path / "body.json").vehicle == "crazyflie1"


def test_arx_models_come_with_the_table_they_were_chosen_from(files, tmp_path):
    model = tmp_path / "arx.json"
    text = run("fit", "arx", files["reduced"], "-o", model)
    assert "roll" in text
    assert "cross correlation" in text
    loaded = load_model(model)
    assert set(loaded.arx) == {"roll", "pitch", "yaw"}
    table = loaded.fit["arx"]["axes"]["roll"]["table"]
    errors = [row["rms_validation_rad"] for row in table]
    assert len({row["model"] for row in table}) == len(table) == 88
    assert errors == sorted(errors)


def test_structures_that_are_named_are_chosen_from_and_shown_beside_each_other(files, tmp_path):
    model, page = tmp_path / "arx.json", tmp_path / "arx.html"
    named = ("2,1,8", "2,1,4", "2,2,0", "2,1,4")
    orders = [part for order in named for part in ("--order", order)]
    run("fit", "arx", files["reduced"], "-o", model, "--html", page, *orders)
    loaded, text = load_model(model), page.read_text()
    for axis, one in loaded.fit["arx"]["axes"].items():
        shown = {one["chosen"], *one["beside"]}
        assert shown == {"ARX(2,1,8)", "ARX(2,1,4)", "ARX(2,2,0)"}
        plausible = [row["model"] for row in one["table"] if row["plausible_step"]]
        assert one["chosen"] == next((m for m in plausible if m in shown), one["chosen"])
        for label in shown:
            assert f"{axis} angle, {label}" in text, "its residuals"
            assert f"50 ms ahead by {label}" in text


def test_arx_models_of_rates_are_searched_on_fewer_rows(files, tmp_path):
    model = tmp_path / "arx.json"
    run("fit", "arx", files["reduced"], "-o", model, "--gyro", "--decimate", 4)
    loaded = load_model(model)
    assert loaded.arx["roll"].ts == pytest.approx(0.008)
    assert loaded.fit["arx"]["channel"] == "gyro"
    assert "chosen by prediction" in loaded.fit["arx"]["method"]
    assert set(loaded.fit["arx"]["axes"]["yaw"]["estimates"]) >= {"covariance", "correlation"}


def test_a_fit_keeps_to_the_seconds_it_is_given_and_writes_a_report(files, tmp_path):
    model, page = tmp_path / "body.json", tmp_path / "body.html"
    run(
        *("fit", "body", files["reduced"], "-o", model, "--html", page),
        *("--segment", "10:22", "--segment", "26:44"),
    )
    account = load_model(model).fit["body"]
    assert account["selection"] == "in 10 to 22 s, 26 to 44 s"
    assert account["samples"] == pytest.approx(2 / 3 * 30 * 500, abs=20)
    text = page.read_text()
    assert "in 10 to 22 s" in text
    assert load_model(model).fit["body"]["recordings"][0]["sha256"] in text


def test_attitude_tells_drift_from_fusion(files, tmp_path):
    table = tmp_path / "angles.csv"
    report = json.loads(run("attitude", files["hand"], "-o", table, "--json"))
    moved = report["end_minus_start_deg"]
    assert np.abs(moved["kalman"]).max() < 1.0
    assert np.abs(moved["integrated"][:2]).min() > 20.0
    assert report["rest_bias_dps"] == pytest.approx([1.5, -1.2, 0.8], abs=0.05)
    assert len(np.genfromtxt(table, delimiter=",", names=True)) == report["samples"]


def test_sensor_fusion_is_drawn_and_takes_other_noise(files, tmp_path):
    page = tmp_path / "attitude.html"
    noise = ("--noise", "0.0002,0.00001,5")
    told = json.loads(run("attitude", files["hand"], "--html", page, *noise, "--json"))
    assert told["noise"] == [0.0002, 0.00001, 5.0]
    assert np.abs(told["end_minus_start_deg"]["kalman"]).max() < 1.0
    assert page.read_text().count("<figure") == 3
    slow = json.loads(run("attitude", files["hand"], "--weight", 1, "--json"))
    moved = slow["end_minus_start_deg"]
    assert moved["complementary"] == pytest.approx(moved["integrated"], abs=0.3), "no filter"


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--weight", "1.5", "must be 0..1"),
        ("--noise", "1,2", "three numbers"),
        ("--noise", "1,0,5", "must be positive and finite"),
        ("--noise", "1,nan,5", "must be positive and finite"),
    ],
)
def test_noise_and_weight_that_no_filter_has_are_refused(files, option, value, words):
    with pytest.raises(BadInputError, match=words):
        run("attitude", files["hand"], option, value)


def test_axes_names_an_inverted_pitch(files, tmp_path):
    assert run("axes", files["axes"]).startswith("as expected")
    lines = files["axes"].read_text().splitlines()
    column = lines[0].split(",").index("Pitch")
    turned = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[column] = str(-int(cells[column]))
        turned.append(",".join(cells))
    wrong = tmp_path / "inverted.csv"
    wrong.write_text("\n".join(turned) + "\n")
    page = tmp_path / "axes.html"
    report = json.loads(run("axes", wrong, "--html", page, "--json"))
    assert "attitude pitch is inverted" in page.read_text()
    assert page.read_text().count("<figure") == 1
    assert report["verdict"] == "wrong_axes"
    assert report["faults"] == ["attitude pitch is inverted"]
    assert report["contradictions"] == ["pitch turns against gyro_y: the sign of one is wrong"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("fit", "motor", "{faithful}"), "no rotor periods"),
        (("fit", "body", "{bench}"), "does not show in the rate about roll"),
        (("fit", "body", "{axes}"), "0.0 s of uninterrupted flight"),
        (("fit", "body", "{reduced}", "--with", "ground_effect"), "shows in accelerometer z"),
        (("fit", "motor", "{bench}", "--with", "dead_time"), "the motor fit knows"),
        (("fit", "arx", "{reduced}", "--criterion", "luck"), "there are free_run, prediction"),
        (("fit", "arx", "{reduced}", "--order", "2,1"), "must be na,nb,nk"),
        (("fit", "arx", "{reduced}", "--order", "2,1,11"), "nk 0..10"),
        (("fit", "arx", "{reduced}", "--order", "2,x,1"), "must be na,nb,nk"),
        (("fit", "body", "{reduced}", "--vehicle", "kite"), "neither built in"),
        (("fit", "body", "{reduced}", "--segment", "5"), "two rising numbers"),
        (("fit", "body", "{reduced}", "--segment", "200:300"), "choose more of it"),
    ],
)
def test_what_cannot_be_fitted_is_refused_and_leaves_no_model(files, tmp_path, arguments, text):
    model = tmp_path / "model.json"
    with pytest.raises(BadInputError, match=text):
        run(*(str(one).format(**files) for one in arguments), "-o", model)
    assert not model.exists()


def test_a_model_says_which_vehicle_it_is_where_nothing_else_does(tmp_path):
    path = tmp_path / "motor.json"
    save_model(vehicle_model(load_vehicle("brushless")), path)
    assert vehicle_of([], None) is None
    model = load_model(path)
    assert model_before(model, None).vehicle == "brushless"
    assert model_before(model, "crazyflie21").vehicle == "crazyflie21"
    assert model_before(None, None).vehicle == "crazyflie1"


def test_a_craft_that_was_weighed_is_fitted_with_its_own_mass(files, tmp_path):
    model = tmp_path / "motor.json"
    run("fit", "motor", files["bench"], "-o", model, "--mass", "0.0254")
    profile = load_model(model).vehicle_profile
    assert profile.mass_kg == 0.0254
    assert profile.inertia_kg_m2 == BUILT_IN["crazyflie1"].inertia_kg_m2
    assert vehicle_model(profile).body.thrust_per_mass == profile.thrust_n / 0.0254
    for grams in ("25.4", "nan", "-0.02"):
        with pytest.raises(BadInputError, match=r"crazyflie1 weighs 0\.023 kg"):
            run("fit", "motor", files["bench"], "-o", tmp_path / "x.json", "--mass", grams)


@pytest.mark.parametrize("converted", [False, True])
def test_a_microsd_log_is_never_taken_for_the_craft_of_the_thesis(tmp_path, converted):
    log, model = RECORDINGS / "microsd_log16", tmp_path / "model.json"
    if converted:
        run("convert", log, tmp_path / "log.mcap")
        log = tmp_path / "log.mcap"
    asked = "of a Crazyflie 2.x .no 1.0 carries a microSD deck.*--vehicle crazyflie21, crazyflie21p"
    with pytest.raises(BadInputError, match=asked):
        run("fit", "body", log, "-o", model)
    for command in (("fit", "body", "-o", model), ("compare",), ("discrepancy",)):
        with pytest.raises(BadInputError, match=r"of a Crazyflie 2\.x .*, not of 'crazyflie1'"):
            run(*command, log, "--model", "thesis")
    assert not model.exists()
    recording = open_recording(log)
    assert vehicle_of([recording], "brushless") == "brushless"
    assert vehicle_of([recording], None, vehicle_model(load_vehicle("brushless"))) is None


@pytest.mark.parametrize(
    ("gyro", "force", "because"),
    [
        ("gyro.x,stateEstimate.qw", "1", "only a 2.x logs stateEstimate.qw"),
        ("gyro.x,pm.vbatMV", "1", "only a 2.x logs pm.vbatMV"),
        ("wx,wy", "20", "20 g are beyond a 1.0's sensor"),
        ("wx,wy", "1", "its craft is not known .the file does not say"),
    ],
)
def test_a_mapped_file_tells_its_craft_by_names_and_ranges_or_is_asked_for_it(
    tmp_path, gyro, force, because
):
    first = gyro.split(",")[0]
    rows = "".join(f"{row * 0.002:.3f},{row % 7},0,0,0,{force}\n" for row in range(5000))
    (tmp_path / "log.csv").write_text(f"t,{gyro},ax,ay,az\n{rows}")
    (tmp_path / "map.toml").write_text(
        f"""
        time = {{ column = "t", unit = "s" }}
        gyro.x = {{ column = "{first}", unit = "deg/s" }}
        accelerometer.x = {{ column = "ax", unit = "g" }}
        accelerometer.y = {{ column = "ay", unit = "g" }}
        accelerometer.z = {{ column = "az", unit = "g" }}
        """
    )
    flight = tmp_path / "flight.mcap"
    run("convert", tmp_path / "log.csv", flight, "--columns", tmp_path / "map.toml")
    with pytest.raises(BadInputError, match=because):
        run("fit", "body", flight, "-o", tmp_path / "model.json")
