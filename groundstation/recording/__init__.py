"""Recordings: MCAP, CSV, microSD logs; recovery and quality."""
