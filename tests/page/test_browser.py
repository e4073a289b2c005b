"""The page in a real browser, with a real daemon and a craft that flies."""

import json
import re
import shutil

import numpy as np
import psutil
import pytest

from firmware_sim.supervisor import CRASHED
from groundstation.recording.formats import open_recording
from support import RECORDINGS
from support.crafts import served
from support.daemons import groundstation
from support.page_requests import expect
from support.waiting import until

FLIGHT = "stand_in_flight.mcap"
REAL_FLIGHTS = ("nanobench_figure8.mcap", "nanobench_trefoil.mcap")
NUMBERS = re.compile(r"^\d+ numbers$")


# these have daemons of their own: the one for all others flies only from then on
def test_a_daemon_that_is_started_again_is_found_by_the_open_page(page_daemon, visit):
    first = page_daemon()
    first.recording()
    page = visit(first.address())
    expect(page.locator("#live")).to_have_text("live")
    assert first.stop() == 0
    expect(page.locator("#alarms")).to_contain_text("The page gets no answer")
    expect(page.locator("#live")).to_contain_text("behind")
    second = page_daemon(port=first.port)
    expect(page.locator("#link")).to_have_text("stand-in: streaming")
    expect(page.locator("#live")).to_have_text("live")
    page.get_by_label("Mark this moment").fill("a new daemon")
    page.get_by_role("button", name="Mark", exact=True).click()
    expect(page.locator("#said")).to_have_text("Marked: a new daemon")
    assert second.stop() == 0


def test_a_stopped_daemon_is_told_as_an_alarm_and_its_rows_as_old(page_daemon, visit):
    daemon = page_daemon()
    daemon.recording()
    page = visit(daemon.address())
    expect(page.locator("#live")).to_have_text("live")
    daemon.process.send_signal(19)  # SIGSTOP
    expect(page.locator("#live")).to_have_text(re.compile(r"^\d+ s behind$"))
    daemon.process.send_signal(18)  # SIGCONT
    expect(page.locator("#live")).to_have_text("live")


def test_a_parameter_is_searched_changed_after_a_question_stored_and_put_back(page_daemon, visit):
    with served(craft="crazyflie21") as craft:
        page = visit(page_daemon("--link", craft.uri, "--no-record").address())
        expect(page.locator("#armed")).to_have_text("yes")
        expect(page.locator("#console")).to_contain_text("is up and running")
        page.get_by_role("link", name="Parameters").press("Enter")
        page.get_by_label("Search parameters").fill("pid_rate.roll_kp")
        row = page.locator("#parameter-rows tr")
        expect(row).to_have_count(1)
        before = row.get_by_role("cell").nth(1).text_content()
        row.get_by_label("New value of").fill("61")
        page.keyboard.press("Enter")
        page.get_by_role("dialog").get_by_role("button", name="No").click()
        expect(row).to_contain_text(before)
        page.get_by_role("button", name="Set pid_rate.roll_kp").press("Enter")
        expect(page.get_by_role("dialog")).to_contain_text(f"pid_rate.roll_kp: {before} to 61")
        page.get_by_role("dialog").get_by_role("button", name="Change").click()
        expect(row).to_contain_text(f"61 (was {before})")
        page.get_by_role("button", name="Store gains").click()
        page.get_by_role("dialog").get_by_role("button", name="Store").click()
        expect(row).to_contain_text(f"61 (was {before}), stored 61")
        assert craft.craft.stored == {"pid_rate.roll_kp": 61.0}
        page.get_by_role("button", name="Clear stored gains").click()
        page.get_by_role("dialog").get_by_role("button", name="Clear").click()
        expect(row).not_to_contain_text("stored")
        assert craft.craft.stored == {}
        page.get_by_role("button", name="Put back 1").click()
        page.get_by_role("dialog").get_by_role("button", name="Change").click()
        expect(row.get_by_role("cell").nth(1)).to_have_text(before)
        row.get_by_label("New value of").fill("1e9")
        page.keyboard.press("Enter")
        page.get_by_role("dialog").get_by_role("button", name="Change").press("Enter")
        expect(page.locator("#said")).to_contain_text("pid_rate.roll_kp")
        for part in ("Parameters", "Now"):
            page.get_by_role("link", name=part, exact=True).press("Enter")
            axe_finds_nothing(page)


