"""The daemon: station, configuration, control API."""
