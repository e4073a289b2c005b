"""Every effect has a name and a meaning that need no knowledge of the program."""

import re

import pytest

from groundstation.dynamics.meanings import physics_of, title_of
from groundstation.dynamics.registry import EFFECTS


@pytest.mark.parametrize("name", list(EFFECTS))
def test_each_effect_says_what_it_does_with_the_size_that_it_has(name):
    effect = EFFECTS[name]
    values = {one.name: one.high for one in effect.parameters}
    assert title_of(name) != name.replace("_", " ") or " " in title_of(name)
    said = physics_of(name, values)
    assert said
    assert not re.search(r"[{}]", said)
    less = physics_of(name, {key: value / 2 for key, value in values.items()})
    assert (said != less) == bool(re.search(r"\d", said))


def test_sizes_are_told_in_units_that_people_use():
    assert "8 mN for each m/s" in physics_of("rotor_drag", {"drag_n_s_m": 0.008})
    assert "9 ms late" in physics_of("dead_time", {"delay_s": 0.009})
    assert "off by +12 %" in physics_of("rotor_mismatch", {"rotor": 2, "excess": 0.12})


def test_an_effect_of_ones_own_keeps_its_name():
    assert title_of("yaw_weather_vane") == "yaw weather vane"
    assert physics_of("yaw_weather_vane", {"size": 1.0}) == ""
