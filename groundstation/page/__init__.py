"""The operator's page: a client of the control API, in a process of its own."""
