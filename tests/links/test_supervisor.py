"""What the bits of today's supervisor mean to who wants to fly."""

from __future__ import annotations

import pytest

from groundstation.links.command import (
    HEIGHT,
    HEIGHT_VARIANCE,
    INFO,
    LEAN,
    PLACE,
    PLACE_VARIANCES,
    POWER,
    Place,
    Supervisor,
)


@pytest.mark.parametrize(
    ("bits", "said"),
    [
        (0b0000_0000_0100_0100, "locked itself"),  # the firmware of April 2024 after a lost client
        (0b0000_0010_0100_0100, "locked itself"),  # that of 2026, which tells of trajectories too
        (0b0000_0000_1010_0100, "crashed"),
        (0b0000_0000_0010_0100, "on its side or its back"),
        (0b0000_1000_0000_0100, "a deck of the craft has reported a fault"),
        (0b0000_1000_0100_0100, "a deck of the craft has reported a fault"),
        (0b0000_0010_0000_0001, "is not armed"),
    ],
)
def test_what_keeps_a_craft_from_flying_is_said_in_words(bits: int, said: str) -> None:
    assert said in Supervisor.of({INFO: float(bits)}).hindrance


@pytest.mark.parametrize("bits", [0b0000_0010_0000_1110, 0b0000_0101_0001_1010])
def test_what_high_level_commands_do_keeps_nobody_from_flying(bits: int) -> None:
    assert Supervisor.of({INFO: float(bits), POWER: 0.0}).hindrance == ""


@pytest.mark.parametrize(
    ("variance_m2", "is_known"),
    [(0.0, False), (1e-5, True), (0.009, True), (0.02, False), (1.0, False)],
)
def test_a_height_is_known_where_the_filter_runs_and_is_sure(
    variance_m2: float, is_known: bool
) -> None:
    said = Supervisor.of({HEIGHT: 0.8, HEIGHT_VARIANCE: variance_m2})
    assert (said.height_m == 0.8) is is_known
    assert Supervisor.of({HEIGHT: 0.8}).height_m is None
    assert Supervisor.of({HEIGHT: float("nan"), HEIGHT_VARIANCE: variance_m2}).height_m is None


@pytest.mark.parametrize(("x_m2", "y_m2", "is_known"), [(1e-4, 1e-4, True), (1e-4, 1.0, False)])
def test_a_place_is_known_where_the_filter_is_sure_of_both_coordinates(
    x_m2: float, y_m2: float, is_known: bool
) -> None:
    said = dict(zip(PLACE_VARIANCES, (x_m2, y_m2), strict=True))
    assert Supervisor.of(said).knows_place is is_known
    assert not Supervisor.of({}).knows_place


def test_a_place_says_how_far_the_craft_leans() -> None:
    where = dict(zip(PLACE, (1.0, 2.0, 0.5, 0.1, 0.2, -0.3), strict=True))
    place = Place.of(where | dict(zip(LEAN, (30.0, 40.0), strict=True)), 7.0)
    assert (place.x_m, place.vz_m_s, place.heard_s) == (1.0, -0.3, 7.0)
    assert place.tilt_deg == pytest.approx(48.4, abs=0.1)
    assert not Place.of(where, 7.0).tilt_deg < 180.0, "level, though it does not say so"