def test_a_crashed_craft_is_let_recover(page_daemon, visit):
    with served(craft="brushless", protocol=12) as craft:
        page = visit(page_daemon("--link", craft.uri, "--no-record").address())
        expect(page.locator("#armed")).to_contain_text("not armed")
        button = page.get_by_role("button", name="Recover")
        expect(button).to_be_hidden()
        craft.craft._firmware[0]["supervisor"] = CRASHED
        expect(page.locator("#armed")).to_contain_text("says that it has crashed")
        button.click()
        expect(page.locator("#said")).to_have_text("The craft has recovered.")
        expect(button).to_be_hidden()
        expect(page.locator("#events")).to_contain_text("recover from its crash")


def test_the_page_shows_the_flight_as_it_goes(flying, visit):
    page = visit(flying.address())
    assert page.url == f"http://127.0.0.1:{flying.port}/"  # the token does not stay in the address
    expect(page.locator("#link")).to_have_text("stand-in: streaming")
    expect(page.locator("#live")).to_have_text("live")
    expect(page.locator("#battery")).to_have_text(re.compile(r"^[34]\.\d\d V$"))
    expect(page.locator("#roll")).to_have_text(re.compile(r"^-?\d+\.\d °$"))
    expect(page.locator("#rate")).to_have_text(re.compile(r"^\d+ a second$"))
    expect(page.locator("#disk")).to_contain_text("GB free")
    attitude, rates, motors = page.locator("#plots figure").all()
    expect(attitude).to_contain_text(re.compile(r"roll -?\d"))
    expect(motors).to_contain_text(re.compile(r"M4 -?\d"))
    expect(page.locator("#events")).to_contain_text("receiving")
    drawn = """(canvas) => {
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        return new Set(new Uint32Array(pixels.buffer)).size;
    }"""
    for canvas in (rates.locator("canvas"), page.locator("#craft-view")):
        until(lambda canvas=canvas: canvas.evaluate(drawn) > 50, "lines are drawn", 120)


def test_a_moment_is_marked_the_recording_stopped_and_found(flying, visit):
    page = visit(flying.address())
    page.get_by_role("button", name="Stop recording").wait_for()
    page.keyboard.press("m")
    page.keyboard.type('new <b>"propellers"</b>')
    page.keyboard.press("Enter")
    expect(page.locator("#said")).to_have_text('Marked: new <b>"propellers"</b>')
    expect(page.locator("#events")).to_contain_text('operator mark: new <b>"propellers"</b>')
    file = flying.status()["recording"]["path"]
    page.get_by_role("button", name="Stop recording").click()
    expect(page.locator("#said")).to_have_text("The recording is finished.")
    expect(page.locator("#alarms")).to_contain_text("Nothing is being recorded")
    assert 'new <b>"propellers"</b>' in [event["text"] for event in open_recording(file).events]
    page.get_by_role("button", name="Start recording").click()
    expect(page.locator("#recording")).to_have_text(re.compile(r"^\d+:\d\d$"))
    expect(page.locator("#alarms")).not_to_contain_text("Nothing is being recorded")
    assert flying.recording()["recording"]["path"] != file


def test_a_refusal_is_shown_in_the_words_of_the_daemon(flying, visit):
    page = visit(flying.address())
    page.get_by_label("Receive from", exact=True).fill("replay:../../etc/passwd")
    page.get_by_role("button", name="Switch link").click()
    expect(page.locator("#said")).to_contain_text("is not in the recordings folder")
    expect(page.locator("#link")).to_have_text("stand-in: streaming")


