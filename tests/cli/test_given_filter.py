"""Angles of a craft that knows its place are its filter's: that is given, not looked for."""

import pytest

from groundstation.cli.learn import FastPlace
from groundstation.cli.model_files import FILTER, read_flights, with_filter
from groundstation.dynamics.model import load_model, save_model, vehicle_model
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.learn.planning import HOVER, Limits, flight_of


def flown(tmp_path, plant):
    settings, file = tmp_path / f"{plant}.toml", tmp_path / f"{plant}.mcap"
    settings.write_text(f'plant = "{plant}"\ncraft = "crazyflie21"\n')
    FastPlace(str(settings), 0.5, 1.0).fly(flight_of(HOVER, "", Limits(), 1), file, seed=1)
    return file


@pytest.mark.parametrize(("plant", "names"), [("faithful", [FILTER]), ("reduced", [])])
def test_what_the_flow_decks_filter_makes_of_the_angles_is_in_the_given_model(
    tmp_path, plant, names
):
    save_model(vehicle_model(BUILT_IN["crazyflie21"]), tmp_path / "model.json")
    model = load_model(str(tmp_path / "model.json"))
    flights, _ = read_flights([flown(tmp_path, plant)], model, None)
    given, said = with_filter(model, flights)
    assert [term.name for term in given.effects if term.name == FILTER] == names
    assert len(said) == len(names)
    assert with_filter(given, flights)[0] == given, "once"
