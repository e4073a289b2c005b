"""Land and Stop in a real browser: where they are, what they do, and what stands beside them."""

import contextlib
import re
import threading
import time

import pytest

from groundstation.errors import GroundStationError
from groundstation.service.client import Pilot, ask
from support.page_requests import expect
from support.programs import free_port
from support.waiting import until

HEIGHT_M = 1.0
COUNTDOWN_S = 15


@pytest.fixture
def standing(page_daemon, tmp_path):
    """standing(*arguments): a daemon with a page, and a craft that stands and holds its height."""

    def start(*arguments):
        (tmp_path / "waiting.toml").write_text(
            "[stand_in]\ncraft = 'crazyflie21'\nprogram = 'wait'\nflow_deck = true\n"
            "[failsafe]\nlevel_s = 0.45\nstop_s = 1.6\n"
        )
        daemon = page_daemon("--config", "waiting.toml", *arguments)
        daemon.recording()
        return daemon

    return start


@pytest.fixture
def resting(standing):
    """The same, with a command link."""
    return standing("--command", f"udp://127.0.0.1:{free_port()}")


class Flight:
    """A program that hovers until it may no longer; why not."""

    def __init__(self, daemon):
        self.why = ""
        self._thread = threading.Thread(target=self._fly, args=(daemon.socket,), daemon=True)
        self._thread.start()

    def _fly(self, socket):
        try:
            with Pilot(socket, "a program") as pilot:
                pilot.setpoint(0.0, 0.0, 0.0, 0)  # unlocks the thrust of today's firmware
                while True:
                    pilot.setpoint(0.0, 0.0, 0.0, height_m=HEIGHT_M)
                    time.sleep(0.02)
        except GroundStationError as error:
            self.why = str(error)

    def ended(self):
        self._thread.join(60)
        return self.why


SIZES = {
    "upright": [(320, 568), (360, 640), (360, 780), (375, 667), (390, 844), (768, 1024)],
    "sideways": [(568, 320), (640, 320), (640, 360), (740, 360), (844, 390), (1024, 400)],
    "desktop": [(1280, 720), (1440, 900)],
}


@pytest.mark.parametrize("sizes", SIZES.values(), ids=SIZES)
def test_land_and_stop_can_be_pressed_on_every_screen_whatever_else_is_shown(flying, visit, sizes):
    page = visit(flying.address())
    expect(page.locator("#live")).to_have_text("live")
    for width, height in sizes:
        page.set_viewport_size({"width": width, "height": height})
        places = set()
        for part in page.locator("nav a[href^='#']").all():
            part.click()
            found = page.evaluate(PRESSABLE)
            assert len(found) == 8
            for one in found:
                assert one["inside"], (width, height, one)
                assert one["topmost"], (width, height, one)
                places.add((one["id"], *one["box"]))
        assert len(places) == 2  # they never move
        assert page.evaluate("document.documentElement.scrollWidth") <= width


PRESSABLE = """async () => {
    const { showAlarms } = await import("/alarms.js");
    const { showAnnounced } = await import("/announced.js");
    const { confirmed, closeOpen } = await import("/change.js");
    const found = [];
    const look = (what) => {
        for (const id of ["land", "stop"]) {
            const one = document.getElementById(id), box = one.getBoundingClientRect();
            const points = [[0.5, 0.5], [0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]];
            found.push({
                what, id, box: [box.x, box.y, box.width, box.height],
                inside: box.x >= 0 && box.y >= 0 && box.right <= innerWidth
                    && box.bottom <= innerHeight && box.width >= 60 && box.height >= 44,
                topmost: points.every(([x, y]) => one.contains(
                    document.elementFromPoint(box.x + x * box.width, box.y + y * box.height))),
            });
        }
    };
    look("nothing else");
    const details = "pid_rate.roll_kp: 180, before 250; ".repeat(20);
    const alarm = (_, number) => ({ level: "alarm", text: `A thing ${number}`, details });
    showAlarms(Array.from({ length: 5 }, alarm));
    for (const one of document.querySelectorAll("details.why, details.chooser")) one.open = true;
    scrollBy(0, 300);
    look("alarms, menus");
    const text = "a program with a long name takes off for flight 2";
    showAnnounced({ announced: { text, in_s: 9 } });
    look("an announcement");
    confirmed("A question?", "word ".repeat(120), "Do it");
    look("a question");
    closeOpen();
    return found;
}"""


