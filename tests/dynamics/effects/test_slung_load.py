"""A load on a line: as mechanics has it, and as the stand-in, written apart, has it."""

import math

import numpy as np
import pytest

from firmware_sim.layout import LOAD
from groundstation.dynamics.effect import FAR_M, Body
from groundstation.dynamics.registry import EFFECTS
from support.plant import plant, rotation, slopes

LOAD_VALUES = {"percent": 11.0, "length_m": 0.4, "damping_per_s": 0.3, "below_m": 0.012}
LAW = EFFECTS["slung_load"].law
STILL, FOUR = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)


class Craft:
    """What the law reads of one."""

    def __init__(self, mass, inertia):
        self.mass, self.inertia = float(mass), tuple(map(float, inertia))


def moving(seed):
    """(quaternion, specific force in body axes, line's direction, its slope) far from rest."""
    generator = np.random.default_rng(seed)
    quaternion = np.array([1.0, *generator.normal(0.0, 0.2, 3)])
    quaternion /= np.linalg.norm(quaternion)
    line = np.array([*generator.normal(0.0, 0.4, 2), -1.0])
    line /= np.linalg.norm(line)
    slope = np.cross(line, generator.normal(0.0, 3.0, 3))
    force = np.array([*generator.normal(0.0, 1.0, 2), generator.uniform(7.0, 13.0)])
    return quaternion, force, line, slope


def felt(craft, quaternion, force, line, slope, **values):
    """What the law gives: angular acceleration, push in inertial axes, the line's slopes."""
    body = Body(FAR_M, tuple(quaternion), STILL, STILL, FOUR, FOUR, 0.0, STILL, tuple(force))
    given = tuple({**LOAD_VALUES, **values}.values())
    turn, push, change = LAW(given, craft, body, (*line, *slope))
    return np.array(turn), rotation(quaternion) @ push, np.array(change)


CRAFT = Craft(0.03, (1.6e-5, 1.7e-5, 2.9e-5))


@pytest.mark.parametrize("seed", range(5))
def test_craft_and_load_together_move_as_the_thrust_says(seed):
    """What the line does to the one it does to the other: momentum."""
    quaternion, force, line, slope = moving(seed)
    _, push, change = felt(CRAFT, quaternion, force, line, slope, damping_per_s=0.0)
    load = push + LOAD_VALUES["length_m"] * change[3:]
    np.testing.assert_allclose(0.89 * push + 0.11 * load, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_line_keeps_its_length(seed):
    quaternion, force, line, slope = moving(seed)
    _, _, change = felt(CRAFT, quaternion, force, line, slope)
    np.testing.assert_allclose(change[:3], slope, atol=1e-12)
    assert line @ change[3:] == pytest.approx(-slope @ slope)


def test_a_load_that_hangs_along_the_thrust_is_only_carried():
    quaternion = moving(1)[0]
    line = -rotation(quaternion)[:, 2]
    turn, push, change = felt(CRAFT, quaternion, (0.0, 0.0, 9.5), line, np.zeros(3))
    for nothing in (turn, push, change):
        np.testing.assert_allclose(nothing, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_stand_in_has_the_same_load(seed):
    quaternion, _, line, slope = moving(seed)
    found = []
    for effects in ({}, {"slung_load": LOAD_VALUES}):
        p, s = plant(effects={"rotor_drag": {}, **effects})
        s["y"][0, 3:6] = 0.6, -0.9, 0.2
        s["y"][0, 6:10], s["y"][0, 13:17] = quaternion, (250.0, 262.0, 241.0, 248.0)
        s["y"][0, LOAD : LOAD + 4] = 0.4 * np.array([*line[:2], *slope[:2]])
        found.append((slopes(p, s), s["force"][0].copy()))
    (bare, force), (loaded, _) = found
    turn, push, change = felt(Craft(p[0]["mass"], p[0]["inertia"]), quaternion, force, line, slope)
    np.testing.assert_allclose(loaded[3:6] - bare[3:6], push, atol=1e-9)
    np.testing.assert_allclose(loaded[10:13] - bare[10:13], turn, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(loaded[LOAD + 2 : LOAD + 4], 0.4 * change[3:5], atol=1e-9)


def test_a_small_swing_under_a_free_craft_has_the_pace_of_its_line_and_of_both_masses():
    line, slope, period_s, passed = np.array([0.05, 0.0, -1.0]), np.zeros(3), 1e-3, []
    for _ in range(3000):
        _, _, change = felt(
            CRAFT, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 9.81), line, slope, damping_per_s=0.0
        )
        slope = slope + period_s * change[3:]
        line = line + period_s * slope
        passed.append(line[0])
    crossings = np.flatnonzero(np.diff(np.sign(passed)))
    pace = math.pi / (np.diff(crossings).mean() * period_s)
    assert pace == pytest.approx(math.sqrt(9.81 / 0.4 / 0.89), rel=2e-3)
