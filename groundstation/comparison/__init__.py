"""Where model and recordings disagree, beside what noise alone would do. Pure."""
