"""Sources of telemetry behind one asynchronous interface."""
