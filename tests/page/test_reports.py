"""Reports in a real browser: both themes, a phone, without scripts."""

import numpy as np
import pytest

from groundstation.report.page import Page, figure

PHONE = {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def report():
    """A report with everything that one can hold."""
    page = Page("Body of crazyflie1", "a flight")
    page.verdict("Found: rotor_drag.", "good")
    page.verdict("Stable, with little margin.", "neutral")
    page.verdict("Unstable.", "bad")
    page.heading("Parameters")
    head = [f"a wide heading {number}" for number in range(12)]
    page.table(head, [["word", *range(11)]], "What the columns mean.")
    page.code(["groundstation fit body flight.mcap"])
    page.links([("the recording", "flight.mcap")])
    for number in range(2):
        made, (axes,) = figure()
        axes.plot(np.sin(np.arange(0.0, 10.0, 0.1)), label="roll")
        axes.legend()
        page.figure(made, f"Figure of merit {number}.")
    return page.html()


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("viewport", [None, PHONE], ids=["desktop", "phone"])
def test_axe_finds_nothing_that_keeps_anybody_out_of_a_report(report, visit, theme, viewport):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = visit("about:blank", color_scheme=theme, **({"viewport": viewport} if viewport else {}))
    page.set_content(report)
    judged = axe.run(page)
    assert judged.response["passes"]
    assert judged.violations_count == 0, judged.generate_report()
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width <= page.viewport_size["width"]  # what is wide scrolls within itself


def test_lines_of_a_figure_are_bright_in_the_dark(report, visit):
    strokes = {}
    for theme in ("light", "dark"):
        page = visit("about:blank", color_scheme=theme)
        page.set_content(report)
        line = page.locator("svg #line2d_1 path, svg [id^=line2d] path").first
        strokes[theme] = line.evaluate("one => getComputedStyle(one).stroke")
    assert strokes["light"] != strokes["dark"]


def test_a_figure_is_enlarged_with_the_keyboard_where_nothing_may_run(report, visit):
    page = visit("about:blank", java_script_enabled=False)
    page.set_content(report)
    first, second = (page.locator("figure svg").nth(number) for number in range(2))
    width = first.bounding_box()["width"]
    page.get_by_role("radio", name="fit").first.focus()
    page.keyboard.press("ArrowRight")
    assert first.bounding_box()["width"] == pytest.approx(2 * width, rel=0.02)
    page.keyboard.press("ArrowRight")
    assert first.bounding_box()["width"] == pytest.approx(4 * width, rel=0.02)
    assert second.bounding_box()["width"] == width
