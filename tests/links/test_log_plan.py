"""What is asked of which firmware."""

import pytest

from groundstation.errors import BadInputError, LinkError
from groundstation.links.log_rows import BLOCK_BYTES, TYPE_BYTES, plan_log

TODAY = {
    **{f"gyro.{axis}": "float" for axis in "xyz"},
    **{f"acc.{axis}": "float" for axis in "xyz"},
    **{f"motor.m{m}": "uint16_t" for m in range(1, 5)},
    **{f"stateEstimate.{name}": "float" for name in ("roll", "pitch", "yaw")},
    "stateEstimateZ.quat": "uint32_t",
    "pm.vbatMV": "uint16_t",
    "pm.vbat": "float",
    "range.zrange": "uint16_t",
}
DECK = {f"rpm.m{m}": "uint16_t" for m in range(1, 5)}


def names(plan):
    return {name for block in plan.blocks for name, _ in block}


@pytest.mark.parametrize("listed", [TODAY, TODAY | DECK])
def test_all_of_it_fits_into_two_blocks(listed):
    plan = plan_log(listed)
    sizes = [sum(TYPE_BYTES[kind] for _, kind in block) for block in plan.blocks]
    assert len(sizes) == 2
    assert max(sizes) <= BLOCK_BYTES
    assert {"gyro.x", "motor.m4", "pm.vbatMV", "acc.z"} <= names(plan)


def test_what_is_missing_is_said_with_what_it_costs():
    (said,) = plan_log(TODAY).missing
    assert said.startswith("no rotor speeds (rpm.m1 or motor.m1_rpm): ")
    assert plan_log(TODAY | DECK).missing == ()
    software = {name: kind for name, kind in TODAY.items() if not name.startswith("pm.")}
    assert any(said.startswith("no battery voltage") for said in plan_log(software).missing)


def test_the_names_of_other_releases_mean_the_same():
    older = {name: kind for name, kind in TODAY.items() if not name.startswith("stateEstimate")}
    older |= {f"stabilizer.{name}": "float" for name in ("roll", "pitch", "yaw")}
    older = {name.replace("motor.m", "pwm.m") + "_pwm" * name.startswith("motor"): kind
             for name, kind in older.items()}  # fmt: skip
    plan = plan_log(older)
    assert {"pwm.m1_pwm", "stabilizer.pitch"} <= names(plan)
    assert plan.known_as["stabilizer.pitch"] == "stateEstimate.pitch"


def test_a_craft_without_a_gyro_is_refused():
    with pytest.raises(LinkError, match=r"no gyro\.x"):
        plan_log({"pm.vbat": "float"})


def test_further_variables_have_blocks_of_their_own():
    plan = plan_log(TODAY, ["range.zrange"])
    assert plan.extra == ((("range.zrange", "uint16_t"),),)
    with pytest.raises(BadInputError, match=r"range\.zrang: .* near are range\.zrange"):
        plan_log(TODAY, ["range.zrang"])


@pytest.mark.parametrize("listed", [TODAY, TODAY | DECK])
def test_rows_slower_than_the_motors_settings_have_them_in_two_blocks(listed):
    plan = plan_log(listed, slow=True)
    assert len(plan.blocks) == 2
    motors = tuple(f"motor.m{m}" for m in range(1, 5))
    for block in plan.blocks:
        assert {*motors} <= {name for name, _ in block}
        assert sum(TYPE_BYTES[kind] for _, kind in block) <= BLOCK_BYTES
    assert plan.again == 1
    assert tuple(name for name, _ in plan.blocks[1][-4:]) == motors
    assert plan_log(listed).again == 0
