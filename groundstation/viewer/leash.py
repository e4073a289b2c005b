"""``python -m groundstation.viewer.leash PARENT NICENESS PROGRAM ARGUMENT...``

Becomes PROGRAM, at a lower priority, and dies with the process PARENT even when that one is
killed with SIGKILL. (Linux keeps the parent-death signal over exec; doing this between fork and
exec of a threaded program instead can deadlock.)
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main(arguments: list[str]) -> int:
    parent, niceness, *command = arguments
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        print(f"prctl: {os.strerror(ctypes.get_errno())}", file=sys.stderr)
        return 1
    if os.getppid() != int(parent):  # it died before the signal was armed
        return 1
    os.nice(int(niceness))
    try:
        os.execv(command[0], command)
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", file=sys.stderr)
        return 127


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
