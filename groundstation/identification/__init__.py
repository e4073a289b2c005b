"""Models from recordings: motor, ARX, body. Pure: arrays in, estimates out."""
