"""``pid evaluate`` and ``pid design`` as typed, and what ``pid fly`` refuses at once."""

import json
from pathlib import Path

import pytest

from groundstation.cli.pid_fly import _judge
from groundstation.control.programme import Programme
from groundstation.dynamics.model import save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.errors import BadInputError
from support import RECORDINGS
from support.commands import done

DATA = Path(__file__).parents[1] / "control" / "data"
BODY, GAINS = str(DATA / "body.json"), str(DATA / "gains.toml")


def pid(*arguments):
    """Output of a command that works; what it raises otherwise."""
    return done("pid", *arguments).stdout


def test_stock_and_designed_gains_are_evaluated_on_a_fitted_model(tmp_path):
    stock = json.loads(pid("evaluate", "--model", BODY, "--json"))
    page = tmp_path / "pid.html"
    ours = json.loads(pid("evaluate", "--model", BODY, "--gains", GAINS, "--json", "--html", page))
    assert stock["loop"] == ours["loop"] == "firmware"
    for axis in ("roll", "pitch", "yaw"):
        one, other = ours["axes"][axis], stock["axes"][axis]
        for key in (
            "rms",
            "overshoot_pct",
            "settling_s",
            "steady_state_error",
            "max_sensitivity",
            "delay_margin_s",
        ):
            assert isinstance(one[key], float), key
        assert one["settling_s"] < 0.6 * other["settling_s"]
    assert page.read_text().count("<svg") == 4  # steps, Bode, Nyquist, sensitivity
    assert "roll" in pid("evaluate", "--model", BODY)


def test_todays_craft_is_evaluated_on_todays_loops_and_takes_no_gains_of_2014(tmp_path):
    model = tmp_path / "today.json"
    save_model(vehicle_model(BUILT_IN["crazyflie21"]), model)
    stock = json.loads(pid("evaluate", "--model", model, "--json"))
    assert stock["firmware"] == "2.x"
    assert stock["axes"]["roll"]["gains"]["pid_rate.roll_kp"] == 250.0
    older = json.loads(pid("evaluate", "--model", model, "--firmware", "2014", "--json"))
    assert older["axes"]["roll"]["gains"]["pid_rate.roll_kp"] == 70.0
    with pytest.raises(BadInputError, match="taken for firmware 2014"):
        pid("evaluate", "--model", model, "--gains", GAINS)
    gains = tmp_path / "gains.toml"
    gains.write_text('firmware = "2.x"\n"pid_rate.roll_kp" = 200.0\n')
    ours = json.loads(pid("evaluate", "--model", model, "--gains", gains, "--json"))
    assert ours["axes"]["roll"]["gains"]["pid_rate.roll_kp"] == 200.0
    with pytest.raises(BadInputError, match=r"for firmware 2\.x; the craft of .* flies 2014"):
        pid("evaluate", "--model", BODY, "--gains", gains)


def test_every_effect_of_a_model_flies_in_the_loop(tmp_path):
    model = json.loads(Path(BODY).read_text())
    drag = {"name": "rotor_drag", "parameters": {"drag_n_s_m": {"value": 0.008}}}
    model["effects"].append(drag)
    path = tmp_path / "drag.json"
    path.write_text(json.dumps(model))
    assert done("pid", "evaluate", "--model", path).stderr == ""


def test_a_pid_of_the_thesis_form_runs_on_both_of_its_loops(tmp_path):
    gains = tmp_path / "thesis.toml"
    gains.write_text("[roll]\nkp = 1.5e6\nkd = 1.0e4\n[yaw]\nkp = 1e5\nkd = 3e4\n")
    direct = json.loads(pid("evaluate", "--gains", gains, "--delay", 2, "--json"))
    assert direct["loop"] == "direct"
    assert direct["axes"]["roll"]["stable"]
    counts = tmp_path / "counts.toml"
    counts.write_text("[roll]\nkp = 1937.0\nkd = 250.0\n")
    whole = json.loads(
        pid("evaluate", "--gains", counts, "--loop", "whole", "--delay", 2, "--json")
    )
    assert list(whole["axes"]) == ["roll"]
    assert whole["axes"]["roll"]["stable"]