def test_two_browsers_see_the_same_and_an_address_lets_one_in(flying, visit):
    address = flying.address()
    printed = groundstation("page", socket_path=flying.socket).stdout.strip()
    first, second = visit(address), visit(printed)
    third = visit(address)
    expect(third.locator("body")).to_contain_text("has let a browser in already")
    first.get_by_label("Mark this moment").fill("from the first")
    first.get_by_role("button", name="Mark", exact=True).click()
    expect(second.locator("#events")).to_contain_text("from the first")


def test_a_killed_page_is_begun_anew_under_an_open_browser(flying, visit):
    page = visit(flying.address())
    expect(page.locator("#live")).to_have_text("live")
    before, old = flying.status(), flying.page_process()
    old.kill()
    flying.status_when(
        lambda status: (
            status["page"]["restarts"] > before["page"]["restarts"]
            and status["page"]["state"] == "serving"
        ),
        "the page again",
    )
    expect(page.locator("#live")).to_have_text("live")
    page.get_by_label("Mark this moment").fill("after the restart")
    page.get_by_role("button", name="Mark", exact=True).click()
    expect(page.locator("#said")).to_have_text("Marked: after the restart")
    after = flying.status()
    assert after["recording"]["dropped"] == before["recording"]["dropped"] == 0
    assert after["link"]["lost"] == before["link"]["lost"]
    until(lambda: not psutil.pid_exists(old.pid), "the old one is gone")


def test_a_browser_that_stood_still_says_how_old_its_rows_are_and_catches_up(flying, visit):
    page = visit(flying.address())
    expect(page.locator("#live")).to_have_text("live")
    # what it shows is kept, as a screen would; the page's own clock goes on meanwhile
    behind = page.evaluate("""async () => {
        const real = window.fetch;
        window.fetch = () => new Promise((_, give) => setTimeout(() => give(new Error()), 500));
        const shown = document.getElementById("live");
        while (!/^([4-9]|\\d\\d+) s behind$/.test(shown.textContent))
            await new Promise((go) => setTimeout(go, 50));
        window.fetch = real;
        return shown.textContent;
    }""")
    assert re.match(r"\d+ s behind", behind)
    expect(page.locator("#live")).to_have_text("live")
    seconds = page.evaluate("""async () => {
        const began = performance.now();
        while (performance.now() - began < 6000) ; // not even its clock
        return (performance.now() - began) / 1000;
    }""")
    assert seconds >= 6.0
    expect(page.locator("#live")).to_have_text("live")


def test_many_pages_are_one_reader_of_the_stream(flying, visit):
    first = visit(flying.address())
    expect(first.locator("#live")).to_have_text("live")
    before = flying.status()
    pages = [first.context.new_page() for _ in range(7)]
    for page in pages:
        page.goto(first.url)
        expect(page.locator("#link")).to_have_text("stand-in: streaming")
    after = flying.status_when(
        lambda status: status["recording"]["samples"] > before["recording"]["samples"] + 1000,
        "the recording goes on",
    )
    assert after["stream"]["clients"] == 1
    assert after["recording"]["dropped"] == before["recording"]["dropped"] == 0


def test_without_a_browser_nobody_reads_the_stream(flying, visit):
    page = visit(flying.address())
    expect(page.locator("#live")).to_have_text("live")
    assert flying.status()["stream"]["clients"] == 1
    page.context.close()
    flying.status_when(lambda status: status["stream"]["clients"] == 0, "the stream is left")