TEXTS = """() => {
    const banner = document.getElementById("announced");
    window.texts = []; // all that is announced
    new MutationObserver(() => window.texts.push(banner.textContent))
        .observe(banner, { childList: true });
}"""

NOTHING_GROWS_OLD = """() => {
    const later = window.setTimeout;
    window.setTimeout = (work, ms) => (ms === 30000 ? 0 : later(work, ms));
}"""


def test_land_lands_whoever_flies_and_what_is_said_of_it_is_gone_before_it_is_old(resting, visit):
    page = visit(resting.address())
    land = page.get_by_role("button", name="Land")
    land.click()
    expect(page.locator("#stopped")).to_contain_text("motors stood within")  # it did not fly
    flight = Flight(resting)
    expect(page.locator("#place")).to_contain_text(re.compile(r"(0\.9|1\.0)\d m"))
    page.evaluate(TEXTS)
    land.click()
    expect(page.locator("#stopped")).to_have_text(
        re.compile(r"^Land pressed at \S+: landed within \d+\.\d s\.$")
    )
    assert flight.ended()
    expect(page.locator("#motors")).to_have_text("off")
    expect(page.locator("#announcement")).to_be_hidden()
    assert "Landing. Stop cuts the motors." in page.evaluate("window.texts")
    assert resting.status()["command"]["client"] is None
    expect(page.locator("#stopped")).to_have_text("")  # after half a minute
    page.evaluate(NOTHING_GROWS_OLD)
    page.get_by_role("button", name="Stop motors").click()
    expect(page.locator("#stopped")).to_contain_text("motors stood within")
    with Pilot(resting.socket, "another program"):
        expect(page.locator("#stopped")).to_have_text("")  # something new has begun


def test_escape_closes_what_is_open_and_stops_motors_only_where_nothing_is(resting, visit):
    page = visit(resting.address())
    expect(page.locator("#land")).to_be_enabled()
    flight = Flight(resting)
    expect(page.locator("#motors")).to_contain_text("running")
    expect(page.locator("#level")).to_be_enabled()
    page.keyboard.press("l")
    expect(page.locator("#level")).to_have_attribute("aria-pressed", "true")
    question = page.get_by_role("dialog")
    page.get_by_role("button", name="Disarm…").click()
    page.keyboard.press("Escape")
    expect(question).to_be_hidden()
    expect(page.locator("#said")).to_have_text("Closed. Esc again stops the motors.")
    expect(page.get_by_role("button", name="Disarm…")).to_be_focused()
    channels = page.locator("#view-tools summary")
    channels.click()
    page.get_by_role("searchbox", name="Find a channel").press("Escape")
    expect(page.locator("#view-tools .choices")).to_be_hidden()
    expect(channels).to_be_focused()
    channels.click()
    page.locator("#plots-title").click()
    expect(page.locator("#view-tools .choices")).to_be_hidden()
    expect(page.locator("#stopped")).to_have_text("")
    assert resting.status()["command"]["client"] == "a program"
    page.get_by_label("Mark this moment").focus()
    page.keyboard.press("Escape")  # wherever the cursor is
    expect(page.locator("#stopped")).to_have_text(
        re.compile(r"^Stop pressed at \S+: motors stood within \d\.\d s\.$")
    )
    expect(page.locator("#motors")).to_have_text("off")
    expect(page.locator("#events")).to_contain_text("motors stopped")
    assert flight.ended()


