"""What clients of the control API say and hear, as types: they validate, and make the schema."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from groundstation.service.jobs import Kind

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$")]
Token = Annotated[str, msgspec.Meta(max_length=128)]
Line = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]


class LinkName(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A telemetry link: stand-in, stand-in:MODEL (the id of a model), usb, serial:PORT or
    replay:FILE, the file in the recordings folder."""

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=512)]


class Acquire(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wants to command. client: a name for people, shown in the status and recorded."""

    client: Name


class Holder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Holds the lease."""

    token: Token


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
    a craft that holds a height by itself, with no thrust. made_s: when it was made, by this
    machine's monotonic clock: one that is 0.5 s old is not sent."""

    token: Token
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_dps: float = 0.0
    thrust: int
    height_m: float | None = None
    made_s: float | None = None


class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters to be written, by full name (``pid_rate.roll_kp``)."""

    token: Token
    values: Annotated[dict[str, float], msgspec.Meta(min_length=1, max_length=64)]


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


class Lease(msgspec.Struct, frozen=True, kw_only=True):
    """token: for every request that commands. lease_s, level_s, stop_s: the failsafe's limits.
    uri, state: of the command link. firmware: whose loops the craft flies, 2014 or 2.x; empty where
    it does not say. holds_height: whether it takes a height in the place of thrust."""

    token: str
    lease_s: float
    level_s: float
    stop_s: float
    uri: str
    state: str
    firmware: str
    holds_height: bool


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


class Sent(msgspec.Struct, frozen=True, kw_only=True):
    """time_ns: when the setpoint was handed to the radio. telemetry: None where nothing has
    come yet. hindrance: what, as the craft says, keeps it from flying, or empty. height_m: where it
    is by its own account, None where it is not sure of that."""

    time_ns: int
    telemetry: Telemetry | None
    link_state: str
    hindrance: str = ""
    height_m: float | None = None


class Values(msgspec.Struct, frozen=True, kw_only=True):
    """Parameters of the craft by full name."""

    values: dict[str, float]


class Stopped(msgspec.Struct, frozen=True, kw_only=True):
    """motors: ``stopped`` where the craft's own telemetry says so, else what is known of them."""

    motors: str
    done: bool = True


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """It was done."""

    done: bool = True
