"""Flights as rerun shows them: entities, clocks, layouts, and files of them."""
