"""``groundstation install``: the daemon's systemd unit, and rules that let a user without root read
bridge and radio."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import typer

from groundstation import GroundStationError
from groundstation.cli.terminal import Commands

UNIT_FILE = Path("/etc/systemd/system/groundstation.service")
RULE_FILE = Path("/etc/udev/rules.d/70-groundstation.rules")


def add_commands(app: typer.Typer) -> None:
    group = Commands(
        no_args_is_help=True,
        help="Set this machine up for the hardware."
        "\n\nExample: [bold]groundstation install service --print[/bold]",
    )
    group.command("udev")(udev)
    group.command("service")(service)
    app.add_typer(group, name="install")


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
    then = (
        "; now: useradd --system --groups plugdev,dialout groundstation; "
        "systemctl daemon-reload; systemctl enable --now groundstation"
    )
    _install("service", UNIT_FILE, text, show, then)


def udev(
    config: Path | None = typer.Option(None, help="TOML configuration file with a \\[usb] table."),
    show: bool = typer.Option(False, "--print", help="Only print the rule."),
) -> None:
    """Allow users at this machine, and the group plugdev, to use the bridge, a Crazyradio and a
    Crazyflie's cable (needs root).

    Example: [bold]groundstation install udev --print | sudo tee
    /etc/udev/rules.d/70-groundstation.rules[/bold]
    """
    from groundstation.links.usb import parse_ids
    from groundstation.service.config import load_config

    rule = udev_rule(*parse_ids(load_config(config).usb.device))
    then = "; now run 'udevadm control --reload' and plug the device in again"
    _install("udev", RULE_FILE, rule, show, then)


def _install(what: str, path: Path, text: str, show: bool, then: str) -> None:
    """Write a file of the system, or only show it (show). then: what is to be done next."""
    if show:
        print(text, end="")
        return
    try:
        path.write_text(text)
    except OSError as error:
        raise GroundStationError(
            f"{path}: {error.strerror}; run it as root, or pipe "
            f"'groundstation install {what} --print' into 'sudo tee {path}'"
        ) from error
    print(f"wrote {path}{then}")


CRAZYFLIE = ((0x1915, 0x7777), (0x35F0, 0xBAD2), (0x0483, 0x5740))
"""Crazyradio, Crazyradio 2, a Crazyflie's own cable."""


def udev_rule(vendor_id: int, product_id: int) -> str:
    """The rules of the bridge and of what a stock Crazyflie needs. The file must sort before
    73-seat-late.rules, which acts on it."""
    lines = [
        'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", '
        f'ATTR{{idVendor}}=="{vendor:04x}", ATTR{{idProduct}}=="{product:04x}", '
        'MODE="0660", GROUP="plugdev", TAG+="uaccess"'
        for vendor, product in ((vendor_id, product_id), *CRAZYFLIE)
    ]
    head = "# Telemetry bridge, Crazyradio, Crazyflie: for whoever sits at the machine, and plugdev"
    return "\n".join([head, *lines, ""])
