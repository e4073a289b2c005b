"""A Dask scheduler and its workers, each a process with a folder of its own."""

import os
import sys
from contextlib import contextmanager
from pathlib import Path

from programs import Program


@contextmanager
def dask(log, *words, cwd=None):
    """``dask scheduler`` or ``dask worker`` as a process."""
    command = [Path(sys.executable).with_name("dask"), *map(str, words)]
    places = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # for what a test sends
    with log.open("ab") as file:
        options = {"stdout": file, "stderr": file, "env": places, "cwd": cwd}
        with Program(command, **options) as program:
            yield program


def scheduler(log, port):
    return dask(log, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")


def worker(log, port, folder):
    """One thread, at home in ``folder``."""
    folder.mkdir(exist_ok=True)
    command = ("worker", f"tcp://127.0.0.1:{port}", "--nthreads", 1, "--no-dashboard")
    return dask(log, *command, "--local-directory", folder, cwd=folder)
