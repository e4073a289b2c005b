"""How the live view is shown."""

from __future__ import annotations

import enum


class ViewerMode(enum.StrEnum):
    OFF = "off"
    """No viewer."""
    SERVE = "serve"
    """Serve the live view on this machine, for a browser or a rerun viewer."""
    SPAWN = "spawn"
    """Serve, and open a rerun window."""
