import json

from groundstation.service.job_result import advice, result

FIT = """\
model.json: body by prediction error, 1990 samples
  Roll and pitch: enough for a first, cautious design.
  c0                  0.0010915 +- 0.00036
  thrust_per_mass   1.78351e-05 +- 3.9e-08
  held out: gyro_roll_rms_1row               0.02403 rad/s"""
SEARCH = """\
1 effect found
found in words
changed: c0 from 0.001 to 0.0011
1. rotor_drag: in-plane force proportional to body velocity
     drag_n_s_m 0.0079 +- 0.0003 N s/m"""


def test_a_job_says_the_lines_of_its_log_that_say_what_was_found():
    said = {
        "fit": (FIT, "c0 0.0010915 +- 0.00036, thrust_per_mass 1.78351e-05 +- 3.9e-08"),
        "discrepancy": (
            SEARCH,
            "changed: c0 from 0.001 to 0.0011, 1. rotor_drag: in-plane force proportional to body"
            " velocity",
        ),
        "inspect": ("file  a\nverdict       usable\nspan 3 s", "usable"),
        "compare": ("a note\ngap over all channels: 6.06 (1.00: noise alone)\n  gyro_x",
                    "gap over all channels: 6.06 (1.00: noise alone)"),
        "design": ("one\ntwo", "two"),
    }  # fmt: skip
    for kind, (log, told) in said.items():
        assert result(kind, log.splitlines()) == told, kind


def test_a_job_whose_log_says_nothing_of_the_kind_says_its_last_line():
    assert result("fit", ["groundstation: no such file"]) == "groundstation: no such file"
    assert result("fit", []) == ""


def test_what_a_fit_advises_is_read_from_what_it_left_out_and_warns_of(tmp_path):
    account = {"left_out": ["supply_sag", "rotor_drag"], "warnings": ["give --measured-rotors"]}
    path = tmp_path / "model.json"
    path.write_text(json.dumps({"fit": {"body": account}}))
    found = advice(path)
    assert (found.effects, found.measured_rotors) == (["rotor_drag", "supply_sag"], True)
    assert advice(tmp_path / "none.json").effects == []
