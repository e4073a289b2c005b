"""From a craft to a model of it and better gains: what to fly next, and what came of it."""
