"""Settings for every test."""

from hypothesis import HealthCheck, settings

# a deadline measures the machine, not the code, and examples may be slow on a loaded one
settings.register_profile(
    "project", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("project")
