"""The control API's types: what clients say and hear."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from groundstation.service.jobs import Kind
from groundstation.telemetry.decoder import LinkStatistics

# What clients of the control API say and hear, as types: they validate, and make the schema.


Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$")]
Token = Annotated[str, msgspec.Meta(max_length=128)]
Line = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]


class LinkName(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A telemetry link: stand-in, stand-in:MODEL (the id of a model), usb, serial:PORT or
    replay:FILE, the file in the recordings folder."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=512)]


class Acquire(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wants to command. client: a name for people, shown in the status and recorded. stops: what
    ``command.stops`` of the status was when a person began the program: refused where the motors
    were stopped, or the craft landed, by the operator since."""

    client: Name
    stops: int | None = None


class Holder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Holds the lease."""

    token: Token


class Release(Holder, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """content: parameters that were written stay; otherwise their former values are written
    back."""

    content: bool = True


class Armed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """on: arm the motors; otherwise disarm them."""

    on: bool


class CommandUri(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the craft takes commands: radio://..., usb://0, or udp://HOST:PORT for the stand-in."""

    uri: Annotated[str, msgspec.Meta(min_length=1, max_length=512)]


class Level(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """on: hold the craft level, whatever attitude its client commands."""

    on: bool


class Setpoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One setpoint, in the signs of the telemetry: roll left side up, pitch nose down, yaw rate
    counter-clockwise from above. thrust: 0..60000, up to 10000 is none. height_m: 0..3, for
    a craft that holds a height by itself, with no thrust. vx_m_s, vy_m_s: forward and left as the
    craft is headed, -2..2, for one that holds its place, with a height and no roll or pitch.
    made_s: when it was made, by this machine's monotonic clock: one that is 0.5 s old is not
    sent."""

    token: Token
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_dps: float = 0.0
    thrust: int
    height_m: float | None = None
    vx_m_s: float | None = None
    vy_m_s: float | None = None
    made_s: float | None = None


class Announcement(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a client is about to do with the craft, for the people near it: "takes off". in_s: how
    long from now, s."""

    token: Token
    text: Line
    in_s: Annotated[float, msgspec.Meta(ge=0.0, le=600.0)]


class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters to be written, by full name (``pid_rate.roll_kp``)."""

    token: Token
    values: Annotated[dict[str, float], msgspec.Meta(min_length=1, max_length=64)]


class StoredNames(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters to be stored or cleared, by full name; none: every gain (``pid_...``)."""

    token: Token
    names: Annotated[list[Line], msgspec.Meta(max_length=64)] = []


class Mark(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A note for the recording."""

    text: Line
    details: Annotated[dict[str, Any], msgspec.Meta(max_length=64)] = {}


File = Annotated[str, msgspec.Meta(min_length=1, max_length=255)]


EffectName = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]{0,63}$")]


class NewJob(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Work on recordings, files of the recordings folder; a design of a controller takes a model
    and none, and learn flies the daemon's craft, ``model`` being the job that it goes on with.
    validate: those that no fit sees. model: the id of a fit that is done, or thesis;
    empty where none is needed. effects: known to be there, fitted along. measured_rotors: fit to
    recorded rotor speeds instead of the motor's model."""

    kind: Kind
    recordings: Annotated[list[File], msgspec.Meta(max_length=64)] = []
    validate: Annotated[list[File], msgspec.Meta(max_length=64)] = []
    model: Annotated[str, msgspec.Meta(max_length=255)] = ""
    effects: Annotated[list[EffectName], msgspec.Meta(max_length=64)] = []
    measured_rotors: bool = False


class EffectEntry(msgspec.Struct, frozen=True, kw_only=True):
    """An effect that a model can have. adds: what it does, in words."""

    name: str
    adds: str


class Watched(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The model that the live twin flies, by its id; empty: none."""

    model: Annotated[str, msgspec.Meta(max_length=255)]


class JobName(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A job, by its id."""

    id: File


class JobLog(msgspec.Struct, frozen=True, kw_only=True):
    """The end of a job's log."""

    text: str


class PageToken(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Of an address that the page was opened with."""

    token: Token


class PageAddress(msgspec.Struct, frozen=True, kw_only=True):
    """Lets one browser in."""

    url: str


class CraftIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """Which craft it is, as far as it says so. vehicle: its profile. firmware: whose loops it
    flies, 2014 or 2.x. id: the craft's own number, hexadecimal. Empty where it does not say."""

    uri: str
    vehicle: str
    firmware: str
    id: str


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """token: for every request that commands. stops: how often the operator has stopped or landed
    a craft, to be given to a later ``acquire`` of the same program. lease_s, level_s, stop_s: the
    failsafe's limits. uri, state: of the command link. firmware: whose loops the craft flies, 2014
    or 2.x; empty where it does not say. holds_height: whether it takes a height in the place of
    thrust. holds_place: whether it takes a velocity in the place of an attitude. software: a
    software craft of this machine."""

    token: str
    stops: int
    lease_s: float
    level_s: float
    stop_s: float
    uri: str
    state: str
    firmware: str
    holds_height: bool
    holds_place: bool
    software: bool
    craft: CraftIdentity


class Telemetry(msgspec.Struct, frozen=True, kw_only=True):
    """The newest sample. age_s: since its packet arrived. timestamp: unwrapped ticks."""

    age_s: float
    timestamp: int
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None
    gyro_dps: list[float | None]
    battery_v: float | None
    motors: list[float | None]


class Place(msgspec.Struct, frozen=True, kw_only=True):
    """Where a craft is by its own account: position and velocity in the world frame of its
    estimator, whose origin is where it was switched on or what its positioning system says. age_s:
    since that came. at_s: when the craft said so, by its own clock; null where nobody knows."""

    x_m: float
    y_m: float
    z_m: float
    vx_m_s: float
    vy_m_s: float
    vz_m_s: float
    age_s: float
    at_s: float | None


class Sent(msgspec.Struct, frozen=True, kw_only=True):
    """time_ns: when the setpoint was handed to the radio. telemetry: None where nothing has
    come yet. hindrance: what, as the craft says, keeps it from flying, or empty. height_m: where it
    is by its own account, None where it is not sure of that. place: None for a craft that measures
    no velocity over the ground."""

    time_ns: int
    telemetry: Telemetry | None
    link_state: str
    hindrance: str = ""
    height_m: float | None = None
    place: Place | None = None


class Values(msgspec.Struct, frozen=True, kw_only=True):
    """Parameters of the craft by full name."""

    values: dict[str, float]


class StoredParameter(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter that the craft can keep while it is switched off: its value now, that of its
    firmware, and the stored one, None where nothing is stored."""

    now: float
    default: float
    stored: float | None


class StoredValues(msgspec.Struct, frozen=True, kw_only=True):
    """All that the craft can keep, by full name."""

    parameters: dict[str, StoredParameter]


class Stopped(msgspec.Struct, frozen=True, kw_only=True):
    """motors: ``stopped``, or ``landed``, where the craft's own telemetry says so, else what is
    known of them. ended: the kinds of jobs that were ended with it."""

    motors: str
    ended: list[str] = []
    done: bool = True


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """It was done."""

    done: bool = True


# What the control API tells of the daemon, as types: they make the schema that is published.


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
