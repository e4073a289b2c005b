"""What a stand-in is made of: one typed structure, from Python or from a TOML file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import msgspec

from firmware_sim.releases import BEGINS_ANEW, PROTOCOLS_OF
from groundstation.documents import decode_toml, read_document

DLPF_SETTINGS = (1, 2, 3, 4, 5, 6)
PROTOCOLS = (7, 8, 9, 10, 12)
"""Versions of CRTP that firmware was released with since 2023."""


def _require(owner: Any, limits: dict[str, tuple[float, float]]) -> None:
    """Refuse numbers that are not finite or outside [low, high]; None is left alone."""
    for name, (low, high) in limits.items():
        value = getattr(owner, name)
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None and not (low <= number <= high and math.isfinite(number)):
                raise ValueError(f"{name} is {number}, must be finite and in [{low:g}, {high:g}]")


class Loss(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gilbert-Elliott loss of single radio copies.

    good_loss, bad_loss: probability that a copy is lost in either state.
    to_bad, to_good: probability of changing the state with each copy sent. ``to_bad`` 0 is
        independent loss with ``good_loss``.
    damage: probability that a copy arrives with one bit flipped in spite of the radio's CRC.
    """

    good_loss: float = 0.01
    bad_loss: float = 0.9
    to_bad: float = 0.0
    to_good: float = 0.1
    damage: float = 0.0

    def __post_init__(self) -> None:
        _require(self, dict.fromkeys(self.__struct_fields__, (0.0, 1.0)))


class Sensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The MPU6050 of the faithful plant (biases also in the reduced one).

    dlpf: the chip's DLPF_CFG, 1..6.
    delay_s: total delay instead of the data sheet's, 0.016 being the thesis's 8 samples; None:
        the data sheet's, plus 0.4 ms of bus, plus the wait of 0..2 ms for the loop.
    phase_s: of the sample clock against the loop, None: drawn from the seed.
    clock_ppm: of the sample clock against the loop, None: drawn from the seed.
    warm_up_drift_dps: gyro drift reached after warming up, time constant ``warm_up_s``.
    shake: imbalance felt at 250 rev/s: g in the plane, g along z, deg/s.
    """

    dlpf: int = 1
    delay_s: float | None = None
    phase_s: float | None = None
    clock_ppm: float | None = None
    gyro_bias_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    warm_up_drift_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    warm_up_s: float = 20.0
    accel_bias_g: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shake: tuple[float, float, float] = (0.30, 0.90, 7.0)

    def __post_init__(self) -> None:
        if self.dlpf not in DLPF_SETTINGS:
            raise ValueError(f"dlpf is {self.dlpf}, must be one of {DLPF_SETTINGS}")
        _require(
            self,
            {
                "delay_s": (0.0, 0.05),
                "phase_s": (0.0, 0.002),
                "clock_ppm": (-1e4, 1e4),
                "gyro_bias_dps": (-1e4, 1e4),
                "warm_up_drift_dps": (-1e4, 1e4),
                "warm_up_s": (0.0, 1e6),
                "accel_bias_g": (-100.0, 100.0),
                "shake": (0.0, 1e4),
            },
        )


class Quirks(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Peculiarities of release 2014.01.0, each as flown by default.

    attitude_dt: the angle PIDs integrate with half their period.
    clamp_macro: the clamp macro evaluates a rate PID up to three times.
    lower_limit: only the upper limit of an integral is set, the lower one stays -5000.
    negate: the negative of -32768 stays -32768 on yaw.
    """

    attitude_dt: bool = True
    clamp_macro: bool = True
    lower_limit: bool = True
    negate: bool = True


class StandInSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A stand-in, complete. Every field has a default: a faithful Crazyflie 1.0 in flight.

    plant: ``reduced`` (exactly the base model plus white noise), ``faithful``, or ``model``: a
        fitted one plus white noise and nothing else.
    craft: vehicle profile (``crazyflie1``, ``crazyflie21``, a TOML file), ``thesis``, or the
        path of a fitted model, whose effects then act in the place of the plant's.
    program: a pilot programme by name or TOML file, see ``programme``.
    effects: name -> parameter -> value of what is hidden in the craft, see ``effects``.
    gains: controller parameters by full name, over stock and the vehicle's own.
    copies: transmissions of each packet, 500 us apart.
    bridge_dedup: the bridge forwards one copy of each packet only.
    bridge_packets: what the bridge's queue holds before it overflows.
    device_clock_ppm: how much faster the craft's crystal runs than the host's.
    torque_noise, sensor_noise: scale of the default noise.
    supply_v: a bench supply instead of the cell, None: the cell.
    gate_glitches: scale of what the motor bench's optical gate gets wrong.
    charge: of the first cell, 0..1.
    recharge_s: without power until a fresh cell is in and the craft starts anew.
    land_when_low: the pilot lands on a low battery and the cell is changed.
    altitude_hold: initial ``flightmode.althold``: the pilot holds height under a client. With the
        parameter alone, today's firmware reads thrust as a rate of climb.
    resume_s: a client silent for so long gives the craft back to the pilot.
    firmware: whose loops fly: ``2014`` or ``2.x``; None: the vehicle's.
    protocol: CRTP version of a craft with today's firmware, 7 (2023) to 12 (2026); one of 2014
        speaks its own.
    release: of today's firmware, which then has its thrust curve, its supervisor and its protocol;
        None: the curve that the design of gains reckons with, and the protocol above.
    rotor_speed_deck: today's craft measures its rotor speeds.
    software_build: today's firmware as it is built to run in software: it knows no battery, does
        not say what it is, and repeats a request to arm without doing it.
    height_deck: today's craft has a Z-ranger and takes setpoints of height.
    flow_deck: it has a Flow deck, which measures height and the speed over ground: its Kalman
        filter says attitude, velocity and position, and it takes setpoints of velocity as well.
    range_sticks_s: the range sensor sticks so long after power-on, None: never. range_stuck_m: at
        what it then says, None: what it said before, nothing if it had not said anything.
    cpu_id: the craft's own number, None: made from its name and the seed.
    estimated: the deck's filter says the attitude of a reduced or a fitted plant as well, whose
        angles are otherwise the truth: it is trimmed, and drifts, as a real one does.
    positioned: a positioning system tells today's craft where it is, and it takes them too.
    upside_down: it lies on its back when it is switched on.
    substeps: Runge-Kutta steps per pass.
    truth: keep the log of what really happened.
    """

    plant: Literal["reduced", "faithful", "model"] = "faithful"
    craft: str = "crazyflie1"
    program: str = "excite"
    seed: int = 0
    effects: dict[str, dict[str, float]] = {}
    gains: dict[str, float] = {}
    copies: int = 4
    loss: Loss = Loss()
    bridge_dedup: bool = False
    bridge_packets: int = 64
    device_clock_ppm: float = 8.0
    sensor: Sensor = Sensor()
    quirks: Quirks = Quirks()
    torque_noise: float = 1.0
    sensor_noise: float = 1.0
    supply_v: float | None = None
    gate_glitches: float = 1.0
    charge: float = 1.0
    recharge_s: float = 10.0
    land_when_low: bool = True
    altitude_hold: bool = False
    resume_s: float = 30.0
    firmware: Literal["2014", "2.x"] | None = None
    protocol: int = 10
    release: str | None = None
    rotor_speed_deck: bool = False
    height_deck: bool = False
    flow_deck: bool = False
    range_sticks_s: float | None = None
    range_stuck_m: float | None = None
    cpu_id: int | None = None
    estimated: bool = False
    positioned: bool = False
    software_build: bool = False
    upside_down: bool = False
    substeps: int = 4
    truth: bool = False

    @property
    def knows_height(self) -> bool:
        """Today's craft is told its height and takes setpoints of it."""
        return self.height_deck or self.flow_deck or self.positioned

    @property
    def knows_place(self) -> bool:
        """It knows its velocity over ground as well."""
        return self.flow_deck or self.positioned

    def __post_init__(self) -> None:
        _require(
            self,
            {
                "seed": (0, math.inf),
                "copies": (1, 4),
                "bridge_packets": (1, 1e6),
                "device_clock_ppm": (-1e4, 1e4),
                "torque_noise": (0.0, 1e3),
                "sensor_noise": (0.0, 1e3),
                "supply_v": (1.0, 10.0),
                "gate_glitches": (0.0, 10.0),
                "charge": (0.0, 1.0),
                "recharge_s": (0.0, 1e6),
                "resume_s": (0.0, 1e9),
                "range_sticks_s": (0.0, 1e9),
                "range_stuck_m": (0.0, 100.0),
                "cpu_id": (0, 2**96 - 1),
                "substeps": (1, 1000),
            },
        )
        if self.protocol not in PROTOCOLS:
            raise ValueError(f"protocol is {self.protocol}, must be one of {PROTOCOLS}")
        if self.release is not None and self.release not in PROTOCOLS_OF:
            raise ValueError(f"release is {self.release}, must be one of {', '.join(PROTOCOLS_OF)}")
        for name, value in self.gains.items():
            if not math.isfinite(value):
                raise ValueError(f"gains: {name} is {value}, must be finite")

    @property
    def supervised_as(self) -> int:
        """The protocol that came with this craft's supervisor: that of April 2024, built to run in
        software, already knows of crashes and landings."""
        return max(self.speaks, 8) if self.software_build else self.speaks

    @property
    def speaks(self) -> int:
        """Its version of CRTP."""
        return self.protocol if self.release is None else PROTOCOLS_OF[self.release]

    @property
    def begins_anew(self) -> bool:
        """Its loops begin anew with another kind of setpoint; without a release those of a craft
        with a Flow deck do, as those of the newest."""
        return self.flow_deck if self.release is None else self.release >= BEGINS_ANEW


def load_settings(path: Path) -> StandInSettings:
    """Read settings from a TOML file, or from the [stand_in] table of a daemon's configuration.

    Raises ValueError with the key that is wrong.
    """
    try:
        return parse_settings(read_document(path))
    except (OSError, ValueError) as error:
        raise ValueError(f"stand-in settings {path}: {error}; correct the file") from error


def parse_settings(text: bytes) -> StandInSettings:
    """The same from the content of a file. Raises ValueError."""
    table = decode_toml(text, dict[str, Any])
    return msgspec.convert(table.get("stand_in", table), StandInSettings)
