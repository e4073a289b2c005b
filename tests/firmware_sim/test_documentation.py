"""docs/stand_in.md says what the code does."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from firmware_sim.effects.catalogue import EFFECTS
from firmware_sim.physics import parameters
from firmware_sim.programme import BUILT_IN
from firmware_sim.settings import Quirks, load_settings

TEXT = (Path(__file__).parents[2] / "docs" / "stand_in.md").read_text()


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_and_parameter_is_documented(name):
    (row,) = [line for line in TEXT.splitlines() if line.startswith(f"| `{name}` |")]
    for parameter in EFFECTS[name].parameters:
        assert f"`{parameter}`" in row


def test_every_programme_and_quirk_is_documented():
    for name in [*BUILT_IN, *Quirks.__struct_fields__]:
        assert f"`{name}`" in TEXT


def test_the_settings_example_loads(tmp_path):
    block = TEXT.split("```toml\n")[2].split("```")[0]
    path = tmp_path / "settings.toml"
    path.write_text(block)
    settings = load_settings(path)
    assert settings.effects == {"rotor_drag": {"drag_n_s_m": 0.01}}
    assert parameters(settings)[0]["plane_drag"] == 0.01
    assert msgspec.structs.replace(settings, seed=2).seed == 2


def test_a_setting_that_does_not_exist_is_named(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text("[sensor]\ndlfp = 3\n")
    with pytest.raises(ValueError, match=r"dlfp.*\$\.sensor"):
        load_settings(path)
