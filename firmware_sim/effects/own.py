"""Effects that the stand-in has no implementation of its own for: it flies their laws.

A user's own, from the file that a flown model names, and listed ones whose file is still missing in
this folder. The law is the only code that the two share.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from firmware_sim.compiled import inner
from firmware_sim.layout import LAW_BODY, LAW_SENSOR, LAW_STATES, RATE, ROTOR, VELOCITY, Record
from groundstation.dynamics.chains import own_chain
from groundstation.dynamics.craft import Acting, Crafts, craft_of_laws
from groundstation.dynamics.effect import Body, Craft, Motor, Reading, to_body
from groundstation.dynamics.registry import COMPILED
from groundstation.dynamics.sensors import resting_sensors

own_motor, own_rotor, own_body, own_sensor = map(own_chain, COMPILED[1:])
MOTOR, ROTORS, BODY, SENSOR = range(1, 5)


def apply_laws(p: Any, effects: Sequence[Acting]) -> None:
    """Put laws into a PARAMETERS record.

    Raises ValueError for an effect that acts where the stand-in cannot fly a law.
    """
    for effect, _ in effects:
        if effect.stage not in COMPILED[1:]:
            raise ValueError(
                f"effect {effect.name}: the stand-in flies laws of {', '.join(COMPILED[1:])} only"
            )
    craft: Crafts = craft_of_laws(effects)
    one = craft[0]
    p["lawful"] = 1
    p["own"], p["own_values"] = one["own"], one["own_values"]
    half = LAW_SENSOR - LAW_BODY
    p["own_initial"][:half] = one["body_initial"][-half:]
    one["gravity"] = p["gravity"]
    p["own_initial"][half:] = resting_sensors(one)[-half:]
    if any(effect.states for effect, _ in effects):
        p["states"] = LAW_STATES


@inner
def _craft(p: Record) -> Any:
    k = p.back_emf
    return Craft(
        p.mass,
        p.gravity,
        (p.inertia[0], p.inertia[1], p.inertia[2]),
        p.thrust,
        p.drag,
        (p.rotor_x[0], p.rotor_x[1], p.rotor_x[2], p.rotor_x[3]),
        (p.rotor_y[0], p.rotor_y[1], p.rotor_y[2], p.rotor_y[3]),
        (p.a0[0], p.a0[1], p.a0[2], p.a0[3]),
        (p.a1[0], p.a1[1], p.a1[2], p.a1[3]),
        (p.a2[0], p.a2[1], p.a2[2], p.a2[3]),
        p.winding_ohm,
        (k, k, k, k),
    )


@inner
def _body(y: Any, dy: Any, thrust: float, angular: Any, force: Any) -> Any:
    turned = (y[6], y[7], y[8], y[9])
    speed = to_body(turned, (y[VELOCITY], y[VELOCITY + 1], y[VELOCITY + 2]))
    return Body(
        y[2],
        turned,
        speed,
        (y[RATE], y[RATE + 1], y[RATE + 2]),
        (y[ROTOR], y[ROTOR + 1], y[ROTOR + 2], y[ROTOR + 3]),
        (dy[ROTOR], dy[ROTOR + 1], dy[ROTOR + 2], dy[ROTOR + 3]),
        thrust,
        angular,
        force,
    )


@inner
def lawful_motor(p: Record, rotor: int, armature: float, speed: float, slope: float) -> float:
    """dn/dt of a motor with the laws of its stage."""
    if p.own[MOTOR] == 0:
        return slope
    motor = Motor(p.a0[rotor], p.a1[rotor], p.a2[rotor], armature, speed)
    found: float = own_motor(
        p.own[MOTOR], p.own_values, _craft(p), motor, slope, p.own_initial, p.own_initial, 0
    )
    return found


@inner
def lawful_rotors(p: Record, y: Any, dy: Any, wrench: Any) -> Any:
    """Thrust (N) and torques (N m) of all rotors with the laws of their stage."""
    if p.own[ROTORS] == 0:
        return wrench
    zero = (0.0, 0.0, 0.0)
    body = _body(y, dy, wrench[0], zero, zero)
    return own_rotor(p.own[ROTORS], p.own_values, _craft(p), body, wrench, y, dy, 0)


@inner
def lawful_body(p: Record, y: Any, dy: Any, thrust: float, angular: Any, force: Any) -> Any:
    """Angular acceleration (rad/s^2) and specific force (m/s^2) with the laws of the body."""
    if p.own[BODY] == 0:
        return angular, force
    body = _body(y, dy, thrust, angular, force)
    return own_body(p.own[BODY], p.own_values, _craft(p), body, (angular, force), y, dy, LAW_BODY)


@inner
def lawful_reading(p: Record, y: Any, dy: Any, force: Any, gyro: Any, felt: Any) -> Any:
    """(gyro, accelerometer) with the laws of the sensors; fills the slopes of their states."""
    if p.own[SENSOR] == 0:
        return gyro, felt
    angular = (dy[RATE], dy[RATE + 1], dy[RATE + 2])
    body = _body(y, dy, 0.0, angular, force)
    reading = Reading(gyro, felt, body.rotor)
    shown = own_sensor(p.own[SENSOR], p.own_values, _craft(p), body, reading, y, dy, LAW_SENSOR)
    return shown.gyro, shown.accelerometer
