"""What an operator must not overlook, in words, from the daemon's status; pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

BATTERY_LOW_V, BATTERY_EMPTY_V = 3.3, 3.1
"""Of one lithium-polymer cell that carries the craft: land soon, land now."""
LOSS_MOST_PCT = 2.0
DISK_LOW_MB = 1024.0
VIEW_BEHIND_S = 2.0

Alarm = dict[str, str]
"""level: ``alarm`` (act), ``warning`` (look) or ``busy`` (wait); text; details, where there are."""


def alarms(status: dict[str, Any] | None, fault: str, battery_v: float | None) -> list[Alarm]:
    """The worst first. status: as the control API gives it; fault: why it cannot be asked."""
    if fault:
        return [_alarm(f"The groundstation does not answer: {fault}")]
    found = [] if status is None else list(_found(status, battery_v))
    return sorted(found, key=lambda one: one["level"] != "alarm")


def _found(status: dict[str, Any], battery_v: float | None) -> Iterator[Alarm]:
    for problem in status["health"]["problems"]:
        yield _alarm(problem[:1].upper() + problem[1:])
    command = status["command"]
    if command is not None and command["unproven"]:
        yield _unproven(command)
    link = status["link"]
    streaming = link["state"] == "streaming" and not link["pauses"]
    prepares = link["pauses"] and link["state"] == "opening"
    if prepares:
        yield {"level": "busy", "text": link["doing"][:1].upper() + link["doing"][1:]}
    elif link["pauses"]:
        yield _warning(f"The stand-in pauses: {link['doing']}")
    if streaming and battery_v is not None and battery_v < BATTERY_EMPTY_V:
        yield _alarm(f"Battery empty: {battery_v:.2f} V. Land now")
    elif streaming and battery_v is not None and battery_v < BATTERY_LOW_V:
        yield _warning(f"Battery low: {battery_v:.2f} V. Land soon")
    recording = status["recording"]
    if not recording["wanted"] and not prepares:
        yield _warning("Nothing is being recorded")
    if (
        recording["wanted"]
        and recording["free_mb"] is not None
        and recording["free_mb"] < DISK_LOW_MB
    ):
        yield _warning(f"Disk: {recording['free_mb']:.0f} MB left")
    statistics = status["statistics"]
    if streaming and statistics is not None and statistics["loss_pct"] > LOSS_MOST_PCT:
        yield _warning(f"{statistics['loss_pct']:.0f} % of the rows of the last second are lost")
    viewer = status["viewer"]
    if viewer["behind_s"] > VIEW_BEHIND_S:
        yield _warning(f"A live view is {viewer['behind_s']:.0f} s behind; it is sent less often")
    twin = status["twin"]
    if twin is not None and twin["state"] == "failed":
        yield _warning(f"The twin has failed: {twin['text']}")
    for one in [] if twin is None else twin["disagreements"]:
        yield _warning(f"Craft and model disagree: {one['channel']}, {one['regime']}. {one['why']}")


def _unproven(command: dict[str, Any]) -> Alarm:
    """Parameters of a flight that did not end as its client wanted."""
    back = (
        "are being written back"
        if command["state"] == "connected"
        else "are written back when it is connected"
    )
    names = [
        f"{name}: {'not known' if one['now'] is None else format(one['now'], 'g')},"
        f" before {one['former']:g}"
        for name, one in command["unproven"].items()
    ]
    text = f"Gains of an interrupted flight are on the craft; the former ones {back}"
    return {**_alarm(text), "details": "; ".join(names)}


def _alarm(text: str) -> Alarm:
    return {"level": "alarm", "text": text}


def _warning(text: str) -> Alarm:
    return {"level": "warning", "text": text}
