"""One error tree. A message says what happened, where, and what to do about it."""

from __future__ import annotations


class GroundStationError(Exception):
    """Root of every error this package raises on purpose."""


class BadInputError(GroundStationError, ValueError):
    """A file, option or value that cannot be used as given."""


class RecordingError(GroundStationError):
    """A recording that cannot be read or written."""


class DamagedRecordingError(RecordingError):
    """A recording of which a part is torn or corrupted; what is good can still be read."""


class LinkError(GroundStationError):
    """A link that cannot be opened or that failed."""


class LinkLostError(LinkError):
    """The device went away while the link was open; the link may come back."""


class LinkEndedError(LinkError, EOFError):
    """A finite source (a replay) has delivered everything it has."""


class TakenError(GroundStationError):
    """A socket, port or file that another process holds."""


class NotAuthorisedError(GroundStationError):
    """A client asked for what only the holder of a token may do."""


DISTRIBUTION = "crazyflie-groundstation"
"""What the package index and pip call this program; it is imported as ``groundstation``."""


def install(extra: str) -> str:
    """The command that adds an extra of pyproject.toml, however this program was installed."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"
