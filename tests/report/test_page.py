"""A report is one file that shows what it was given, and never more than that."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from groundstation import __version__
from groundstation.errors import BadInputError
from groundstation.report.page import (
    BAD,
    GOOD,
    IMPROVED,
    IN_THE_DARK,
    INK,
    MEASURED,
    MODELLED,
    NEUTRAL,
    NOTE,
    PAPER,
    SERIES,
    Page,
    figure,
    png,
    style,
    svg,
    themed,
    thinned,
)


def drawn():
    made, (left, right) = figure(8, 3, columns=2)
    left.plot(np.linspace(0, 1, 50), np.linspace(0, 1, 50) ** 2, label="square")
    left.set_title("left")
    right.imshow(np.eye(3))
    return made


def test_a_page_needs_no_other_file_and_escapes_what_it_is_given(tmp_path):
    page = Page("Gap <of> & model", "flight \udcff.mcap")
    page.heading("Where")
    page.verdict("one effect found", "good")
    page.table(["name", "value"], [["<script>", 1.23456789], ["none", None]], "a table")
    page.figure(drawn(), "what one sees")
    page.bullets(["a < b"])
    page.links([("the recording", 'a"b.mcap')])
    path = tmp_path / "report.html"
    page.write(path)
    text = path.read_text(encoding="utf-8")
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert "1.235" in text
    assert "<footer>" in text
    assert re.search(r"<dt>made</dt><dd>\d{4}-\d\d-\d\d ", text)
    assert re.search(r"<dt>command</dt><dd>\S", text)
    assert f"groundstation {__version__}" in text
    assert f"numpy {np.__version__}" in text
    assert 'href="a&quot;b.mcap"' in text
    outside = re.findall(r'(?:src|href)="(?!#|a&quot;b)([^"]+)"', text)
    assert not [one for one in outside if one.startswith(("http", "//"))]


def test_prose_has_the_signs_of_print_and_commands_stay_as_they_are_typed():
    page = Page("Signs")
    page.text("c0 8 +- 2 rad/s^2, -0 % is left, -0.00 of 1, -0.5 and 1-0 stay: -0.")
    page.table(["value"], [[-0.0]])
    page.code(["groundstation fit body -0 --band 2^2 +-8"])
    html = page.html()
    assert "c0 8 ± 2 rad/s², 0 % is left, 0.00 of 1, -0.5 and 1-0 stay: 0." in html
    assert '<td class="n">0</td>' in html
    assert "<span>-0</span> <span>--band</span> <span>2^2</span> <span>+-8</span>" in html


def test_a_report_is_never_overwritten(tmp_path):
    path = tmp_path / "report.html"
    path.write_text("mine")
    with pytest.raises(BadInputError, match="exists already"):
        Page("x").write(path)
    assert path.read_text() == "mine"


def test_a_report_into_a_missing_folder_is_one_clear_error(tmp_path):
    with pytest.raises(BadInputError, match="cannot be written"):
        Page("x").write(tmp_path / "none" / "report.html")


def test_a_row_of_another_length_than_the_head_is_refused():
    with pytest.raises(ValueError, match="3 cells under 2"):
        Page("x").table(["a", "b"], [["1", "2", "3"]])


def test_a_figure_is_valid_svg_and_the_same_every_time():
    one, other = svg(drawn()), svg(drawn())
    assert one == other
    assert ElementTree.fromstring(one).tag.endswith("svg")
    assert png(drawn())[:4] == b"\x89PNG"


def test_thinning_keeps_columns_together():
    x, y = thinned(np.arange(10000.0), np.arange(10000.0) * 2, most=100)
    assert len(x) == 100
    np.testing.assert_array_equal(y, 2 * x)


def test_every_colour_of_a_drawing_has_one_for_the_dark():
    made, (axes,) = figure()
    for color in (*SERIES, MEASURED, MODELLED, IMPROVED, GOOD, BAD, NEUTRAL):
        axes.plot([0, 1], color=color)
    axes.text(0.5, 0.5, "of nobody's choice")
    axes.legend(["one"])
    drawn = themed(svg(made))
    assert not re.findall(r": (#[0-9a-f]{6})", drawn)
    variables = set(re.findall(r"var\((--f[0-9a-f]{6}),", drawn))
    assert len(variables) > 10
    assert all(f"{name}:" in style() for name in variables)


def contrast(one, other):
    def light(color):
        parts = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
        r, g, b = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    dark, bright = sorted((light(one), light(other)))
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("color", [INK, NOTE, MEASURED])
def test_text_in_figures_can_be_read_in_both_themes(color):
    assert contrast(color, PAPER) >= 4.5
    assert contrast(IN_THE_DARK[color], IN_THE_DARK[PAPER]) >= 4.5


@pytest.mark.parametrize("color", [MEASURED, MODELLED, IMPROVED, GOOD, BAD, NEUTRAL])
def test_lines_stand_out_in_both_themes(color):
    """WCAG 1.4.11: graphical objects, 3:1."""
    assert contrast(color, PAPER) >= 3.0
    assert contrast(IN_THE_DARK[color], IN_THE_DARK[PAPER]) >= 3.0
