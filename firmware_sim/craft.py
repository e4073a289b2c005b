"""The stand-in: a craft, its firmware, its radio and the bridge, advanced as one."""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.layout import (
    ACCEL_DLPF,
    LAW_BODY,
    PASS_NS,
    PILOT_PASSES,
    POSITION,
    QUATERNION,
    ROTOR,
    ROWS,
    STATE,
    TRUTH,
    VELOCITY,
)
from firmware_sim.settings import StandInSettings
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.telemetry.packet import Packets, encode

__all__ = ["CraftState", "StandIn", "StandInSettings"]

CHUNK_PASSES = 5000
"""At most 10 s of flight per call of the kernel: bounds the memory of a long advance."""
HISTORY_PASSES = 1000
"""The last 2 s, for whoever logs."""

HOLDS_THRUST = 32767.0
"""What neither climbs nor sinks, with ``flightmode.althold``; 0 sinks with 1 m/s."""
HEIGHT_DECK, FLOW_DECK = "deck.bcZRanger2", "deck.bcFlow2"
"""What the firmware says of them can only be read. A Flow deck has the Z-ranger's sensor too."""
CPU_ID = ("cpu.id0", "cpu.id1", "cpu.id2")
"""The craft's own number, 32 bits each, the lowest first."""
ESTIMATOR, CONTROLLER = "stabilizer.estimator", "stabilizer.controller"
CHOSEN = (ESTIMATOR, CONTROLLER)
"""By which today's firmware chooses who flies: kept and said, and change nothing."""
COMPLEMENTARY, KALMAN, PID = 1.0, 2.0, 1.0
DEVICES = {"brushless": "Crazyflie 2.1 Brushless"}
"""Vehicle -> the name the firmware gives; a 2.1 and a 2.1+ call themselves alike."""


