"""``python -m firmware_sim.hide``: what a seed hides, and where it shows."""

import msgspec
import numpy as np
import pytest

from firmware_sim.craft import StandIn
from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.hide import HIDEABLE, main
from firmware_sim.settings import load_settings

CRAFT = 'plant = "reduced"\nprogram = "hover"\nseed = 5\n\n[gains]\n"pid_rate.roll_kp" = 30.0\n'


def hide(tmp_path, seed, text=CRAFT):
    craft, sealed = tmp_path / "craft.toml", tmp_path / f"sealed{seed}.toml"
    craft.write_text(text)
    assert main(["--settings", str(craft), "--seed", str(seed), "-o", str(sealed)]) == 0
    return load_settings(craft), load_settings(sealed)


def test_only_one_listed_effect_tells_the_hidden_craft_from_the_plain_one(tmp_path):
    plain, hidden = hide(tmp_path, 3)
    ((name, values),) = hidden.effects.items()
    assert EFFECTS[name].listed
    assert set(values) == set(EFFECTS[name].parameters)
    for field in plain.__struct_fields__:
        if field != "effects":
            assert getattr(plain, field) == getattr(hidden, field)


def test_neighbouring_seeds_hide_different_effects_and_a_seed_always_the_same(tmp_path):
    names = [next(iter(hide(tmp_path, seed)[1].effects)) for seed in range(len(HIDEABLE))]
    assert sorted(names) == sorted(HIDEABLE)
    again = tmp_path / "again"
    again.mkdir()
    assert hide(again, 4)[1] == load_settings(tmp_path / "sealed4.toml")


def test_what_is_said_does_not_give_it_away(tmp_path, capsys):
    _, hidden = hide(tmp_path, 0)
    (name,) = hidden.effects
    said = capsys.readouterr()
    assert name not in said.out + said.err


def test_a_daemon_s_configuration_stays_one(tmp_path):
    lines = CRAFT.replace("[gains]", "[stand_in.gains]")
    _, hidden = hide(tmp_path, 1, f"[stand_in]\n{lines}")
    assert len(hidden.effects) == 1
    assert hidden.gains == {"pid_rate.roll_kp": 30.0}


@pytest.mark.parametrize(
    ("text", "seed", "why"),
    [
        (CRAFT + "[effects.rotor_drag]\n", "1", "has effects already"),
        (CRAFT, "-1", "must not be negative"),
        ("plant = 3\n", "1", "craft.toml"),
        (CRAFT.replace("reduced", "faithful"), "7", "has attitude_filter_lean from the start"),
        ('plant = "reduced"\neffects = {}\n', "1", "no table can be added"),
    ],
)
def test_what_cannot_be_hidden_is_refused_in_one_line(tmp_path, capsys, text, seed, why):
    craft, sealed = tmp_path / "craft.toml", tmp_path / "sealed.toml"
    craft.write_text(text)
    assert main(["--settings", str(craft), f"--seed={seed}", "-o", str(sealed)]) == 1
    said = capsys.readouterr().err
    assert why in said
    assert said.count("\n") == 1
    assert not sealed.exists()


def test_a_file_that_is_there_is_not_overwritten(tmp_path, capsys):
    hide(tmp_path, 2)
    before = (tmp_path / "sealed2.toml").read_bytes()
    arguments = ["--settings", str(tmp_path / "craft.toml"), "--seed", "2"]
    assert main([*arguments, "-o", str(tmp_path / "sealed2.toml")]) == 1
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "sealed2.toml").read_bytes() == before


def test_with_what_is_hidden_the_craft_still_flies_on_its_own_gains(tmp_path):
    settings = tmp_path / "craft.toml"
    settings.write_text('[stand_in]\nplant = "reduced"\ncraft = "crazyflie1"\n')
    sealed = tmp_path / "sealed.toml"
    assert (
        main(["--settings", str(settings), "--seed", "3", "--effects", "3", "-o", str(sealed)]) == 0
    )
    hidden = load_settings(sealed)
    slow = {"gyro_low_pass": {"bandwidth_hz": 14.0}}  # as the seed's first sizes had it
    assert farthest_lean_deg(hidden) < 45.0
    assert farthest_lean_deg(msgspec.structs.replace(hidden, effects=hidden.effects | slow)) > 90.0


def farthest_lean_deg(settings):
    craft = StandIn(settings)
    leans = []
    for k in range(1, 200):
        craft.advance(0.1 * k)
        leans.append(np.abs(craft.state().angles_deg[:2]).max())
    return max(leans)
