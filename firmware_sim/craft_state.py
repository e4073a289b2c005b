"""What the firmware and the plant know at one moment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from firmware_sim.layout import ROTOR, VELOCITY


@dataclass(frozen=True, slots=True)
class CraftState:
    """What the firmware and the plant know at one moment, for clients and displays.

    time_s: device time since power-on of the first cell. uptime_ms: since the last one, the
    firmware's own clock. angles_deg: the firmware's estimate, pitch nose up. gyro_dps, accel_g: as
    the firmware uses them. motors: 16-bit. commands: what the loops ask for, of thrust, roll, pitch
    and yaw, 16-bit, 0 from the firmware of 2014. position_m, velocity_m_s: the truth; estimate_m,
    estimate_m_s: what the firmware makes of it, in the world of its estimator. range_m: what a
    Z-ranger measures; 0 without one. variances: of position and velocity (m^2, m^2/s^2) by its
    Kalman filter, 0 where that does not run; lost: how often that began anew. supervisor: state of
    ``supervisor``.
    """

    time_s: float
    uptime_ms: int
    powered: bool
    boots: int
    angles_deg: tuple[float, float, float]
    gyro_dps: tuple[float, float, float]
    accel_g: tuple[float, float, float]
    thrust: int
    motors: tuple[int, int, int, int]
    commands: tuple[float, float, float, float]
    battery_v: float
    power_state: int
    armed: bool
    arms_itself: bool
    supervisor: int
    tumbled: bool
    calibrated: bool
    position_m: tuple[float, float, float]
    rotor_rev_s: tuple[float, float, float, float]
    velocity_m_s: tuple[float, float, float]
    estimate_m: tuple[float, float, float]
    estimate_m_s: tuple[float, float, float]
    range_m: float
    variances: tuple[float, float, float, float, float, float]
    lost: int

    @classmethod
    def of(cls, fw: Any, s: Any) -> CraftState:
        """From records of the firmware and of the plant (``layout``)."""
        return cls(
            time_s=float(s["now_ns"]) * 1e-9,
            uptime_ms=uptime_ms(s),
            powered=bool(s["off_ns"] < 0),
            boots=int(s["boots"]),
            angles_deg=_floats(fw["angles"]),
            gyro_dps=_floats(fw["gyro"]),
            accel_g=_floats(fw["accel"]),
            thrust=int(fw["thrust"]),
            motors=tuple(int(m) for m in fw["pwm"]),  # type: ignore[arg-type]  # four
            commands=_floats(fw["commands"]),
            battery_v=float(fw["battery_filter"]),
            power_state=int(fw["power_state"]),
            armed=bool(fw["armed"]),
            arms_itself=bool(fw["arms_itself"]),
            supervisor=int(fw["supervisor"]),
            tumbled=bool(fw["tumbled"]),
            calibrated=bool(fw["bias_found"]),
            position_m=_floats(s["y"][:3]),
            rotor_rev_s=_floats(s["y"][ROTOR : ROTOR + 4]),
            velocity_m_s=_floats(s["y"][VELOCITY : VELOCITY + 3]),
            estimate_m=_floats(fw["place"][:3]),
            estimate_m_s=_floats(fw["place"][3:]),
            range_m=float(fw["range_m"]),
            variances=_floats(fw["place_variance"] * fw["knows_height"]),
            lost=int(fw["kalman_resets"]),
        )

    @property
    def height_m(self) -> float:
        """The firmware's estimate."""
        return self.estimate_m[2]

    def at(self, row: Any, uptime_ms: int) -> CraftState:
        """With what a record of that time has of it, by the firmware's clock."""
        return replace(
            self,
            time_s=float(row["time_ns"]) * 1e-9,
            uptime_ms=uptime_ms,
            angles_deg=_floats(row["angles_deg"]),
            gyro_dps=_floats(row["gyro_dps"]),
            accel_g=_floats(row["accel_g"]),
            thrust=int(row["thrust"]),
            motors=tuple(int(m) for m in row["pwm"]),  # type: ignore[arg-type]  # four
            commands=_floats(row["commands"]),
            battery_v=float(row["battery_v"]),
            power_state=int(row["power_state"]),
            rotor_rev_s=_floats(row["rotor_rev_s"]),
            estimate_m=_floats(row["place"][:3]),
            estimate_m_s=_floats(row["place"][3:]),
            range_m=float(row["range_m"]),
        )


def uptime_ms(s: Any) -> int:
    """The firmware's clock of a plant's record: ms since the last power-on."""
    return int(s["now_ns"] - s["boot_ns"]) // 1_000_000


def _floats(values: Any) -> Any:
    return tuple(float(v) for v in values)
