"""Where model and recordings disagree, which physical effect is missing, and the proof."""
