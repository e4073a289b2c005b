"""A craft that hovers half a metre above where it took off, as it says so itself."""

from groundstation.control.programme import Seen

HOVERS = Seen(
    time_s=0.0,
    x_m=0.0,
    y_m=0.0,
    vx_m_s=0.0,
    vy_m_s=0.0,
    climb_m_s=0.0,
    height_m=0.5,
    heading_rad=0.0,
    roll_deg=0.0,
    pitch_deg=0.0,
    thrust=4.0,
    age_s=0.0,
)
