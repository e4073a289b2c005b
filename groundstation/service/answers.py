"""What the control API tells of the daemon, as types: they make the schema that is published."""

from __future__ import annotations

from typing import Literal

import msgspec

from groundstation.service.requests import CraftIdentity, Place
from groundstation.telemetry.decoder import LinkStatistics


class LinkStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The telemetry link. lost: samples, since it was opened. latency_ms: median, of the last
    second. doing: what a simulated craft does, in words; empty for others. pauses: silent, and
    nothing is wrong: it is being prepared, or its battery is changed."""

    name: str
    state: Literal["closed", "opening", "streaming", "silent", "lost", "ended"]
    rate_hz: float
    lost: int
    latency_ms: float | None
    doing: str
    pauses: bool


class RecordingStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The present recording, or the last one. wanted: whether there should be one. dropped: items
    that are not in the file. free_mb: on its disk. text: the last fault. path: the file, for
    programs in another folder."""

    state: Literal["off", "recording", "finished", "failed", "low_space"]
    file: str | None
    path: str | None = None
    bytes: int
    samples: int
    raw_packets: int = 0
    dropped: int
    text: str = ""
    wanted: bool
    rotations: int
    resumed: int
    deleted: int
    free_mb: float | None


class ViewerStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The live view. viewers: connections that look at it. behind_s: age of the oldest that the
    slowest of them has not read; it is sent less often then. urls: how to open it."""

    state: Literal["off", "starting", "serving", "restarting", "failed"]
    sent: int
    dropped: int
    restarts: int
    viewers: int
    behind_s: float
    urls: list[str]


class PageStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The operator's page. url: where browsers that were let in find it."""

    state: Literal["off", "starting", "serving", "restarting"]
    url: str | None
    restarts: int


class Disagreement(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where craft and model part beyond chance. statistic: in standard deviations, limit: from
    which it is told. Times: of the device, s; end_s: None while it lasts."""

    channel: str
    regime: str
    statistic: float
    limit: float
    segment: int
    begin_s: float
    noticed_s: float
    end_s: float | None
    why: str


class TwinStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The live twin. gap: prediction error over noise in the last half second, by channel; None
    where it was not judged. disagreements: those that last. events: told so far. waiting, dropped:
    samples that wait for it, and that it was too slow for. text: why it has failed."""

    state: Literal["learning", "watching", "failed"]
    model: str
    gap: dict[str, float | None]
    disagreements: list[Disagreement]
    events: int
    waiting: int
    dropped: int
    text: str


class Announced(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a client is about to do with the craft, and in how many s."""

    text: str
    in_s: float


class Unproven(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A parameter: its value before the lease that was interrupted, and now, None where the craft
    is not connected. client: who wrote it."""

    former: float
    now: float | None
    client: str


class CommandStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The command link. firmware: whose loops the craft flies, empty where it does not say.
    client: who commands. armed: what the craft last said, None where it does not say. hindrance:
    what, as the craft says, keeps it from flying, or empty. crashed: whether it calls itself that.
    held_level: by the operator. interventions: of the failsafe. out_of_reach: why the craft that is
    heard cannot be stopped from here, or empty. stops: changes with every Stop and Land of an
    operator, and with the daemon. landing: it is being landed. announced: what its client is about
    to do. unproven: parameters that an interrupted lease left on the craft, to be written back.
    stores: it can keep parameters while it is switched off. stored: those that it has, as far as it
    was asked.
    holds_height: it can be landed. place: None for one that measures no velocity over the
    ground."""

    uri: str
    state: Literal["closed", "connecting", "connected", "lost"]
    firmware: Literal["2014", "2.x", ""]
    client: str | None
    armed: bool | None
    hindrance: str
    crashed: bool
    held_level: bool
    setpoints: int
    superseded: int
    refused: int
    interventions: int
    out_of_reach: str
    stops: int
    landing: bool
    announced: Announced | None
    unproven: dict[str, Unproven]
    stores: bool
    stored: dict[str, float]
    craft: CraftIdentity
    holds_height: bool
    place: Place | None


class StreamStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Clients of the live stream, and what all of them were too slow for."""

    clients: int
    dropped: int


class TaskStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A supervised task."""

    state: Literal["running", "waiting", "ended"]
    restarts: int


class HealthStatus(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """healthy, and why not. loop_lag_ms: worst delay of the event loop in a minute; held_up_by: its
    cause, empty below half a second; what the process uses."""

    healthy: bool
    problems: list[str]
    loop_lag_ms: float
    held_up_by: str
    cpu_s: float
    memory_mb: float
    descriptors: int
    threads: int


class Status(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the daemon is doing. vehicle: the profile that recordings name. faults: of the program,
    survived. turned_away: requests beyond the limits. statistics: of the link, None in the first
    second. twin: None without a model."""

    link: LinkStatus
    vehicle: str
    recording: RecordingStatus
    viewer: ViewerStatus
    page: PageStatus
    command: CommandStatus | None
    twin: TwinStatus | None
    stream: StreamStatus
    tasks: dict[str, TaskStatus]
    health: HealthStatus
    faults: int
    turned_away: int
    uptime_s: float
    statistics: LinkStatistics | None
