"""Whether rerun is there: an extra, for it is larger than all the rest."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import sys
from pathlib import Path

from groundstation.errors import BadInputError, GroundStationError, install


def require_rerun(what: str) -> None:
    """Raises BadInputError, which names the extra to install, where rerun is missing.

    what: what needs it, as the sentence's subject.
    """
    if importlib.util.find_spec("rerun") is None:
        raise BadInputError(
            f"{what} needs rerun, an optional part of some 500 MB: {install('viewer')}"
        )


def rerun_program() -> Path:
    """The rerun executable itself (the ``rerun`` script only starts it as another child).

    Raises BadInputError when rerun is not installed, GroundStationError when only its program is
    missing.
    """
    require_rerun("the live view (--viewer off: everything but it)")
    package = importlib.util.find_spec("rerun_cli")
    folder = Path(package.origin).parent if package and package.origin else Path()
    program = Path(os.environ.get("RERUN_CLI_PATH", folder / "rerun"))
    if package is None or not os.access(program, os.X_OK):
        raise GroundStationError(
            f"the rerun program is missing ({program}): pip install --force-reinstall rerun-sdk, "
            "or use --viewer off"
        )
    return program


def rerun_command() -> str:
    """What a user types to start it."""
    script = Path(sys.executable).with_name("rerun")
    on_path = shutil.which("rerun")
    return "rerun" if on_path or not script.exists() else shlex.quote(str(script))
