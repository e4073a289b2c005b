"""What a model expects a few rows ahead, from all that was measured until then. Pure."""
