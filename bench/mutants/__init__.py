"""Faults that the short suite must notice, put in one at a time: ``make mutants``."""
