"""``groundstation install service``: the systemd unit of the daemon."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import typer

from groundstation import GroundStationError

UNIT_FILE = Path("/etc/systemd/system/groundstation.service")


def service(
    config: Path | None = typer.Option(None, help="TOML configuration file the daemon is to use."),
    show: bool = typer.Option(False, "--print", help="Only print the unit."),
) -> None:
    """Let systemd run the daemon, as the user groundstation, restarted and watched (needs root).

    Example: [bold]groundstation install service --print[/bold]
    """
    from groundstation.service.config import ConfigSource, unit

    if config is not None:
        ConfigSource(config).load()  # a wrong file is told now, not at the next boot
    program = shlex.quote(str(Path(sys.argv[0]).absolute()))
    text = unit(program, None if config is None else shlex.quote(str(config.absolute())))
    if show:
        print(text, end="")
        return
    try:
        UNIT_FILE.write_text(text)
    except OSError as error:
        raise GroundStationError(
            f"{UNIT_FILE}: {error.strerror}; run it as root, or pipe "
            f"'groundstation install service --print' into 'sudo tee {UNIT_FILE}'"
        ) from error
    print(
        f"wrote {UNIT_FILE}; now: useradd --system --groups plugdev,dialout groundstation; "
        "systemctl daemon-reload; systemctl enable --now groundstation"
    )
