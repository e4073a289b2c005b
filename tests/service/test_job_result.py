import json

from groundstation.service.job_result import advice, result


def model(tmp_path, **content):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    return path


def test_a_fit_is_told_by_its_constants_and_their_errors(tmp_path):
    estimates = {"names": ["c0", "c1"], "values": [1.0e-3, 1.2e-3], "stderr": [3e-5, 4e-5]}
    found = model(tmp_path, fit={"body": {"estimates": estimates}})
    assert result("fit", found, ["written"]) == "c0 0.001 ± 3e-05, c1 0.0012 ± 4e-05"


def test_a_search_is_told_by_the_effects_and_their_sizes(tmp_path):
    drag = {"value": 0.0079, "unit": "N s/m", "stderr": 0.0003}
    changed = [{"name": "c0", "from": 1.0e-3, "to": 1.1e-3, "stderr": 1e-5}]
    found = model(
        tmp_path,
        effects=[{"name": "rotor_drag", "parameters": {"drag_n_s_m": drag}}],
        fit={"discrepancy": {"base_changes": changed}},
    )
    assert result("discrepancy", found, []) == (
        "the model has 1 effect now: rotor_drag (drag_n_s_m 0.0079 ± 0.0003 N s/m);"
        " changed: c0 0.001 to 0.0011"
    )
    assert result("discrepancy", model(tmp_path, effects=[]), []) == "no effect found"


def test_an_inspection_is_told_by_its_verdict_and_others_by_what_they_said():
    assert result("inspect", None, ["file  a", "verdict       usable", "span 3 s"]) == "usable"
    assert result("compare", None, ["gap over all channels: 6.06", "gyro_x"]).startswith("gap over")
    assert result("design", None, ["one", "two"]) == "two"
    assert result("fit", None, []) == ""


def test_what_a_fit_advises_is_read_from_what_it_left_out_and_warns_of(tmp_path):
    account = {"left_out": ["supply_sag", "rotor_drag"], "warnings": ["give --measured-rotors"]}
    found = advice(model(tmp_path, fit={"body": account}))
    assert (found.effects, found.measured_rotors) == (["rotor_drag", "supply_sag"], True)
    assert advice(None).effects == []
