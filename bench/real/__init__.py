"""Real flights: the program's answers beside estimates made apart from it. ``make bench-real``."""
