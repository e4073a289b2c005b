"""Repair of torn and damaged MCAP files: what is readable goes into a fresh file."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from pathlib import Path

from mcap.records import Channel

from groundstation.errors import BadInputError, RecordingError
from groundstation.paths import taken
from groundstation.recording.catalogue import is_held
from groundstation.recording.mcap_file import McapFile
from groundstation.recording.mcap_scan import McapScan
from groundstation.recording.recording_file import CHANNELS_METADATA

RECOVERY_METADATA = "recovery"


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What a recovery found and did.

    output: the new file; None where the input is sound and nothing was done.
    messages: kept, of all topics.
    chunks_skipped: chunks whose framing was found and whose content was bad.
    bytes_lost: bytes of the input passed over.
    seconds_lost: upper bound of the recording time inside the damaged places, seconds; what
        is missing at a torn end is not in the file and not counted.
    damage: one line for each damaged place.
    """

    path: Path
    sound: bool
    output: Path | None
    messages: int
    chunks_skipped: int = 0
    bytes_lost: int = 0
    seconds_lost: float = 0.0
    damage: list[str] = field(default_factory=list)


def recover(path: Path, output: Path | None = None) -> RecoveryReport:
    """Rewrite what is readable of an MCAP file, of any program, into a fresh file.

    Keeps every topic, definition, attachment and metadata record that can be read, adds a
    metadata record that says what was lost, needs memory for one chunk at a time, and never
    touches its input. A sound file is left alone.

    output: by default ``<stem>.recovered.mcap`` beside the input.

    Raises BadInputError where there is no such file, it is being written, or the output exists;
    RecordingError where nothing can be read or the output cannot be written, and then leaves no
    output behind.
    """
    output = output or path.with_name(f"{path.stem}.recovered.mcap")
    report, profile = _examine(path)
    if report.sound:
        return report
    if is_held(path):
        raise BadInputError(f"{path}: is still being written; stop that recording first")
    if not report.messages:
        raise RecordingError(f"{path}: nothing to recover: no message can be read")
    if output.exists():
        raise BadInputError(taken(output))
    file = McapFile(output, profile=profile)
    try:
        with McapScan(path) as scan:
            _copy(scan, file)
        file.add_metadata(_free_name(scan), _summary(report))
        file.finish()
    except BaseException as error:
        file.abandon()
        with contextlib.suppress(OSError):
            output.unlink()
        if isinstance(error, OSError):
            raise RecordingError(f"{output}: cannot be written: {error.strerror}") from error
        raise
    return replace(report, output=output)


def _examine(path: Path) -> tuple[RecoveryReport, str]:
    """What can be read, and the file's profile."""
    with McapScan(path) as scan:
        messages = sum(1 for _ in scan.messages())
        report = RecoveryReport(
            path=path,
            sound=not scan.damage,
            output=None,
            messages=messages,
            chunks_skipped=sum(damage.chunks for damage in scan.damage),
            bytes_lost=sum(damage.length for damage in scan.damage),
            seconds_lost=sum(after - before for before, after in _lost_spans(scan)) / 1e9,
            damage=[damage.line(scan.start_ns) for damage in scan.damage],
        )
        return report, scan.profile


def _lost_spans(scan: McapScan) -> set[tuple[int, int]]:
    """Log times of the good messages around each place where bytes were passed over."""
    return {
        (damage.before_ns, damage.after_ns)
        for damage in scan.damage
        if damage.length
        and damage.before_ns is not None
        and damage.after_ns is not None
        and damage.before_ns < damage.after_ns
    }


def _copy(scan: McapScan, file: McapFile) -> None:
    """All messages, with the channels and definitions they need, then the metadata."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}

    def register(channel: Channel) -> int:
        schema = scan.schemas.get(channel.schema_id)
        if channel.schema_id not in schemas:
            schemas[channel.schema_id] = (
                file.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            )
        return file.register_channel(
            channel.topic,
            channel.message_encoding,
            schemas[channel.schema_id],
            channel.metadata,
        )

    scan.on_attachment = file.add_attachment
    for channel_id, log_ns, publish_ns, payload in scan.messages():
        if channel_id not in channels:
            channels[channel_id] = register(scan.channels[channel_id])
        file.add_message(channels[channel_id], log_ns, payload, publish_ns)
    for channel_id, channel in scan.channels.items():  # those without a message
        if channel_id not in channels:
            channels[channel_id] = register(channel)
    for name, items in scan.metadata:
        if name != CHANNELS_METADATA:
            file.add_metadata(name, items)
    topics = {str(number): scan.topic(channel_id) for channel_id, number in channels.items()}
    file.add_metadata(CHANNELS_METADATA, topics)


def _free_name(scan: McapScan) -> str:
    """``recovery``, or ``recovery 2`` and so on where the input was a recovery itself."""
    taken = {name for name, _ in scan.metadata}
    name, number = RECOVERY_METADATA, 2
    while name in taken:
        name, number = f"{RECOVERY_METADATA} {number}", number + 1
    return name


def _summary(report: RecoveryReport) -> dict[str, str]:
    places = {f"damage_{n}": line for n, line in enumerate(report.damage, start=1)}
    return {
        "source": report.path.name,
        "messages": str(report.messages),
        "chunks_skipped": str(report.chunks_skipped),
        "bytes_lost": str(report.bytes_lost),
        "seconds_lost": f"{report.seconds_lost:.3f}",
        **places,
    }
