"""Attitude from inertial sensors, and whether their axes are what they should be. Pure."""
