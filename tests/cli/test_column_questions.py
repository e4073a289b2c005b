"""A column map made in the terminal: Enter takes the guess, a wrong answer is asked again."""

import pytest
from typer.testing import CliRunner

from groundstation.cli.app import app
from groundstation.errors import BadInputError
from groundstation.recording.formats import open_recording
from groundstation.recording.map_document import load_column_map
from support.commands import Terminal, done

HEADER = "t_ms;wx;rollrate;az;theta;note\n"
ROWS = [f"{2 * n};{60 * (-1) ** n};0.5;9.8;1.5;hover" for n in range(100)]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "my log.csv"
    path.write_text(HEADER + "\n".join(ROWS) + "\n")
    return path


def answer(log, *answers, more=()):
    """What is said where these lines are typed."""
    typed = "".join(f"{one}\n" for one in answers)
    return done("convert", log, *more, "--map", typed=typed).output


def map_of(log):
    return log.with_name("my log.map.toml")


TAKEN = [""] * 15


def test_enter_takes_every_guess_and_the_command_that_reads_the_file_is_told(log):
    said = answer(log, *TAKEN)
    assert "time [1 t_ms in ms: its name says ms]" in said
    assert f"groundstation inspect '{log}' --columns '{map_of(log)}'" in said
    samples = open_recording(log, column_map=map_of(log)).samples
    assert len(samples) == 100
    assert samples.accelerometer[:, 2] == pytest.approx(9.8)
    assert not list(log.parent.glob("*.mcap"))


def test_with_a_new_file_s_name_the_conversion_follows(log, tmp_path):
    said = answer(log, *TAKEN, more=[tmp_path / "flight.mcap"])
    assert f"{tmp_path / 'flight.mcap'}: 100 samples" in said
    assert len(open_recording(tmp_path / "flight.mcap").samples) == 100


def test_a_wrong_answer_gets_a_line_and_is_asked_again(log):
    said = answer(
        log,
        *("", "-", "-"),  # time, battery, motors: left out
        *("wy", "note", "2", "furlong", "deg/s", "left", "-"),  # gyro.x
        *("-", "-", "-", "-"),  # gyro.y, .z, accelerometer.x, .y
        *("", "-", "", "-", "-"),  # accelerometer.z, roll, pitch, yaw, rotors
    )
    assert "There is no column wy. Did you mean wx?" in said
    assert "Column 6 note holds no numbers." in said
    assert "furlong is no unit of gyro." in said
    assert "Give + or -." in said
    made = load_column_map(map_of(log))
    assert (made.gyro.x.column, made.gyro.x.unit, made.gyro.x.sign) == ("wx", "deg/s", -1)
    assert made.accelerometer.z.column == "az"
    assert made.gyro.y is None
    assert made.battery is None


def test_answers_that_end_too_soon_write_nothing(log):
    with pytest.raises(BadInputError, match=r"answers ended.*nothing was written"):
        answer(log, "", "")
    assert not map_of(log).exists()


def test_nothing_but_time_is_no_map(log):
    with pytest.raises(BadInputError, match="no channel was given a column"):
        answer(log, "", *["-"] * 20)
    assert not map_of(log).exists()


def test_a_map_that_is_there_is_never_replaced_and_its_use_is_told(log):
    map_of(log).write_text("mine")
    with pytest.raises(BadInputError, match=r"exists already.*--columns"):
        answer(log, *TAKEN)
    assert map_of(log).read_text() == "mine"


@pytest.mark.parametrize("more", [("--columns", "cfclient"), ("--json",)])
def test_what_contradicts_a_dialogue_is_refused(log, more):
    with pytest.raises(BadInputError, match=f"leave {more[0]} out"):
        answer(log, more=more)


def test_a_name_for_the_new_file_is_due_without_a_map(log):
    found = CliRunner().invoke(app, ["convert", str(log)])
    assert found.exit_code == 2
    assert "OUT" in found.output


def test_in_a_terminal_each_question_waits_for_its_answer(log):
    with Terminal(log.parent, "convert", log, "--map") as terminal:
        terminal.until("time [1 t_ms in ms")
        terminal.type(b"\r")
        terminal.until("battery [-]: ")
        terminal.type(b"\r")
        terminal.until("duty.m1 [-]: ")
        terminal.type(b"\r")
        terminal.until("gyro.x [")
        terminal.type(b"wx\r")
        terminal.until("unit, one of rad/s, deg/s, counts [")
        terminal.type(b"deg/s\r")
        terminal.until("sign, - where the axis points the other way [+]: ")
        terminal.type(b"\r" * 12)
        assert terminal.ends() == 0, terminal.shown
    assert load_column_map(map_of(log)).gyro.x.column == "wx"


@pytest.mark.parametrize(("keys", "status", "said"), [
    (b"\x03", 130, "interrupted"), (b"\x04", 1, "nothing was written"),
])  # fmt: skip
def test_ctrl_c_and_the_end_of_input_write_nothing(keys, status, said, log):
    with Terminal(log.parent, "convert", log, "--map") as terminal:
        terminal.until("time [1 t_ms in ms")
        terminal.type(keys)
        assert terminal.ends() == status, terminal.shown
        assert said in terminal.shown
    assert [one.name for one in log.parent.iterdir()] == [log.name]
