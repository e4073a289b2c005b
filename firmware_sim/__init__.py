"""A software stand-in for a Crazyflie 1.0 and its telemetry firmware."""
