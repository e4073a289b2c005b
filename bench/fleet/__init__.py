"""Sealed fleets: what becomes of whom is drawn by seed, told by the installed commands from the
recordings alone, and judged when the seal is opened afterwards."""