def test_a_design_is_written_explained_and_never_overwritten(tmp_path):
    gains, page = tmp_path / "gains.toml", tmp_path / "design.html"
    report = json.loads(
        pid(
            "design", "--model", "thesis", "--loop", "direct", "--axis", "roll", "--delay", 2,
            "-o", gains, "--html", page, "--json",
        )
    )  # fmt: skip
    roll = report["axes"]["roll"]
    assert roll["max_sensitivity"] <= 2.005
    assert roll["delay_samples"] == 2
    assert [line.split(" = ")[0] for line in roll["reasons"]] == ["kp", "ki", "kd"]
    assert all("25 % more" in line for line in roll["reasons"])
    assert len(roll["front"]) > 50
    assert all(point["gains"].keys() == roll["gains"].keys() for point in roll["front"])
    fastest = min(roll["front"], key=lambda point: point["settling_s"])  # it was not chosen
    path = tmp_path / "other.toml"
    path.write_text("[roll]\n" + "".join(f"{k} = {v!r}\n" for k, v in fastest["gains"].items()))
    judged = json.loads(pid("evaluate", "--gains", path, "--delay", 2, "--seconds", 2, "--json"))
    assert judged["axes"]["roll"]["settling_s"] == pytest.approx(fastest["settling_s"])
    assert "<svg" in page.read_text()
    again = json.loads(pid("evaluate", "--gains", gains, "--delay", 2, "--seconds", 2, "--json"))
    assert again["axes"]["roll"]["settling_s"] == pytest.approx(roll["settling_s"])
    with pytest.raises(BadInputError, match="exists already"):
        pid("design", "--model", "thesis", "--loop", "direct", "-o", gains)


def test_gains_of_the_whole_loop_become_what_a_craft_flies(tmp_path):
    whole, gains, back = (tmp_path / name for name in ("whole.toml", "gains.toml", "back.toml"))
    whole.write_text('loop = "whole"\n[roll]\nkp = 38.5\nki = 0.04\nkd = 21.3\n')
    flown = json.loads(pid("evaluate", "--model", BODY, "--gains", whole, "--json"))
    assert flown["loop"] == "whole"
    with pytest.raises(BadInputError, match="holds gains of the whole loop"):
        pid("evaluate", "--model", BODY, "--gains", whole, "--loop", "direct")
    made = pid("convert", whole, "--model", BODY, "--to", "firmware", "-o", gains)
    assert "pid_attitude.roll_kp = " in made
    cascade = json.loads(pid("evaluate", "--model", BODY, "--gains", gains, "--json"))
    assert cascade["axes"]["roll"]["max_sensitivity"] == pytest.approx(
        flown["axes"]["roll"]["max_sensitivity"], rel=0.1
    )
    told = json.loads(pid("convert", gains, "--model", BODY, "--to", "whole", "-o", back, "--json"))
    assert told["gains"]["roll"] == pytest.approx({"kp": 38.5, "ki": 0.04, "kd": 21.3})
    with pytest.raises(BadInputError, match="exists already"):
        pid("convert", gains, "--model", BODY, "--to", "whole", "-o", back)


