"""groundstation: a hardware-in-the-loop ground station service for the Crazyflie quadrotor."""

__version__ = "0.1.0"
