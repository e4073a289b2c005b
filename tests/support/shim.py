"""A library that is loaded before the C library: steps the wall clock, and logs what is synced.

Stepping the machine's own clock would disturb everything else on it, and pulling its plug even
more so. Needs a C compiler.
"""

from __future__ import annotations

import shutil
import struct
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.programs import run_program

SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static int (*real_gettime)(clockid_t, struct timespec *);
static int (*real_sync)(int);

static long long offset_s(void) {
    long long value = 0;
    const char *path = getenv("SHIM_OFFSET");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file >= 0) {
        if (read(file, &value, sizeof value) != sizeof value) value = 0;
        close(file);
    }
    return value;
}

int clock_gettime(clockid_t which, struct timespec *now) {
    if (!real_gettime) real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real_gettime(which, now);
    if (result == 0 && which == CLOCK_REALTIME) now->tv_sec += offset_s();
    return result;
}

int fdatasync(int number) {
    if (!real_sync) real_sync = dlsym(RTLD_NEXT, "fdatasync");
    struct stat before;
    int known = fstat(number, &before) == 0;
    int result = real_sync(number);
    const char *path = getenv("SHIM_SYNCS");
    if (path && known && result == 0) {
        struct timespec now;
        if (!real_gettime) real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
        real_gettime(CLOCK_REALTIME, &now);
        FILE *log = fopen(path, "a");
        fprintf(log, "%lld %lld %lld\n", (long long)before.st_ino, (long long)before.st_size,
                now.tv_sec * 1000000000LL + now.tv_nsec);
        fclose(log);
    }
    return result;
}
"""


@dataclass
class Shim:
    """environment: for the program that is to be deceived."""

    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        return {
            "LD_PRELOAD": str(self.folder / "shim.so"),
            "SHIM_OFFSET": str(self.folder / "offset"),
            "SHIM_SYNCS": str(self.folder / "syncs"),
        }

    def step_clock(self, seconds: int) -> None:
        """From now on the wall clock is so far from the real one."""
        (self.folder / "offset").write_bytes(struct.pack("q", seconds))

    def syncs(self, inode: int) -> list[tuple[int, int]]:
        """(size, Unix ns) of each sync of a file that has come back."""
        rows = [map(int, line.split()) for line in (self.folder / "syncs").read_text().splitlines()]
        return [(size, time_ns) for number, size, time_ns in rows if number == inode]


def build(folder: Path) -> Shim:
    """Compile it, or skip the test where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("stepping a clock needs a C compiler")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "shim.c").write_text(SOURCE)
    run_program(
        [compiler, "-shared", "-fPIC", "-O1", "-o", folder / "shim.so", folder / "shim.c", "-ldl"],
        check=True,
    )
    return Shim(folder)
