"""Thin commands over the library and the daemon."""