def test_a_craft_is_connected_and_stopped_while_the_page_asks_something(standing, visit):
    daemon = standing()
    page = visit(daemon.address())
    expect(page.locator("#stop-why")).to_have_text("Stop unavailable: connect to the craft first.")
    page.evaluate(NOTHING_GROWS_OLD)
    page.keyboard.press("Escape")
    expect(page.locator("#stopped")).to_contain_text("not done (the daemon has no command link")
    page.get_by_label("Command the craft at").fill(f"udp://127.0.0.1:{free_port()}")
    page.get_by_role("button", name="Connect").click()
    expect(page.locator("#stop-why")).to_have_text("Stops immediately, whoever is flying.")
    expect(page.locator("#stopped")).to_have_text("")  # it is so no more
    expect(page.locator("#armed")).to_have_text("yes")  # as the craft says: this one arms itself
    expect(page.get_by_role("button", name="Arm…", exact=True)).to_be_disabled()
    flight = Flight(daemon)
    expect(page.locator("#motors")).to_contain_text("running")
    page.get_by_role("button", name="Disarm…").click()
    page.get_by_role("button", name="Stop motors").click()
    expect(page.locator("#motors")).to_have_text("off")
    assert flight.ended()
    question = page.get_by_role("dialog")
    expect(question).to_be_visible()
    question.get_by_role("button", name="Disarm the motors").click()
    expect(question).to_be_hidden()
    expect(page.locator("#said")).to_contain_text("has armed itself again")


@contextlib.contextmanager
def kept(daemon, pilot):
    """Its lease is kept meanwhile, however long a browser takes for a step."""
    over = threading.Event()

    def keep():
        while not over.wait(0.5):
            ask(daemon.socket, "POST", "/command/keep", {"token": pilot.lease["token"]})

    keeper = threading.Thread(target=keep)
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join()


def test_a_take_off_is_counted_down_beside_stop_with_a_sound_each_second(resting, visit):
    page = visit(resting.address())
    expect(page.locator("#live")).to_have_text("live")
    expect(page.locator("#sound")).to_have_text("off: click the page once")
    page.evaluate("""() => {
        const start = OscillatorNode.prototype.start;
        window.sounds = []; // what is shown with each
        OscillatorNode.prototype.start = function () {
            window.sounds.push(document.getElementById("announced").textContent);
            start.call(this);
        };
    }""")
    banner = page.locator("footer").get_by_role("alert")
    with Pilot(resting.socket, "learn") as pilot, kept(resting, pilot):
        pilot.announce("learn takes off", COUNTDOWN_S)
        expect(banner).to_have_text(re.compile(r"^learn takes off in 1?\d s$"))
        expect(page.locator("#announced-sound")).to_have_text("Sound is off: click the page once.")
        assert page.evaluate("window.sounds") == []
        page.locator("#plots-title").click()
        expect(page.locator("#sound")).to_have_text("on")
        expect(page.locator("#announced-sound")).to_have_text("")
        until(lambda: banner.text_content() == "learn takes off", "the countdown is over")
        *counted, last = page.evaluate("window.sounds")
        seconds = [int(re.fullmatch(r"learn takes off in (\d+) s", one)[1]) for one in counted]
        assert len(seconds) > 3
        assert seconds == sorted(set(seconds), reverse=True)  # one a second
        assert last == "learn takes off"
    expect(page.locator("#announcement")).to_be_hidden()


def test_stop_says_that_it_has_ended_learn_too(resting, visit):
    page = visit(resting.address())
    expect(page.locator("#land")).to_be_enabled()
    page.get_by_role("link", name="Flights").click()
    page.get_by_role("button", name="Learn this craft…").click()
    page.get_by_role("dialog").get_by_role("button", name="Fly and learn").click()
    expect(page.locator("#jobs tr")).to_contain_text("running")
    page.keyboard.press("Escape")
    expect(page.locator("#stopped")).to_contain_text("Stop also ended learn.")
    expect(page.locator("#jobs tr")).to_contain_text("cancelled")
