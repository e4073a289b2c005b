"""What the twin tells of a flight: nothing of a right model, the place where a wrong one parts."""

import numpy as np
import pytest

from groundstation.telemetry.samples import SampleBatch
from groundstation.twin.twin import LIMIT, Twin, episodes_of, in_words
from support.flights import BASE, told
from support.flights import twin_flight as flight


@pytest.mark.parametrize("loss", [0.0, 0.02])
def test_of_a_craft_that_is_as_modelled_it_tells_nothing(loss):
    assert told(flight(120.0, 4, loss=loss)) == []


@pytest.mark.parametrize(
    ("name", "channel", "regime"),
    [
        ("rotor_acceleration_torque", "gyro_z", "rotor acceleration"),
        ("velocity_moment", "gyro_y", "translation"),
        ("rotor_drag", "accelerometer_y", "translation"),
        ("accelerometer_bias", "accelerometer_z", "whole flight"),
        ("gyro_bias", "yaw", "whole flight"),
        ("rate_damping", "gyro_y", "high roll or pitch rate"),
    ],
)
def test_a_hidden_effect_is_told_by_the_channel_and_the_regime_it_shows_in(name, channel, regime):
    assert (channel, regime, True) in told(flight(60.0, 5, name))


def test_an_episode_is_told_once_and_says_since_when():
    (first, *more) = episodes_of(BASE, [flight(60.0, 5, "rotor_acceleration_torque")])
    assert not [each for each in more if each.place.channel == first.place.channel
                and each.end_s is None]  # fmt: skip
    assert first.statistic > LIMIT
    assert 3.0 < first.begin_s < first.noticed_s < 60.0
    assert in_words(first).startswith("yaw rate disagrees after rotor acceleration: ")


def test_one_blow_is_no_disagreement():
    samples = flight(60.0, 6)
    gyro = samples.gyro.copy()
    gyro[15_000:15_005, 1] += 0.5
    struck = SampleBatch(
        **{name: getattr(samples, name) for name in samples.__slots__ if name != "gyro"}, gyro=gyro
    )
    assert told(struck) == []


def test_a_landing_ends_what_was_told_and_the_next_flight_begins_anew():
    samples = flight(60.0, 5, "accelerometer_bias")
    later = flight(30.0, 7)
    shift = int(samples.ticks[-1]) + 500_000
    again = SampleBatch(
        **{
            name: getattr(later, name)
            for name in later.__slots__
            if name not in ("ticks", "segment")
        },
        ticks=later.ticks + shift,
        segment=later.segment + 1,
    )
    episodes = episodes_of(BASE, [samples, again])
    began = [each for each in episodes if each.end_s is None]
    ended = [each for each in episodes if each.end_s is not None]
    assert began
    assert {each.segment for each in began} == {0}
    assert {each.place for each in ended} == {each.place for each in began}
    assert all(each.why == "the flight was interrupted" for each in ended)
    assert all(each.end_s <= samples.time_s[-1] for each in ended)


def test_a_disagreement_that_passes_is_told_to_be_over():
    """An offset that comes and goes: the accelerometer of a craft that is otherwise as modelled."""
    samples = flight(120.0, 4)
    wrong = samples.accelerometer.copy()
    during = (samples.time_s > 30.0) & (samples.time_s < 50.0)
    wrong[during, 0] += 0.05 * 9.81
    columns = {name: getattr(samples, name) for name in samples.__slots__}
    episodes = episodes_of(BASE, [SampleBatch(**{**columns, "accelerometer": wrong})])
    (began,) = (each for each in episodes if each.end_s is None)
    (ended,) = (each for each in episodes if each.end_s is not None)
    assert began.place == ended.place
    assert began.place.channel == "accelerometer_x"
    assert 29.0 < began.begin_s < began.noticed_s < 35.0
    assert 50.0 < ended.end_s < 110.0


def test_what_is_shown_has_the_gap_of_each_channel():
    twin = Twin(BASE)
    shown = [each for each, _ in twin.feed(flight(60.0, 5, "accelerometer_bias"))]
    assert twin.learnt
    gap = np.nanmedian([each.gap for each in shown], axis=0)
    np.testing.assert_allclose(gap[:3], 1.0, atol=0.2)
    assert (gap[3:6] > 1.5).all()
    assert all(each.measured.shape == each.predicted.shape == (50, 9) for each in shown)
