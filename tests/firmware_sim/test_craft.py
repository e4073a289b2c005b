"""The stand-in as its users see it: reproducible, restartable, flyable for ever; and the rows of
its pilot's programme.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim import programme as programmes
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.programme import BUILT_IN, Excitation, Programme, Segment, Sticks, load_programme
from firmware_sim.settings import Loss
from support.plant import flown, programme, rows_of
from support.programs import run_program

REST = {"kind": "rest", "seconds": 3}


@pytest.fixture(scope="module")
def in_one_go():
    return StandIn(StandInSettings(seed=5, program="excite")).advance(8.0)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(0.0, 8.0), max_size=30))
def test_a_flight_is_the_same_however_its_time_is_sliced(in_one_go, instants):
    craft = StandIn(StandInSettings(seed=5, program="excite"))
    parts = [craft.advance(t) for t in [*sorted(instants), 8.0]]
    packets = np.concatenate([p for p, _ in parts])
    arrivals = np.concatenate([t for _, t in parts])
    assert packets.tobytes() == in_one_go[0].tobytes()
    assert arrivals.tobytes() == in_one_go[1].tobytes()


def test_packets_reach_the_host_in_order_and_not_before_they_are_due():
    craft = StandIn(StandInSettings())
    before = 0.0
    for step in range(1, 300):
        _, arrivals = craft.advance(step * 0.01)
        assert (np.diff(arrivals) >= 0).all()
        assert len(arrivals) == 0 or (before < arrivals[0] and arrivals[-1] < step * 0.01 + 1e-9)
        before = arrivals[-1] if len(arrivals) else before


def test_another_seed_is_another_flight():
    packets = [StandIn(StandInSettings(seed=seed)).advance(6.0)[0] for seed in (1, 2)]
    assert packets[0].tobytes() != packets[1].tobytes()


def test_nothing_hidden_shows_in_the_layout_of_a_packet():
    """Same number of packets, same fields in the same ranges: only the physics differs."""
    plain, hidden = (
        flown(8.0, effects=effects)[1] for effects in ({}, {"rotor_drag": {"drag_n_s_m": 0.02}})
    )
    assert (plain["timestamp"] == hidden["timestamp"]).all()
    assert (plain["debug"] == hidden["debug"]).all()


def test_an_empty_cell_is_changed_and_the_craft_flies_again():
    craft = StandIn(StandInSettings(charge=0.08, program="hover", truth=True, recharge_s=10.0))
    packets, arrivals = craft.advance(60.0)
    truth = craft.truth()
    assert craft.state().boots == 2
    silence = np.diff(arrivals).argmax()
    assert np.diff(arrivals)[silence] == pytest.approx(10.0, abs=0.1)
    first = truth["time_s"] < arrivals[silence]
    assert truth["position_m"][first][:, 2].max() > 0.7
    assert truth["position_m"][first][-1, 2] < 0.0  # stood on the ground before the change
    assert np.abs(truth["velocity_m_s"][first][:, 2]).max() < 1.0
    assert truth["position_m"][-1, 2] == pytest.approx(0.8, abs=0.1)
    stamps = packets[:, :2].copy().view("<u2")[:, 0].astype(int)
    before, after = stamps[silence], stamps[silence + 1]
    steps = (after - before) % 65536 / (0.002 / (73e-6 / 72)) % 1
    assert 0.01 < steps < 0.99  # the timer started anew: off the 2 ms grid
    assert 100 < (after - stamps[0]) % 65536 < 65436  # and with another phase


def test_a_full_cell_carries_the_craft_for_about_seven_minutes():
    craft = StandIn(StandInSettings(program="hover", truth=True, copies=1))
    for minute in range(1, 10):
        craft.advance(60.0 * minute)
    truth = craft.truth()
    airborne = truth["position_m"][:, 2] > 0.1
    change = truth["time_s"][np.diff(truth["time_s"]).argmax()]
    first_flight = airborne & (truth["time_s"] <= change)
    assert first_flight.sum() * 0.002 == pytest.approx(420, abs=40)
    assert truth["current_a"][first_flight].mean() == pytest.approx(1.4, abs=0.15)


def test_too_much_current_opens_the_protection(tmp_path):
    punch = {"kind": "bench", "seconds": 5, "thrust": 60000}
    craft = StandIn(StandInSettings(program=programme(tmp_path, REST, punch)))
    _, arrivals = craft.advance(6.0)
    assert arrivals[-1] < 3.1
    assert not craft.state().powered


def test_the_bench_gate_times_half_revolutions_and_glitches():
    craft, rows = flown(
        20.0,
        plant="reduced",
        program="motor_bench",
        truth=True,
        loss=Loss(good_loss=0.0),
    )
    spinning = slice(2600, len(rows["debug"]))
    speed = craft.truth()["rotor_rev_s"][spinning, 0][: len(rows["debug"]) - 2600]
    measured = 0.5 / (rows["debug"][spinning] * 73e-6 / 72)
    ratio = measured / speed
    assert np.median(ratio) == pytest.approx(1.0, abs=0.002)
    glitches = np.abs(ratio - 1) > 0.1
    assert 0.05 < glitches.mean() < 0.15
    assert (np.abs(ratio[glitches] - 0.5) < 0.05).any()  # a missed blade
    assert rows["motors"][spinning, 0].std() > 300
    assert np.abs(rows["angles"][spinning]).max() < 50  # fixed to the bench


def test_a_stiff_supply_does_not_sag():
    _, rows = flown(10.0, plant="reduced", program="motor_bench", supply_v=3.7)
    assert set(rows["battery"][600:]) == {3700}


def test_a_hand_turns_the_craft_and_puts_it_back():
    _, rows = flown(30.0, program="hand_rotation")
    angles = rows["angles"] / 100
    assert np.abs(angles).max(axis=0) == pytest.approx([50, 40, 70], abs=8)
    assert np.abs(angles[-200:] - angles[1200:1400].mean(0)).max() < 1.0
    assert rows["motors"][1000:].max() == 0


def test_the_axis_check_turns_the_stated_way_first():
    _, rows = flown(22.0, program="axis_check")
    angles = rows["angles"] / 100
    for axis, sign in ((0, 1), (1, -1), (2, 1)):  # the packet's pitch is nose up
        turned = sign * angles[:, axis]
        assert turned.argmax() < turned.argmin()
        assert turned.max() > 30
        assert turned.min() < -30


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_every_built_in_programme_runs(name):
    packets, _ = StandIn(StandInSettings(program=name)).advance(12.0)
    assert len(packets) > 20000


def test_a_programme_can_be_written_in_toml(tmp_path):
    step = {"axis": "roll", "shape": "step", "amplitude": 6, "start_s": 4, "end_s": 5}
    fly = {"kind": "fly", "seconds": 8, "keep": 0, "excite": [step]}
    _, rows = flown(8.2, program=programme(tmp_path, REST, fly), plant="reduced")
    roll = rows["angles"][:, 0] / 100
    assert roll[3700:3980].mean() == pytest.approx(6, abs=2)
    assert abs(roll[3300:3480].mean()) < 1


def test_a_programme_pushes_the_collective_thrust_on_top_of_the_held_height(tmp_path):
    push = {"axis": "collective", "shape": "step", "amplitude": 0.4, "start_s": 7, "end_s": 7.3}
    fly = {"kind": "fly", "seconds": 9, "excite": [push]}
    craft, _ = flown(10.8, program=programme(tmp_path, REST, fly), plant="reduced", truth=True)
    truth = craft.truth()
    squares = (truth["rotor_rev_s"] ** 2).sum(axis=1)
    before, pushed = squares[4800:4980].mean(), squares[5020:5150].max()
    assert 1.2 < pushed / before < 1.45
    assert truth["position_m"][5020:, 2].max() < 1.2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = 1", "Expected `str`"),
        ('name = "x"\nsegment = []', "at least"),
        ('name = "x"\nrepeat = 3\n[[segment]]\nkind = "rest"\nseconds = 1', "repeat 3"),
        ('name = "x"\n[[segment]]\nkind = "loop"\nseconds = 1', "segment"),
    ],
)
def test_a_bad_programme_is_refused_with_its_reason(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        StandIn(StandInSettings(program=str(path)))


def test_a_programme_that_is_nowhere_is_refused():
    with pytest.raises(ValueError, match="neither built in"):
        StandIn(StandInSettings(program="barrel_roll"))


def test_random_excitation_differs_from_lap_to_lap_but_not_from_call_to_call():
    excite = (Excitation(axis="roll", shape="random", amplitude=5.0),)
    lap = Programme(
        name="laps", segment=(Segment(kind="fly", seconds=2.0, excite=excite),), repeat=0
    )
    sticks = Sticks(lap, seed=3)
    rows = sticks.rows(0, 600)
    assert (rows[:200] != rows[200:400]).any()
    pieces = [sticks.rows(first, 50) for first in range(550, -1, -50)]
    assert (np.concatenate(pieces[::-1]) == rows).all()
    assert (Sticks(lap, seed=4).rows(0, 200) != rows[:200]).any()


def test_importing_the_package_does_not_load_the_compiler():
    code = "import firmware_sim, firmware_sim.craft, sys; assert 'numba' not in sys.modules"
    run_program([sys.executable, "-c", code], check=True)


def test_rows_come_from_packets_that_survive_loss():
    _, clean = flown(6.0, loss=Loss(good_loss=0.0))
    packets, _ = StandIn(StandInSettings(loss=Loss(good_loss=0.3))).advance(6.0)
    lossy = rows_of(packets)
    assert set(lossy["timestamp"]) <= set(clean["timestamp"])
    expected = len(clean["timestamp"]) * (1 - 0.3**4)
    assert len(lossy["timestamp"]) == pytest.approx(expected, rel=0.01)


def test_many_flights_at_once_are_the_flights_one_by_one():
    crafts = [StandInSettings(seed=seed, copies=1) for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        together = list(
            pool.map(lambda craft: craft.advance(5.0)[0].tobytes(), map(StandIn, crafts))
        )
    assert together == [StandIn(settings).advance(5.0)[0].tobytes() for settings in crafts]


def test_rows_are_the_same_however_they_are_asked_for_and_no_segment_is_made_twice(monkeypatch):
    flown = load_programme("excite")
    whole = Sticks(flown, 3).rows(0, 40_000)
    made = []
    rows_of = programmes._segment_rows
    monkeypatch.setattr(
        programmes, "_segment_rows", lambda *given: made.append(given) or rows_of(*given)
    )
    sticks = Sticks(flown, 3)
    for first in range(0, 39_990, 7):
        np.testing.assert_array_equal(sticks.rows(first, 9), whole[first : first + 9])
    ahead = len(made)
    assert ahead <= 2 + 40_000 * programmes.TICK_S / min(one.seconds for one in flown.segment)
    np.testing.assert_array_equal(sticks.rows(0, 9), whole[:9])  # powered on anew
    assert len(made) == ahead + 1