@pytest.mark.timeout(1200)
def test_a_recording_is_found_inspected_fitted_and_searched_and_the_reports_read(flying, visit):
    shutil.copy(RECORDINGS / FLIGHT, flying.sessions)
    page = visit(flying.address())
    page.get_by_role("link", name="Flights").click()
    row = page.locator("#recordings tr", has_text=FLIGHT)
    expect(row).to_contain_text("31.0 s")
    expect(row).to_contain_text("complete")
    with page.expect_download() as download:
        row.get_by_role("link", name=f"Download of {FLIGHT}").click()
    assert download.value.path().read_bytes() == (RECORDINGS / FLIGHT).read_bytes()
    row.get_by_label(f"Role of {FLIGHT}").select_option("fit")
    for work in ("Inspect", "Fit a model"):
        page.get_by_role("button", name=work).click()
        expect(page.locator("#said")).to_contain_text("Started")
    inspected = page.locator("#jobs tr", has_text="inspect")
    expect(inspected).to_contain_text("done")
    report = report_of(page, "fit")
    expect(report.locator("svg").first).to_be_visible()
    expect(report.locator("body")).to_contain_text("thrust_per_mass")
    fitted = page.locator("#jobs tr").filter(has=page.get_by_role("cell", name="fit", exact=True))
    expect(fitted).to_contain_text(re.compile(r"thrust_per_mass \S+ \+- \S+"))
    page.locator("#model").select_option(index=0)
    page.get_by_role("button", name="Find the discrepancy").click()
    expect(page.locator("#said")).to_contain_text("Started")
    report = report_of(page, "discrepancy")
    expect(report.locator("svg").first).to_be_visible()
    expect(report.locator("body")).to_contain_text("Proof:")
    fitted_model_flies_and_watches(page)
    page.get_by_role("link", name="Flights").click()
    with page.expect_popup() as opened:
        inspected.get_by_role("link", name="Log of").click()
    expect(opened.value.locator("body")).to_contain_text("verdict")


@pytest.mark.timeout(900)
def test_who_reads_only_the_page_gets_from_two_real_flights_to_what_is_missing_and_to_fly(
    page_daemon, visit
):
    page = visit(page_daemon().address())
    page.get_by_role("link", name="Open", exact=True).click()
    for name in REAL_FLIGHTS:
        example = page.get_by_role("button", name=name)
        if name != REAL_FLIGHTS[0]:  # they are folded away once a recording is shown
            page.locator("#examples-part summary").click()
        example.click()
        expect(page.locator("#opened-title")).to_have_text(name)
        expect(page.locator("#opened-state")).to_have_text(re.compile(r"^[\d.]+ s"))
    page.get_by_role("link", name="Flights").click()
    for name in REAL_FLIGHTS:
        page.get_by_label(f"Role of {name}").select_option("fit")
    page.get_by_role("button", name="Fit a model").click()
    fitted = page.locator("#jobs tr", has_text="The fit advises")
    fitted.get_by_role("button", name="Fit again with these").click()
    again = page.locator("#jobs tr", has_text="; with dead_time")
    expect(again).to_contain_text("done", timeout=900_000)
    expect(page.locator("#model option")).to_have_count(3)
    page.locator("#model").select_option(index=0)
    page.get_by_role("button", name="Find the discrepancy").click()
    report = report_of(page, "discrepancy").locator("body")
    cell = page.get_by_role("cell", name="discrepancy", exact=True)
    searched = page.locator("#jobs tr", has=cell)
    for name, words in {
        "velocity_moment": "tipping moment of blade flapping",
        "imu_lever_arm": "sensor off the centre",
    }.items():
        expect(searched).to_contain_text(f"{name}: ")
        expect(report).to_contain_text(words)
    expect(report).to_contain_text(
        re.compile(r"prediction errors fall from [\d.]+ to [\d.]+ times")
    )
    expect(report).to_contain_text(re.compile(r"Next: .+ fly "))


def report_of(page, work):
    """The report of a job, in a window of its own, when the job is done."""
    job = page.locator("#jobs tr", has=page.get_by_role("cell", name=work, exact=True))
    link = job.get_by_role("link", name="Report of")
    expect(link).to_be_visible(timeout=900_000)
    with page.expect_popup() as opened:
        link.click()
    return opened.value


