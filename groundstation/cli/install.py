"""``groundstation install udev``: the rule that lets a user without root read the bridge."""

from __future__ import annotations

from pathlib import Path

import typer

from groundstation.cli.install_service import service
from groundstation.errors import GroundStationError

RULE_FILE = Path("/etc/udev/rules.d/70-groundstation.rules")


def add_commands(app: typer.Typer) -> None:
    group = typer.Typer(
        no_args_is_help=True,
        help="Set this machine up for the hardware."
        "\n\nExample: [bold]groundstation install service --print[/bold]",
    )
    group.command("udev")(udev)
    group.command("service")(service)
    app.add_typer(group, name="install")


def udev(
    config: Path | None = typer.Option(None, help="TOML configuration file with a \\[usb] table."),
    show: bool = typer.Option(False, "--print", help="Only print the rule."),
) -> None:
    """Allow users at this machine, and the group plugdev, to read the bridge (needs root).

    Example: [bold]groundstation install udev --print | sudo tee
    /etc/udev/rules.d/70-groundstation.rules[/bold]
    """
    from groundstation.links.usb import parse_ids
    from groundstation.service.config import load_config

    rule = udev_rule(*parse_ids(load_config(config).usb.device))
    if show:
        print(rule, end="")
        return
    try:
        RULE_FILE.write_text(rule)
    except OSError as error:
        raise GroundStationError(
            f"{RULE_FILE}: {error.strerror}; run it as root, or pipe "
            f"'groundstation install udev --print' into 'sudo tee {RULE_FILE}'"
        ) from error
    print(f"wrote {RULE_FILE}; now run 'udevadm control --reload' and plug the device in again")


def udev_rule(vendor_id: int, product_id: int) -> str:
    """The rule of one device. Its file must sort before 73-seat-late.rules, which acts on it."""
    return (
        "# Crazyflie telemetry bridge: for whoever sits at the machine, and for group plugdev\n"
        'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", '
        f'ATTR{{idVendor}}=="{vendor_id:04x}", ATTR{{idProduct}}=="{product_id:04x}", '
        'MODE="0660", GROUP="plugdev", TAG+="uaccess"\n'
    )
