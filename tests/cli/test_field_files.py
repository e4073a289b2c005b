"""Files as people have them: told what is wrong with them, never fitted as if nothing were."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.dynamics.model import load_model
from groundstation.errors import BadInputError, GroundStationError
from groundstation.recording.csv_file import write_table_csv
from groundstation.recording.formats import open_recording
from groundstation.recording.session import Recording

RECORDINGS = Path(__file__).parents[2] / "recordings"
C0 = 0.00425
"""Of the craft that flew (``recordings/stand_in_flight.mcap``)."""


@pytest.fixture(scope="module")
def flight():
    return open_recording(RECORDINGS / "stand_in_flight.mcap").samples


def written(path, samples, **channels):
    write_table_csv(Recording(path, "csv", replace(samples, **channels)), path)
    return path


def run(*arguments):
    found = CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=True)
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    return found.output


def fit_body(file, tmp_path):
    model = tmp_path / "model.json"
    said = run("fit", "body", file, "--vehicle", "crazyflie1", "-o", model)
    return load_model(model), said


def test_a_gyro_in_another_unit_gives_no_constants(flight, tmp_path):
    file = written(tmp_path / "rad.csv", flight, gyro=flight.gyro / np.float32(57.3))
    with pytest.raises(BadInputError, match=r"c0 is .*by the profile.*turns .* as gyro_x says"):
        fit_body(file, tmp_path)
    assert not (tmp_path / "model.json").exists()


def test_a_battery_in_another_unit_is_the_reason_that_is_given(flight, tmp_path):
    for scale in (1000.0, 0.001):
        volts = flight.battery_v * np.float32(scale)
        file = written(tmp_path / f"{scale}.csv", flight, battery_v=volts)
        with pytest.raises(BadInputError, match=r"battery up to .* V, which cannot be"):
            fit_body(file, tmp_path)


def test_motors_with_another_zero_predict_nothing_and_are_no_model(flight, tmp_path):
    file = written(tmp_path / "pwm.csv", flight, duty=0.476 + 0.5 * flight.duty)
    with pytest.raises(BadInputError, match=r"predicted worse than by its mean.*lies still"):
        fit_body(file, tmp_path)


def test_motors_of_100_hz_in_rows_of_500_are_fitted_as_what_they_are(flight, tmp_path):
    slow = flight.duty[np.arange(len(flight)) // 5 * 5]
    model, said = fit_body(written(tmp_path / "slow.csv", flight, duty=slow), tmp_path)
    assert "what the motors are set to is renewed 100 times a second in 500 rows" in said
    estimates = model.fit["body"]["estimates"]
    error = estimates["stderr"][estimates["names"].index("c0")]
    assert abs(model.body.c0 - C0) < 3 * error < 1.5 * C0


def test_motors_of_10_hz_are_refused_for_what_they_are(flight, tmp_path):
    slow = flight.duty[np.arange(len(flight)) // 50 * 50]
    with pytest.raises(BadInputError, match=r"set to is renewed 10 times a second in 500"):
        fit_body(written(tmp_path / "slow.csv", flight, duty=slow), tmp_path)


def test_late_stamps_do_not_cut_a_fit(flight, tmp_path):
    late = np.random.default_rng(1).exponential(6e-4, len(flight))
    stamps = np.maximum.accumulate(flight.time_s + late)
    samples = replace(flight, ticks=np.rint(stamps * 1e9).astype(np.int64), tick_s=1e-9)
    model, _ = fit_body(written(tmp_path / "late.csv", samples), tmp_path)
    assert model.body.c0 == pytest.approx(C0, rel=0.03)


def test_nothing_is_bad_and_nothing_is_made_of_it(tmp_path):
    empty = tmp_path / "empty.csv"
    empty.write_text("Timestamp,gyro.x,gyro.y,gyro.z\n")
    with pytest.raises(GroundStationError, match=r"no samples"):
        run("inspect", empty)
    with pytest.raises(GroundStationError, match=r"no samples"):
        run("convert", empty, tmp_path / "made.mcap")
    assert not (tmp_path / "made.mcap").exists()