def test_a_design_on_u_that_no_motor_follows_is_refused_on_a_fitted_model(tmp_path):
    with pytest.raises(BadInputError, match=r"lag of 102 ms.* Design with the motors: --loop"):
        pid("design", "--model", BODY, "--loop", "direct", "--axis", "yaw", "-o", tmp_path / "no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("design", "--model", BODY, "--loop", "outer"), "--loop outer: there are firmware, dir"),
        (("convert", GAINS, "--model", BODY, "--to", "outer", "-o", "new.toml"), "--to outer"),
        (
            ("convert", GAINS, "--model", BODY, "--to", "whole", "-o", "new", "--from", "direct"),
            "holds gains of the firmware loop",
        ),
        (("evaluate", "--loop", "outer"), "--loop outer: there are direct"),
        (("evaluate", "--model", "thesis", "--loop", "direct"), "needs gains by axis"),
        (("evaluate", "--model", BODY, "--gains", GAINS, "--loop", "whole"), "needs gains by axis"),
        (("evaluate", "--model", BODY, "--delay", "3"), "model's dead time"),
        (("evaluate", "--model", BODY, "--firmware", "3.x"), "--firmware 3.x: there are 2014, 2.x"),
        (("evaluate", "--model", BODY, "--firmware", "2.x"), "crazyflie1 is a plus"),
        (("fly", "--firmware", "betaflight"), "there are 2014, 2.x"),
        (("evaluate", "--seconds", "0"), "must be 0.1..60"),
        (("evaluate", "--model", "absent.json"), "no such file"),
        (("evaluate", "--gains", "absent.toml"), "cannot be read"),
        (("design", "--model", BODY, "--axis", "height"), "--axis height"),
        (("design", "--model", BODY, "--sensitivity", "1"), "must be 1.1..10"),
        (("design", "--model", BODY, "--spare-ms", "-1"), "0..100"),
        (("fly", "--amplitude", "80"), "must be 1..25 deg"),
        (("fly", "--yaw-rate", "nan"), "must be 5..200"),
        (("fly", "--programme", "looping"), "doublet, step, level"),
        (("fly", "--hold", "9"), "0.2..3"),
        (("fly", "--repeat", "0"), "1..50"),
        (("fly", "--gains", "absent.toml"), "cannot be read"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(arguments, complaint):
    with pytest.raises(BadInputError, match=complaint.replace("(", r"\(")) as refusal:
        pid(*arguments)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("value", ["nan", "inf", "-1.0", "1e9"])
def test_a_gain_that_cannot_be_is_refused_before_anything_is_reached(tmp_path, value, monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_SOCKET", str(tmp_path / "nobody.sock"))
    gains = tmp_path / "gains.toml"
    gains.write_text(f'"pid_rate.roll_kp" = {value}\n')
    with pytest.raises(BadInputError, match=r"pid_rate\.roll_kp"):
        pid("fly", "--gains", gains)


def test_a_model_that_cannot_predict_is_refused_before_the_flight(tmp_path, monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_SOCKET", str(tmp_path / "nobody.sock"))
    model = json.loads(Path(BODY).read_text())
    roll = {"na": 2, "nb": 1, "nk": 2, "a": [-1.9, 0.9], "b": [1e-6], "ts": 0.002}
    path = tmp_path / "arx.json"
    path.write_text(json.dumps({**model, "body": None, "arx": {"roll": roll}}))
    with pytest.raises(BadInputError, match="no body constants"):
        pid("fly", "--model", path)


def test_a_dry_run_shows_the_programme_and_reaches_for_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("GROUNDSTATION_SOCKET", str(tmp_path / "nobody.sock"))
    plan = json.loads(pid("fly", "--gains", GAINS, "--dry-run", "--json"))
    assert plan["programme"]["seconds"] == pytest.approx(4 + 3 * 8 * (2 * 0.7 + 1))
    assert plan["programme"]["reach_m"] == pytest.approx(0.85, abs=0.01)
    assert plan["gains"]["pid_rate.yaw_kp"] > 0
    assert "10 deg" in pid("fly", "--dry-run")


def test_a_flight_that_cannot_be_measured_says_where_it_is_recorded():
    recording = str(sorted(RECORDINGS.glob("*.mcap"))[0])
    with pytest.raises(BadInputError, match=r"not measured: .* no whole programme") as refusal:
        _judge(
            {"recording": recording, "gains": {}, "firmware": "2014"},
            Programme(),
            None,
            None,
            False,
        )
    assert f"recorded to {recording}" in str(refusal.value)