def fitted_model_flies_and_watches(page):
    page.get_by_role("link", name="Models", exact=True).click()
    model = page.locator("#models section", has_text="_fit")
    expect(model).to_contain_text(FLIGHT)
    model.get_by_text(NUMBERS).click()
    c0 = model.get_by_role("row", name="body.c0")
    value, low, high = (float(text) for text in c0.get_by_role("cell").all_text_contents()[1:4])
    assert low < value < high < 1.1 * low
    expect(model.get_by_role("row", name="motor.a0")).to_contain_text("– (profile)")
    model.get_by_role("button", name="Watch the craft with this").click()
    expect(model.get_by_role("button", name="Watch no more")).to_be_visible()
    model.get_by_role("button", name="Fly in the stand-in").click()
    expect(model.get_by_role("button", name="Flies in the stand-in")).to_be_disabled()
    expect(page.locator("#link")).to_have_text(re.compile(r"^stand-in:.*_fit: streaming$"))
    model.get_by_role("button", name="Watch no more").click()
    page.get_by_role("link", name="Now", exact=True).click()
    expect(page.locator("#doing")).to_have_text("it flies, with battery 1")
    page.get_by_label("Receive from", exact=True).fill("stand-in")
    page.get_by_role("button", name="Switch link").click()
    expect(page.locator("#link")).to_have_text("stand-in: streaming")


def test_live_plots_are_paused_zoomed_and_read_and_words_explain_themselves(flying, visit):
    page = visit(flying.address())
    expect(page.locator("#live")).to_have_text("live")
    page.get_by_label("Seconds").select_option("5")
    values = page.locator("#plots .value")
    page.locator("#plots .plot").first.hover(position={"x": 400, "y": 40})
    until(lambda: "–" not in values.all_text_contents(), "samples under the cursor, in all plots")
    page.get_by_role("button", name="Pause the plots").press("Enter")
    under = values.all_text_contents()
    page.mouse.move(5, 5)
    until(lambda: values.all_text_contents() != under, "the newest values")
    newest = values.all_text_contents()
    for tool in ("Zoom in", "Earlier"):
        page.get_by_role("button", name=tool).press("Enter")
    until(lambda: values.all_text_contents() != newest, "the values of an earlier time")
    expect(page.locator("#live")).to_have_text("live")  # what comes is kept meanwhile
    page.get_by_role("button", name="Follow what comes").press("Enter")
    expect(page.get_by_role("button", name="Pause the plots")).to_be_visible()
    page.locator("#now summary", has_text="late").press("Enter")
    why = page.locator("#now details[open]")
    expect(why).to_contain_text("How much later than the fastest packets")
    assert why.get_by_role("link", name="More").get_attribute("href").startswith("/help/")


