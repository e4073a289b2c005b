"""Whether channels and recordings agree on an effect's size."""

from groundstation.discrepancy.judge import Evidence, disagreement

GYRO_Z, FORCE_Z = 2, 5


def evidence(parts):
    return Evidence(1000.0, 400.0, 500.0, 30.0, parts, (2.0, 1.0), (GYRO_Z, FORCE_Z))


def test_channels_that_both_show_an_effect_have_to_agree_on_it():
    parts = {(0, GYRO_Z): (0.2, 0.05), (0, FORCE_Z): (1.4, 0.04), (1, FORCE_Z): (1.4, 0.04)}
    assert disagreement(evidence(parts)).startswith("channels disagree on its size by")


def test_recordings_have_to_agree_too():
    parts = {(0, FORCE_Z): (0.3, 0.04), (1, FORCE_Z): (1.6, 0.04)}
    assert disagreement(evidence(parts)).startswith("recordings disagree on its size by")


def test_a_channel_that_hardly_shows_it_is_no_veto():
    # supply_sag beside a dead time that is not quite right yet: the yaw rate knows 0.6 % of it
    parts = {(0, GYRO_Z): (-2.1, 0.32), (0, FORCE_Z): (1.05, 0.03), (1, FORCE_Z): (0.91, 0.04)}
    assert disagreement(evidence(parts)) == ""
