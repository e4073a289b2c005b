"""Many flights of many crafts: a catalogue, a fit of each, what changed and who differs."""