def test_any_file_is_opened_played_and_scrubbed_with_the_keyboard(flying, visit):
    page = visit(flying.address())
    page.evaluate(DROP, "notes.txt")
    expect(page.locator("#opened-state")).to_have_text(re.compile(r"^(?!Reading).*notes\.txt"))
    page.get_by_role("link", name="Open", exact=True).click()
    page.get_by_label("Choose a file").set_input_files(RECORDINGS / "README.md")
    expect(page.locator("#opened-state")).to_contain_text("README.md")
    expect(page.locator("#opened-view")).to_be_hidden()
    page.get_by_label("Choose a file").set_input_files(RECORDINGS / "microsd_log16")
    expect(page.locator("#opened-state")).to_contain_text("46.7 s")
    assert (flying.sessions / "microsd_log16.mcap").is_file()  # it can be fitted now
    assert not (flying.sessions / "opened").exists()
    plots = page.locator("#opened-plots figure")
    expect(plots).to_have_count(2)  # it has no attitude
    page.locator("#opened-tools summary").click()
    page.get_by_role("searchbox", name="Find a channel").fill("specific")
    page.get_by_role("checkbox", name="Specific force").check()
    expect(plots).to_have_count(3)
    page.locator("#examples-part summary").click()
    page.get_by_role("button", name="nanobench_trefoil.mcap").click()
    expect(page.locator("#opened-state")).to_contain_text("28.7 s")
    scrubber = page.get_by_label("Time in the recording")
    scrubber.focus()
    page.keyboard.press("End")
    expect(page.locator("#opened-time")).to_have_text(re.compile(r"^28\.\d\d s$"))
    page.keyboard.press("Home")
    expect(page.locator("#opened-time")).to_have_text("0.00 s")
    page.mouse.move(5, 5)  # values are those of the scrubber where no cursor is in a plot
    roll = plots.first.locator(".value").first
    before = roll.text_content()
    page.get_by_role("button", name="Play").press("Enter")
    expect(page.locator("#opened-time")).not_to_have_text("0.00 s")
    page.get_by_role("button", name="Pause", exact=True).press("Enter")
    page.evaluate("""() => {
        const scrubber = document.getElementById("scrubber");
        scrubber.value = 12;
        scrubber.dispatchEvent(new Event("input"));
    }""")
    expect(roll).not_to_have_text(before)
    expect(page.locator("#opened-pose")).to_contain_text("roll -1.4°, pitch -6.9°")
    assert page.evaluate("async () => (await import('/dom.js')).decimals(-0.04, 1)") == "0.0"
    # of this file, though the one before had the same channels in other places
    expect(plots.filter(has_text="Motors")).to_contain_text("M3 82.5")
    expect(plots.filter(has_text="Rates")).to_contain_text("x 21.1")


def test_of_a_file_that_nobody_knows_the_columns_are_asked_and_the_map_can_be_saved(
    flying, visit, tmp_path
):
    rows = [f"{2 * n};{60 * (-1) ** n};0.5;-9.8;{1.5 + 0.01 * n};hover" for n in range(200)]
    file = tmp_path / "my log.csv"
    file.write_text("stamp_ms;turn;rollrate;az;theta;note\n" + "\n".join(rows) + "\n")
    page = visit(flying.address())
    page.get_by_role("link", name="Open", exact=True).click()
    page.get_by_label("Choose a file").set_input_files(file)
    form = page.locator("#columns")
    expect(form).to_contain_text("Columns of my log.csv")
    expect(form.get_by_role("row", name="Accelerometer z")).to_contain_text("gravity in m/s^2")
    expect(form.get_by_label("Accelerometer z: direction")).to_have_value("-1")
    expect(form.get_by_label("Time: column")).to_have_value("stamp_ms")
    form.get_by_label("Time: column").select_option("")
    form.get_by_role("button", name="Use this map").click()
    expect(page.locator("#columns-wrong")).to_have_text(re.compile("Choose the time's column"))
    form.get_by_label("Time: column").select_option("stamp_ms")
    form.get_by_label("Gyro x: column").select_option("turn")
    form.get_by_label("Gyro x: unit").select_option("deg/s")
    axe_finds_nothing(page)
    form.get_by_role("button", name="Use this map").click()
    expect(page.locator("#opened-state")).to_contain_text("0.4 s")
    expect(form).to_be_hidden()
    with page.expect_download() as saved:
        page.get_by_role("link", name="Save the column map my log.map.toml").click()
    made = saved.value.path()
    read = open_recording(file, column_map=made).samples
    assert np.degrees(read.gyro[:, 0]).max() == pytest.approx(60.0)
    assert read.accelerometer[:, 2] == pytest.approx(9.8)
    shown = open_recording(flying.sessions / "my log.mcap").samples
    assert np.array_equal(shown.gyro, read.gyro, equal_nan=True)
    assert not (flying.sessions / "opened").exists()


