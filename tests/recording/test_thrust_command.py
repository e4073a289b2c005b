"""Names under which the firmware's motor.m1 to m4 are found, whose duty may not be known."""

import pytest

from groundstation.recording.motor_columns import is_command


@pytest.mark.parametrize(
    "name",
    ["motor.m1", "motor_m2", "log_motor_m3", "log.motor.m4", "motor/m1", "/cf1/log/motor.m2"],
)
def test_the_firmwares_motors_are_known_under_any_spelling(name):
    assert is_command(name)


@pytest.mark.parametrize("name", ["m1", "motor.m5", "pwm.m1_pwm", "motor.m1req", "promotor_m1"])
def test_other_motors_are_not_the_firmwares_command(name):
    assert not is_command(name)


def test_where_the_map_names_the_craft_only_the_firmwares_own_name_is_doubted():
    assert is_command("motor.m1", craft_known=True)
    assert not is_command("motor_motor_m1", craft_known=True)
