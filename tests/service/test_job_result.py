import json

from groundstation.service.jobs import advice


def test_what_a_fit_advises_is_read_from_what_it_left_out_and_warns_of(tmp_path):
    account = {"left_out": ["supply_sag", "rotor_drag"], "warnings": ["give --measured-rotors"]}
    path = tmp_path / "model.json"
    path.write_text(json.dumps({"fit": {"body": account}}))
    found = advice(path)
    assert (found.effects, found.measured_rotors) == (["rotor_drag", "supply_sag"], True)
    assert advice(tmp_path / "none.json").effects == []
