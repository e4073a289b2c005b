"""Controllers, closed loops, step metrics and design (thesis chapter 8 and the firmware)."""
