"""Named effects: what a craft has and the base model has not. Pure."""
