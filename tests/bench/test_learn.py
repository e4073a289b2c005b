"""Crafts learnt are counted as they came out."""

from bench.learn import change, table

SIZE = {"effect": "dead_time", "parameter": "delay_s", "inside": True}
RIGHT = {
    "case": "brushless-1",
    "named": ["dead_time"],
    "hidden": [SIZE],
    "names_right": True,
    "gains": "written: steps miss by less",
    "step_rms": {"before": 0.5, "after": 0.25},
    "batteries": 1,
    "air_s": 225.0,
    "seconds": 90.0,
}
WRONG = {
    **RIGHT,
    "case": "brushless-2",
    "named": ["gyro_bias"],
    "hidden": [{**SIZE, "inside": False}],
    "names_right": False,
    "gains": "put back: worse",
}
DIED = {"case": "brushless-3", "error": "the model does not fly"}


def test_gains_that_were_put_back_leave_the_steps_as_they_were():
    assert change(RIGHT) == 0.5
    assert change(WRONG) == 1.0


def test_what_was_missed_what_is_false_and_what_died_are_told_and_counted():
    lines = list(table([RIGHT, WRONG, DIED]))
    assert "| brushless, 1 | right | 1 of 1 | written | 0.500 | 0.250 | 1 | 225 | 90 |" in lines
    assert "missed dead_time, false gyro_bias" in lines[3]
    assert "the model does not fly" in lines[4]
    assert "names right: 1 of 3" in lines
    assert "sizes inside 95 %: 1 of 2" in lines
    assert "steps better: 1 of 3" in lines