def test_work_that_cannot_be_done_is_refused_in_words_and_a_job_can_be_cancelled(flying, visit):
    shutil.copy(RECORDINGS / FLIGHT, flying.sessions / "another.mcap")
    page = visit(flying.address() + "#flights")
    page.get_by_role("link", name="Flights").click()
    page.get_by_role("button", name="Compare").click()
    expect(page.locator("#said")).to_contain_text("recordings")
    role = page.get_by_label("Role of another.mcap")
    role.select_option("fit")
    role.focus()
    length = page.locator("#recordings tr", has_text="being recorded").get_by_role("cell").nth(3)
    before = length.text_content()
    expect(length).not_to_have_text(before)
    expect(role).to_be_focused()  # the list is updated where it stands
    page.get_by_role("button", name="Find the discrepancy").click()
    job = page.locator("#jobs tr", has_text="another.mcap")
    expect(job).to_contain_text("running")
    job.get_by_role("button", name="Cancel").press("Enter")
    expect(job).to_contain_text("cancelled")
    axe_finds_nothing(page)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_can_be_read_in_both_themes(flying, visit, theme):
    """Contrast of at least 4.5:1 between each text and what lies behind it."""
    page = visit(flying.address(), color_scheme=theme)
    expect(page.locator("#live")).to_have_text("live")
    page.get_by_label("Receive from", exact=True).focus()
    found = json.loads(page.evaluate(CONTRASTS))
    assert len(found) > 30
    poor = [one for one in found if one["ratio"] < 4.5]
    assert not poor


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing_that_keeps_anybody_out(flying, visit, theme):
    """WCAG's rules of levels A and AA and axe's own best practices, on every part."""
    shutil.copy(RECORDINGS / FLIGHT, flying.sessions / f"{theme}.mcap")
    page = visit(flying.address(), color_scheme=theme)
    expect(page.locator("#live")).to_have_text("live")
    for part in ("Now", "Flights", "Open", "Models", "Parameters"):
        page.get_by_role("link", name=part, exact=True).click()
        if part == "Flights":
            expect(page.locator("#recordings")).to_contain_text(f"{theme}.mcap")
        if part == "Open":
            page.get_by_role("button", name="nanobench_trefoil.mcap").click()
            expect(page.locator("#opened-state")).to_contain_text("28.7 s")
        if part == "Models":
            page.get_by_text(NUMBERS).first.click()
        axe_finds_nothing(page)


def axe_finds_nothing(page):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    judged = axe.run(page)
    assert judged.response["passes"]
    assert judged.violations_count == 0, judged.generate_report()


def test_nothing_is_cut_off_on_a_phone(flying, visit):
    page = visit(flying.address(), viewport={"width": 360, "height": 640})
    expect(page.locator("#live")).to_have_text("live")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.get_by_role("link", name="Flights").click()
    page.get_by_role("button", name="Inspect").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    for button in page.locator("#work button").all():
        assert button.bounding_box()["height"] >= 40


DROP = """(name) => {
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File(["no recording"], name));
    document.body.dispatchEvent(
        new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
}"""

CONTRASTS = """() => {
    const light = (color) => {
        const [r, g, b] = color.match(/[\\d.]+/g).slice(0, 3).map((one) => {
            const part = one / 255;
            return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
        });
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const behind = (element) => {
        for (let one = element; one; one = one.parentElement) {
            const color = getComputedStyle(one).backgroundColor;
            if (!/rgba\\(.*, 0\\)/.test(color)) return color;
        }
        return "rgb(255, 255, 255)";
    };
    const found = [];
    for (const one of document.querySelectorAll("body *")) {
        const own = [...one.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
        if (!own || !one.checkVisibility()) continue;
        const [a, b] = [light(getComputedStyle(one).color), light(behind(one))];
        const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        found.push({ id: one.id, text: one.textContent.slice(0, 30), ratio });
    }
    return JSON.stringify(found);
}"""
