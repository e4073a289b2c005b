"""The measured channels that a model is held against, in the order of every table and report."""

CHANNELS = (
    "gyro_x",
    "gyro_y",
    "gyro_z",
    "accelerometer_x",
    "accelerometer_y",
    "accelerometer_z",
    "roll",
    "pitch",
    "yaw",
)
