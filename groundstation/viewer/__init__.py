"""Streaming to the rerun viewer without ever blocking or growing the daemon."""
