"""What the report draws where there is nothing to draw."""

import shutil

import pytest
from installed import RECORDINGS

from groundstation.demo import figures
from groundstation.report.figure import svg


class TwinThatNeverJudges:
    def __init__(self, model):
        pass

    def feed(self, samples):
        return iter(())


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "watched").mkdir()
    shutil.copy(RECORDINGS / "stand_in_flight.mcap", tmp_path / "watched")
    shutil.copy(RECORDINGS.parent / "tests" / "control" / "data" / "body.json", tmp_path)
    return tmp_path


def test_a_twin_that_never_came_to_judge_leaves_a_sentence_instead_of_lines(folder, monkeypatch):
    monkeypatch.setattr(figures, "Twin", TwinThatNeverJudges)
    made = figures.twin_figure(folder, [])
    (axis,) = made.axes
    assert not axis.lines
    assert "learns the noise" in axis.texts[0].get_text()
    assert "<svg" in svg(made)


def test_what_the_twin_said_is_marked_when_it_said_it(folder):
    made = figures.twin_figure(folder, [{"details": {"noticed_s": 12.5}}])
    (axis,) = made.axes
    assert any(list(line.get_xdata()) == [12.5, 12.5] for line in axis.lines)
    assert axis.get_ylim()[0] < 1.0 < axis.get_ylim()[1]
