from copy import deepcopy

from groundstation.page.app import alarms

GOOD = {
    "link": {"state": "streaming", "pauses": False, "doing": ""},
    "health": {"problems": []},
    "recording": {"wanted": True, "free_mb": 50_000.0},
    "statistics": {"loss_pct": 0.1},
    "viewer": {"behind_s": 0.0},
    "twin": None,
    "command": None,
}


def changed(**tables):
    status = deepcopy(GOOD)
    for name, values in tables.items():
        status[name] = values if status[name] is None else {**status[name], **values}
    return status


def told(status, fault="", battery_v=3.9):
    return [(one["level"], one["text"]) for one in alarms(status, fault, battery_v)]


def test_when_all_is_well_there_is_nothing_to_say():
    assert told(GOOD) == []
    assert told(None) == []  # nothing has been asked yet
    assert told(GOOD, battery_v=None) == []


def test_a_daemon_that_does_not_answer_is_all_there_is_to_say():
    assert told(GOOD, fault="stuck") == [("alarm", "The groundstation does not answer: stuck")]


def test_the_battery_is_told_before_it_is_empty_and_only_of_a_craft_that_is_there():
    assert told(GOOD, battery_v=3.29) == [("warning", "Battery low: 3.29 V. Land soon")]
    assert told(GOOD, battery_v=3.05) == [("alarm", "Battery empty: 3.05 V. Land now")]
    ended = changed(link={"state": "ended"})
    assert told(ended, battery_v=3.05) == []


def test_a_battery_that_is_changed_is_no_fault():
    resting = changed(link={"state": "silent", "pauses": True, "doing": "back in 7 s"})
    assert told(resting, battery_v=3.0) == [("warning", "The stand-in pauses: back in 7 s")]


def test_a_simulator_that_is_being_prepared_is_waited_for_and_alarms_nobody():
    words = "preparing the simulator, first start only"
    opening = changed(
        link={"state": "opening", "pauses": True, "doing": words}, recording={"wanted": False}
    )
    assert told(opening) == [("busy", "Preparing the simulator, first start only")]


def test_a_live_view_that_is_behind_is_told():
    said = "A live view is 12 s behind; it is sent less often"
    assert told(changed(viewer={"behind_s": 12.2})) == [("warning", said)]


def test_gains_that_no_flight_has_proven_are_named_until_the_former_ones_are_back():
    left = {
        "pid_rate.roll_kp": {"former": 250.0, "now": 180.5, "client": "learn"},
        "pid_rate.roll_kd": {"former": 2.5, "now": None, "client": "learn"},
    }
    status = changed(command={"state": "connected", "unproven": left})
    (alarm,) = alarms(status, "", 3.9)
    assert alarm["level"] == "alarm"
    assert alarm["text"] == (
        "Gains of an interrupted flight are on the craft; the former ones are being written back"
    )
    assert alarm["details"] == (
        "pid_rate.roll_kp: 180.5, before 250; pid_rate.roll_kd: not known, before 2.5"
    )
    away = changed(command={"state": "lost", "unproven": left})
    assert told(away)[0][1].endswith("the former ones are written back when it is connected")
    assert told(changed(command={"state": "connected", "unproven": {}})) == []


def test_the_worst_comes_first():
    status = changed(
        recording={"wanted": True, "free_mb": 100.0},
        statistics={"loss_pct": 12.0},
        health={"problems": ["link usb: lost"]},
        twin={"state": "watching", "disagreements": [
            {"channel": "gyro x", "regime": "hover", "why": "a bias"}]},
    )  # fmt: skip
    assert told(status) == [
        ("alarm", "Link usb: lost"),
        ("warning", "Disk: 100 MB left"),
        ("warning", "12 % of the rows of the last second are lost"),
        ("warning", "Craft and model disagree: gyro x, hover. a bias"),
    ]


def test_what_is_not_recorded_on_purpose_is_told_too():
    assert told(changed(recording={"wanted": False})) == [("warning", "Nothing is being recorded")]