class StandIn:
    """A craft that flies its programme, or what a client commands, and is heard by a bridge.

    Thread-safe: a worker may advance it while a server reads its state and commands it.

    stored: what its EEPROM holds of parameters, by full name; loaded whenever it is switched on.
    """

    def __init__(
        self, settings: StandInSettings | None = None, stored: dict[str, float] | None = None
    ) -> None:
        from firmware_sim.bridge import Bridge
        from firmware_sim.flight import fly
        from firmware_sim.physics import (
            added_by_plant,
            craft_of,
            firmware,
            firmware_of,
            hover_thrust,
            parameters,
            set_in,
            value_in,
        )
        from firmware_sim.programme import Sticks, load_programme
        from firmware_sim.radio import transmit

        self.settings = settings or StandInSettings()
        self.stored = {} if stored is None else stored
        self._lock = threading.Lock()
        self._parameters = parameters(self.settings)
        self._fresh_firmware = firmware(self.settings)
        self._firmware = self._fresh_firmware.copy()
        vehicle, _ = craft_of(self.settings)
        self._vehicle = vehicle
        self._unlocked = False
        self.profile = vehicle.name if vehicle.name in BUILT_IN else None
        """The vehicle it is made of, where that has a name."""
        self.added_by_plant = added_by_plant(self.settings)
        """What flies beside a fitted model, in a line; empty where nothing does."""
        self.device = DEVICES.get(vehicle.name, "Crazyflie 2.1")
        """What today's craft calls itself."""
        is_today = firmware_of(self.settings, vehicle) == "2.x"
        self.protocol = self.settings.speaks if is_today else 1
        """Version of CRTP."""
        self.cpu_id = own_number(self.settings)
        """The craft's own number, of 96 bits."""
        self._hover = hover_thrust(self.settings)
        self._state = np.zeros(1, STATE)
        self._sticks = Sticks(load_programme(self.settings.program), self.settings.seed)
        self._fly, self._transmit = fly, transmit
        self._value_in, self._set_in = value_in, set_in
        self._bridge = Bridge(self.settings.bridge_packets, self.settings.bridge_dedup)
        self._air = np.zeros(1, np.int64)
        loss = self.settings.loss
        self._loss = np.array(
            [loss.good_loss, loss.bad_loss, loss.to_bad, loss.to_good, loss.damage]
        )
        self._truth: list[NDArray[np.void]] = []
        self._history = np.zeros(0, ROWS)
        self._power_on(first=True)

    def advance(self, until_s: float) -> tuple[Packets, NDArray[np.float64]]:
        """Fly every pass that is due by ``until_s`` of host time since power-on.

        Returns the packets (n, 32) that have reached the host since the last call, and the
        time (s) at which each did. The same for a seed however the time is sliced.
        """
        with self._lock:
            scale = 1.0 + self.settings.device_clock_ppm * 1e-6
            target_ns = int(until_s * 1e9 * scale)
            out = []
            while True:
                passes = (target_ns - self._now_ns) // PASS_NS + 1
                if passes <= 0:
                    break
                rows = self._fly_passes(min(passes, CHUNK_PASSES))
                flown = min(until_s, self._now_ns / 1e9 / scale)
                out.append(self._deliver(rows, int(flown * 1e9), scale))
            out.append(self._deliver(np.zeros(0, ROWS), int(until_s * 1e9), scale))
        packets = np.concatenate([part for part, _ in out])
        return packets, np.concatenate([times for _, times in out]) * 1e-9

    def state(self) -> CraftState:
        """The live state."""
        with self._lock:
            return CraftState.of(self._firmware[0], self._state[0])

    def logged(self, uptime_ms: int) -> CraftState:
        """What a log block read at that time of the firmware's clock: the values after the last
        pass until then, of the last two seconds; the position is the present one."""
        now = self.state()
        with self._lock:
            row = self._row_at(uptime_ms)
        return now if row is None else now.at(row, uptime_ms)

    def command(self, roll_deg: float, pitch_deg: float, yaw_dps: float, thrust: int) -> None:
        """A client's setpoint, as the firmware takes it: pitch nose up, yaw rate clockwise.

        With ``flightmode.althold`` set the pilot of ``altitude_hold`` holds the height while thrust
        is given; without him today's firmware reads thrust as a rate of climb, zero as 1 m/s
        downwards. It takes no other thrust before a client that was silent has sent zero once.
        """
        from firmware_sim.commander import STOP_NS

        with self._lock:
            fw, now = self._firmware[0], self._now_ns
            today = bool(fw["today"])
            if thrust == 0:
                self._unlocked = True
            elif now - fw["setpoint_ns"] > STOP_NS or fw["client_ns"] < 0:
                self._unlocked = False
            climbs = fw["altitude_hold"] > 0 and not fw["pilot_holds"]
            fw["holds_climb"] = climbs
            fw["setpoint_climb"] = (thrust - HOLDS_THRUST) / HOLDS_THRUST
            if today and not self._unlocked:
                thrust = 0
            fw["setpoint"] = roll_deg, pitch_deg, yaw_dps
            held = fw["altitude_hold"] > 0 and fw["client_ns"] >= 0 and fw["thrust"] > 0
            if climbs:
                fw["setpoint_thrust"] = fw["thrust"]  # until the next pass of its loop
            elif not held or (thrust <= 10000 and not today):
                fw["setpoint_thrust"] = float(thrust)
            fw["holds_height"] = fw["holds_speed"] = 0
            fw["setpoint_ns"] = fw["client_ns"] = now

    def command_height(
        self, roll_deg: float, pitch_deg: float, yaw_dps: float, height_m: float
    ) -> None:
        """The same with a height in the place of thrust, which today's firmware then finds itself;
        one that does not know its height does not fly."""
        with self._lock:
            self._firmware[0]["setpoint"] = roll_deg, pitch_deg, yaw_dps
            self._hold(height_m)

    def command_hover(self, vx_m_s: float, vy_m_s: float, yaw_dps: float, height_m: float) -> None:
        """The same with a velocity in the place of angles: forward and to the left of the heading,
        as the firmware's estimator knows it. Yaw rate clockwise."""
        with self._lock:
            fw = self._firmware[0]
            fw["setpoint"][2], fw["setpoint_speed"] = yaw_dps, (vx_m_s, vy_m_s)
            self._hold(height_m, speed=True)

    def command_stop(self) -> None:
        """A client's setpoint of nothing: the motors stop, whatever was asked for before."""
        with self._lock:
            fw = self._firmware[0]
            fw["setpoint"] = fw["setpoint_thrust"] = 0.0
            fw["holds_height"] = fw["holds_climb"] = fw["holds_speed"] = 0
            fw["setpoint_ns"] = fw["client_ns"] = self._now_ns

    def _hold(self, height_m: float, speed: bool = False) -> None:
        fw = self._firmware[0]
        fw["holds_height"], fw["setpoint_height"] = fw["knows_height"], height_m
        fw["holds_speed"], fw["holds_climb"] = speed, 0
        fw["setpoint_ns"] = fw["client_ns"] = self._now_ns

    def arm(self, armed: bool) -> bool:
        """Arm the motors, or disarm them; whether it was done. Brushed craft arm themselves again
        as soon as their checks are passed."""
        from firmware_sim.supervisor import PASSED

        with self._lock:
            fw = self._firmware[0]
            if armed and not fw["armed"] and fw["supervisor"] != PASSED:
                return False
            fw["armed"] = armed
            return True

    def recover(self) -> bool:
        """What a crashed craft that was set upright again is asked; whether it has not crashed."""
        from firmware_sim.supervisor import CRASHED, NOT_PASSED

        with self._lock:
            fw = self._firmware[0]
            if fw["supervisor"] == CRASHED and not fw["tumbled"]:
                fw["supervisor"] = NOT_PASSED
            return bool(fw["supervisor"] != CRASHED)

    def emergency_stop(self) -> None:
        """Today's firmware stops its motors until it is switched off and on."""
        with self._lock:
            self._firmware[0]["stopped"] = self._firmware[0]["today"]

    def get_parameter(self, name: str) -> float:
        """A firmware parameter by full name (``pid_rate.roll_kp``)."""
        if name == HEIGHT_DECK:
            return float(self.settings.height_deck or self.settings.flow_deck)
        if name == FLOW_DECK:
            return float(self.settings.flow_deck)
        if name in CPU_ID:
            return float(self.cpu_id >> 32 * CPU_ID.index(name) & 0xFFFFFFFF)
        if name in CHOSEN:
            return self._chosen[name]
        with self._lock:
            return self._value_in(self._firmware[0], name)

    def default_of(self, name: str) -> float:
        """A parameter's value without anything stored or set."""
        if name in CHOSEN:
            knows = KALMAN if self.settings.knows_height else COMPLEMENTARY
            return knows if name == ESTIMATOR else PID
        return self._value_in(self._fresh_firmware[0], name)

    def set_parameter(self, name: str, value: float) -> None:
        """Write a firmware parameter; lost at the next restart unless it is stored."""
        if name in CHOSEN:
            self._chosen[name] = float(value)
            return
        with self._lock:
            self._set_in(self._firmware[0], name, value)

    @property
    def time_s(self) -> float:
        """Device time since the first power-on."""
        return self._now_ns * 1e-9

    @property
    def uptime_ms(self) -> int:
        """The firmware's clock: ms since the last power-on."""
        return uptime_ms(self._state[0])

    @property
    def boots(self) -> int:
        """How often it was switched on."""
        return int(self._state[0]["boots"])

    @property
    def powered(self) -> bool:
        """Whether its cell still feeds it."""
        return bool(self._state[0]["off_ns"] < 0)

    @property
    def overflows(self) -> int:
        """Packets dropped because the bridge's queue was full."""
        return self._bridge.overflows

    def truth(self) -> NDArray[np.void]:
        """What really happened, one TRUTH record per pass with power, if it was asked for."""
        with self._lock:
            return np.concatenate(self._truth) if self._truth else np.zeros(0, TRUTH)

    @property
    def _now_ns(self) -> int:
        return int(self._state[0]["now_ns"])

    def _fly_passes(self, passes: int) -> NDArray[np.void]:
        """Fly some passes; a restart in between is one of them."""
        s = self._state[0]
        first = (int(s["now_ns"]) - int(s["boot_ns"])) // PASS_NS // PILOT_PASSES
        programme = self._sticks.rows(first, passes // PILOT_PASSES + 2)
        rows = np.zeros(passes, ROWS)
        truth = np.zeros(passes if self.settings.truth else 0, TRUTH)
        flown, written = self._fly(
            self._parameters[0],
            self._firmware[0],
            s,
            programme,
            first,
            self._hover,
            passes,
            rows,
            truth,
        )
        if len(truth):
            self._truth.append(truth[:written])
        if flown < passes:
            self._power_on(first=False)
        kept = rows[:written][-HISTORY_PASSES:]
        before = self._history[max(0, len(self._history) + len(kept) - HISTORY_PASSES) :]
        self._history = np.concatenate([before, kept])
        return rows[:written]

    def _row_at(self, uptime_ms: int) -> Any:
        """The last row of this power-on until then; None before the first that is kept."""
        boot_ns = int(self._state[0]["boot_ns"])
        at = int(
            np.searchsorted(self._history["time_ns"], boot_ns + uptime_ms * 1_000_000, "right")
        )
        row = self._history[at - 1] if at > 0 else None
        return row if row is not None and row["boot_ns"] == boot_ns else None

    def _deliver(
        self, rows: NDArray[np.void], until_ns: int, scale: float
    ) -> tuple[Packets, NDArray[np.int64]]:
        copies = self.settings.copies
        row = np.empty(len(rows) * copies, np.int64)
        heard, bit = np.empty_like(row), np.empty_like(row)
        count = self._transmit(
            rows["time_ns"].copy(),
            copies,
            self._loss,
            self._air,
            self._state[0]["rng"],
            row,
            heard,
            bit,
        )
        packets = _packets(rows)[row[:count]]
        damaged = np.flatnonzero(bit[:count] >= 0)
        packets[damaged, bit[damaged] >> 3] ^= (1 << (bit[damaged] & 7)).astype(np.uint8)
        host_ns = (heard[:count] / scale).astype(np.int64)
        return self._bridge.pass_on(packets, host_ns, until_ns)

    def _power_on(self, first: bool) -> None:
        """A charged cell is plugged in and the craft stands on the ground."""
        from firmware_sim.battery import open_circuit_mv
        from firmware_sim.plant import GROUND_PULSATION
        from firmware_sim.random_numbers import seeded

        s, p = self._state[0], self._parameters[0]
        self._firmware[:] = self._fresh_firmware
        for name, value in list(self.stored.items()):
            self._set_in(self._firmware[0], name, value)
        self._chosen = {name: self.default_of(name) for name in CHOSEN}
        self._unlocked = False
        if first:
            s["rng"] = seeded(self.settings.seed, len(s["rng"]))
            s["charge"] = self.settings.charge
        else:
            s["charge"] = 1.0
        s["boots"] += 1
        now = s["now_ns"]
        s["y"] = 0.0
        s["y"][POSITION + 2] = -p["gravity"] / GROUND_PULSATION**2
        s["y"][QUATERNION + self.settings.upside_down] = 1.0
        s["y"][ACCEL_DLPF + 2] = -p["gravity"] if self.settings.upside_down else p["gravity"]
        s["y"][LAW_BODY:] = p["own_initial"]
        s["boot_ns"], s["off_ns"], s["overload_ns"] = now, -1, 0
        s["landing"], s["landed_ns"] = 0, now
        s["pilot_height"] = s["pilot_integral"] = 0.0
        s["mode"], s["duty"], s["filter"] = 0.0, 0.0, 0.0
        phase = np.random.default_rng((self.settings.seed, 2, int(s["boots"])))
        s["timer_phase"] = phase.integers(0, 1 << 16)
        fw = self._firmware[0]
        fw["low_ns"] = fw["critical_ns"] = fw["setpoint_ns"] = now
        s["supply_mv"] = s["reported_mv"] = p["stiff_mv"] or open_circuit_mv(float(s["charge"]))


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
        same = ("angles_deg", "gyro_dps", "accel_g", "commands", "rotor_rev_s")
        return replace(
            self,
            **{name: _floats(row[name]) for name in same},
            time_s=float(row["time_ns"]) * 1e-9,
            uptime_ms=uptime_ms,
            thrust=int(row["thrust"]),
            motors=tuple(int(m) for m in row["pwm"]),  # type: ignore[arg-type]  # four
            battery_v=float(row["battery_v"]),
            power_state=int(row["power_state"]),
            estimate_m=_floats(row["place"][:3]),
            estimate_m_s=_floats(row["place"][3:]),
            range_m=float(row["range_m"]),
        )


def uptime_ms(s: Any) -> int:
    """The firmware's clock of a plant's record: ms since the last power-on."""
    return int(s["now_ns"] - s["boot_ns"]) // 1_000_000


def _floats(values: Any) -> Any:
    return tuple(float(v) for v in values)


def own_number(settings: StandInSettings) -> int:
    """A craft's own number, 96 bits: another for another craft or seed."""
    if settings.cpu_id is not None:
        return settings.cpu_id
    digest = hashlib.sha256(f"{Path(settings.craft).name} {settings.seed}".encode()).digest()
    return int.from_bytes(digest[:12], "little")


def _packets(rows: NDArray[np.void]) -> Packets:
    if len(rows) == 0:
        return np.empty((0, 32), np.uint8)
    names: Any = ("battery", "motors", "gyro", "accelerometer", "angles", "debug")
    return encode(rows["ticks"], *(rows[name] for name in names))
