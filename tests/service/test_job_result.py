import json
import os

from groundstation.service.control import _Json
from groundstation.service.jobs import Job, advice


def test_what_a_fit_advises_is_read_from_what_it_left_out_and_warns_of(tmp_path):
    account = {"left_out": ["supply_sag", "rotor_drag"], "warnings": ["give --measured-rotors"]}
    path = tmp_path / "model.json"
    path.write_text(json.dumps({"fit": {"body": account}}))
    found = advice(path)
    assert (found.effects, found.measured_rotors) == (["rotor_drag", "supply_sag"], True)
    assert advice(tmp_path / "none.json").effects == []


def test_a_job_on_a_file_whose_name_is_not_utf_8_is_told_as_any_other():
    name = os.fsdecode(b"caf\xe9.mcap")
    (told,) = json.loads(_Json([Job(id="one", kind="fit", recordings=[name])]).body)
    assert (told["id"], told["recordings"]) == ("one", [name])
