"""Telling systemd how the daemon does: ready, alive, stopping. Nothing where there is none."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket


def notify(state: str) -> None:
    """Send one state (``READY=1``) to the service manager, if one has started this."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.setblocking(False)  # a manager that is busy must not hold up the telemetry
        manager.connect(address)
        manager.send(state.encode())


async def pat_watchdog() -> None:
    """Say that the event loop runs, twice as often as the watchdog wants; for ever."""
    period_s = int(os.environ.get("WATCHDOG_USEC", "0")) * 1e-6 / 2
    while period_s > 0:
        notify("WATCHDOG=1")
        await asyncio.sleep(period_s)


def unit(program: str, configuration: str | None) -> str:
    """A systemd unit that runs the daemon as a user of its own, with little else in reach."""
    option = f" --config {configuration}" if configuration else ""
    return f"""\
[Unit]
Description=Ground station for the Crazyflie
After=local-fs.target

[Service]
Type=notify
ExecStart={program} run{option}
Restart=on-failure
RestartSec=2
WatchdogSec=20
TimeoutStopSec=40
User=groundstation
Group=groundstation
SupplementaryGroups=plugdev dialout
RuntimeDirectory=groundstation
RuntimeDirectoryMode=0700
StateDirectory=groundstation
StateDirectoryMode=0750
CacheDirectory=groundstation
WorkingDirectory=%S/groundstation
Environment=GROUNDSTATION_SOCKET=%t/groundstation/control.sock
Environment=GROUNDSTATION_LOG_FORMAT=json
Environment=XDG_CACHE_HOME=%C/groundstation
Environment=NUMBA_CACHE_DIR=%C/groundstation
UMask=0077
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
ProtectProc=invisible
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_NETLINK
IPAddressDeny=any
IPAddressAllow=localhost
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM

[Install]
WantedBy=multi-user.target
"""
