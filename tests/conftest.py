"""Settings for every test."""

import os
import signal

# Before numpy is there: its matrices are small here, and more threads spend their time waiting.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import HealthCheck, settings

# Under nohup every program started here would keep on ignoring what the tests send it.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# A deadline measures the machine, not the code, and examples may be slow on a loaded one.
# The same examples every time: some behaviour has stated odds (docs/telemetry.md), and a change
# must not be blamed for the draw.
settings.register_profile(
    "project",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")
