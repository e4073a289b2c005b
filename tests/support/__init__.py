"""What tests of several folders share: CONTRIBUTING.md says which helper is for what."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
RECORDINGS = ROOT / "recordings"
"""Flights that come with the project."""
