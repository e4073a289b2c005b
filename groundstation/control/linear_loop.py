"""Loops of a model with PID gains: linear, the thesis's whole loop, and what both achieve."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.control.firmware_loop import (
    STEP_RAD,
    Plant,
    Worth,
    all_worth,
    cascade_loop,
    hold_response,
    integral_ratios,
    motors_of_model,
    plant_of_model,
    rate_per_pwm,
    require_gains,
    step_response,
)
from groundstation.control.firmwares import FULL, RELEASE_2014, PidGains
from groundstation.control.metrics import (
    MARGINS,
    LoopResponse,
    Margins,
    StepMetrics,
    step_metrics,
)
from groundstation.dynamics.model import THESIS, ArxAxis, Model, angle_polynomial, stacked
from groundstation.dynamics.sensors import delay_of_model
from groundstation.dynamics.vehicle import PWM_FULL
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import SAMPLE_PERIOD_S

# The direct loop: a PID whose output is u' itself, on a linear model of one axis.
#
# This is the loop on which the thesis's printed gains act (u' in (rev/s)^2 per rad); it has no
# motors, no battery and no limits. The other loops are in ``thesis_loop`` and ``firmware_loop``.


GRID = 1500
"""Frequencies of a loop's response, logarithmic from 0.05 rad/s up to half the sampling rate."""
SEARCH_GRID = 240
LONGEST_DELAY = 200


def axis_plant(model: Model, axis: str, delay: int | None = None) -> ArxAxis:
    """The linear model of an axis from u' in (rev/s)^2 to its angle in rad.

    The model's ARX polynomials where it has them (those of rates integrated), otherwise its grey
    box, a double integrator c / s^2 under a held input (thesis eq. 7.12-7.14) with the dead time in
    whole samples. u' of a row of fitted polynomials acted before the row, what a loop sets at it
    acts after it: one row more.
    delay: samples instead of the model's own.

    Raises BadInputError for an unknown axis or a delay that is not 0..200 samples.
    """
    if axis not in AXES:
        raise BadInputError(f"axis {axis!r}: there are {', '.join(AXES)}")
    if model.arx is not None and axis in model.arx:
        plant = angle_polynomial(model, axis)
        plant = msgspec.structs.replace(plant, nk=plant.nk + (1 if "arx" in model.fit else 0))
    elif model.body is not None:
        ts = SAMPLE_PERIOD_S
        b = msgspec.structs.astuple(model.body)[AXES.index(axis)] * ts * ts / 2
        nk = 1 + round(delay_of_model(model) / ts)
        plant = ArxAxis(2, 2, nk, (-2.0, 1.0), (b, b), ts)
    else:
        raise BadInputError(f"the model has no {axis} axis: fit a body or an ARX model of it")
    nk = plant.nk if delay is None else delay
    if not 0 <= nk <= LONGEST_DELAY:
        raise BadInputError(f"delay of {nk} samples: must be 0..{LONGEST_DELAY}")
    return ArxAxis(plant.na, plant.nb, nk, plant.a, plant.b, plant.ts)


def run_direct(plant: ArxAxis, gains: PidGains, reference: ArrayLike) -> Array:
    """The angle (k,) in rad of an axis that follows a reference (k,) in rad in the closed loop."""
    from groundstation.control.kernels import direct_run

    wanted = np.ascontiguousarray(reference, np.float64)
    y, u = np.empty_like(wanted), np.empty_like(wanted)
    a, b, pid = np.array(plant.a), np.array(plant.b), np.array(gains.as_tuple())
    direct_run(a, b, plant.nk, pid, plant.ts, wanted, y, u)
    return y


def step_direct(plant: ArxAxis, gains: PidGains, seconds: float = 1.0) -> Array:
    """The answer to a unit step over a window."""
    return run_direct(plant, gains, np.ones(round(seconds / plant.ts)))


def is_stable(plant: ArxAxis, gains: PidGains, delay: int | None = None) -> bool:
    """Whether every pole of the closed loop lies inside the unit circle (Jury's test)."""
    from groundstation.control.kernels import characteristic, inside_unit_circle

    nk = plant.nk if delay is None else delay
    polynomial = np.empty(nk + plant.na + plant.nb + 4)
    a, b, pid = np.array(plant.a), np.array(plant.b), np.array(gains.as_tuple())
    return bool(inside_unit_circle(polynomial, characteristic(a, b, nk, pid, plant.ts, polynomial)))


def most_delay(plant: ArxAxis, gains: PidGains) -> int | None:
    """The largest delay in samples up to which the loop is stable; None if it never is."""
    stable = None
    for delay in range(LONGEST_DELAY + 1):
        if not is_stable(plant, gains, delay):
            break
        stable = delay
    return stable


def direct_loop(plant: ArxAxis, gains: PidGains) -> LoopResponse:
    """The loop broken at the plant's input; its margins mean something where it is stable."""
    omega = grid(plant.ts)
    z = np.exp(1j * omega * plant.ts)
    return LoopResponse(omega, frequency_response(plant, z) * controller(gains, z, plant.ts))


def controller(
    gains: PidGains, z: NDArray[np.complex128], period_s: float
) -> NDArray[np.complex128]:
    """The thesis's PID at points z of the unit circle."""
    kp, ki, kd = gains.as_tuple()
    return kp + ki * period_s / (z - 1) + kd / period_s * (1 - 1 / z)


def grid(period_s: float, points: int = GRID) -> Array:
    """Frequencies in rad/s, logarithmic, up to half the sampling rate."""
    return np.geomspace(0.05, math.pi / period_s, points)


def frequency_response(plant: ArxAxis, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The plant at points z of the unit circle."""
    import control

    numerator, denominator = np.zeros((2, plant.nk + max(plant.na, plant.nb - 1) + 1))
    numerator[plant.nk : plant.nk + plant.nb] = plant.b
    denominator[: plant.na + 1] = (1.0, *plant.a)
    system = control.tf(numerator, denominator, plant.ts)
    return np.asarray(system(z), np.complex128)


class DirectJudge:
    """Judges many gains at once on a plant: RMS error, overshoot (%), settling (s), steady-state
    error, maximum sensitivity, effort, and how far a push moves the craft, which is not judged on
    this loop: zero. What is unstable, or would be with ``spare_s`` more delay, is infinite.
    """

    def __init__(self, plant: ArxAxis, seconds: float, spare_s: float = 0.0) -> None:
        self._plant = plant
        self._reference = np.ones(round(seconds / plant.ts))
        self._spare = math.ceil(spare_s / plant.ts - 1e-9)
        self._z = np.exp(1j * grid(plant.ts, SEARCH_GRID) * plant.ts)
        self._response = frequency_response(plant, self._z)

    def __call__(self, candidates: Array, worth: Worth = all_worth) -> Array:
        """Gains (m, 3) kp, ki, kd to judgements (m, 7): of all, for they cost next to nothing."""
        from groundstation.control.kernels import judge_many

        plant, found = self._plant, np.zeros((len(candidates), 7))
        judge_many(
            np.array(plant.a),
            np.array(plant.b),
            plant.nk,
            self._spare,
            self._response,
            self._z,
            np.ascontiguousarray(candidates),
            plant.ts,
            self._reference,
            found,
        )
        found[:, 2] = np.where(np.isnan(found[:, 2]), np.inf, found[:, 2])
        found[:, 3] = np.abs(found[:, 3])
        return found


# What the thesis prints of its controllers: gains (Tables 8.1-8.4), results (8.5-8.7).
#
# ``python -m groundstation.control.linear_loop`` prints both beside what the printed gains
# give, as JSON.


GAINS: dict[str, dict[str, PidGains]] = {
    name: {"roll": PidGains(*tilt), "pitch": PidGains(*tilt), "yaw": PidGains(*yaw)}
    for name, tilt, yaw in (
        ("P", (149000.0,), (44100.0,)),
        ("PI", (226000.0, 166000.0), (79500.0, 6980.0)),
        ("PD", (1530000.0, 0.0, 10200.0), (121000.0, 0.0, 35900.0)),
        ("PID", (1050000.0, 1930000.0, 3760.0), (30500.0, 1560.0, 3730.0)),
    )
}
"""Controller -> axis -> gains on u' in (rev/s)^2."""

RESULTS: dict[str, dict[str, tuple[float, float, float]]] = {
    name: {"roll": tilt, "pitch": tilt, "yaw": yaw}
    for name, tilt, yaw in (
        ("P", (0.5648, 50.0, 0.3), (0.3131, 40.0, 2.0)),
        ("PI", (0.3292, 100.0, 0.4), (0.2987, 60.0, 2.5)),
        ("PD", (0.1506, 40.0, 0.1), (0.1340, 1.0, 0.3)),
        ("PID", (0.1769, 70.0, 0.2), (0.2736, 5.0, 1.5)),
    )
}
"""Controller -> axis -> printed RMS error, overshoot in percent, settling time in s."""

DELAYS = (2, 8)
ROUNDED_YAW = "yaw, pole at 1"
YAW_A1 = -1.9949
"""Printed as -1.995: with it and a2 as printed, 1 + a1 + a2 is 0, so yaw integrates."""
ROUNDED_ROLL = "roll, a1 = -1.9585"
ROLL_A1 = -1.9585
"""Printed as -1.959: the least unstable roll that the digits allow."""
WINDOW_S = {"roll": 1.0, "pitch": 1.0, "yaw": 3.0, ROUNDED_ROLL: 0.5}
"""Not printed; over these the figures come closest."""

FINDING = (
    "The printed gains act on u' itself. On roll, with the printed delay of 8 samples P barely"
    " holds and PI, PD and PID diverge; with 2 they come close to the printed figures: with"
    " a1 = -1.9585, which is printed as -1.959, over 0.5 s all RMS errors within 15 % (overshoots"
    " of PI, PD and PID within 10 points, P's is twice the printed). No digits that round to the"
    " printed ones bear 4 or more. 8 x 0.5 ms, one radio copy each, would"
    " be 2 rows. Yaw as printed has an unstable pole that its P and PID gains cannot hold, but the"
    " digits leave that open: with a1 = -1.9949, which is printed as -1.995, yaw integrates and"
    " its RMS errors follow within 14 % at 2 samples and 7 % at 8: yaw cannot tell the delay."
)


def printed_cases(delays: tuple[int, ...] = DELAYS, model: Model = THESIS) -> list[dict[str, Any]]:
    """Every printed controller on the printed models, and on roll and yaw as the rounding of their
    digits allows, at each delay (samples), beside what is printed."""
    cases = []
    for label in (*AXES, ROUNDED_ROLL, ROUNDED_YAW):
        axis = label.split(",")[0]
        for name in GAINS:
            gains, keys = GAINS[name][axis], ("rms", "overshoot_pct", "settling_s")
            for delay in delays:
                plant = printed_plant(label, delay, model)
                step = step_metrics(step_direct(plant, gains, window_s(label)), plant.ts)
                cases.append(
                    {
                        "axis": label,
                        "controller": name,
                        "delay_samples": delay,
                        "stable": is_stable(plant, gains),
                        "most_delay_samples": most_delay(plant, gains),
                        **step.as_dict(),
                        "printed": dict(zip(keys, RESULTS[name][axis], strict=True)),
                    }
                )
    return cases


def window_s(label: str) -> float:
    """Over how long the step of a case is judged."""
    return WINDOW_S.get(label, WINDOW_S[label.split(",")[0]])


def printed_plant(label: str, delay: int, model: Model = THESIS) -> ArxAxis:
    """The printed model of an axis, or of one within its rounding, with a delay in samples."""
    plant = axis_plant(model, label.split(",")[0], delay)
    rounded = {ROUNDED_ROLL: ROLL_A1, ROUNDED_YAW: YAW_A1}
    if label not in rounded:
        return plant
    return ArxAxis(plant.na, plant.nb, plant.nk, (rounded[label], *plant.a[1:]), plant.b, plant.ts)


if __name__ == "__main__":
    print(json.dumps(printed_cases(), indent=2))


# The thesis's whole simulation (Figure 8.10): its controllers with everything between them and
# the angles.
#
# Reference, PIDs, their saturation at +-4096 PWM counts, power distribution (8.3), output stage
# with the battery (8.2.6), four motors (3.82), mixer (7.19), body, measurement delay. Gains are
# PWM counts per rad here. The printed gains are not: they act on u' in (rev/s)^2, on the loop of
# ``linear_loop``; a saturation at +-4096 does not go with them.


SUPPLY_MV = 3700.0
SAME_PERIOD = 0.01
"""Share by which two periods may differ and be one."""


@dataclass(frozen=True, slots=True)
class WholeResponse:
    """angles (k, 3) rad as the controller hears them, controls (k, 3) and pwm (k, 4) in counts."""

    angles: Array
    controls: Array
    pwm: Array


def run_whole(
    model: Model,
    gains: Sequence[PidGains],
    reference: ArrayLike,
    *,
    delay: int | None = None,
    supply_mv: ArrayLike = SUPPLY_MV,
) -> WholeResponse:
    """Follow a reference (k, 3) in rad, one row per 2 ms, from a level hover.

    The model's polynomials turn the craft where it has them in the loop's period, otherwise its
    rigid body with its effects. gains: for roll, pitch, yaw. delay: samples of measurement delay;
    by default what the model says (the polynomials' nk, or its dead time).

    Raises BadInputError for a model without a body, or with polynomials of some axes only.
    """
    from groundstation.control.kernels import whole_run

    if model.arx is not None and any(axis not in model.arx for axis in AXES):
        raise BadInputError("the model has no ARX polynomials for roll, pitch and yaw")
    model = _of_the_loop(model)
    plant = motors_and_body(model)
    a, b, nk = np.zeros((3, 1)), np.zeros((3, 1)), np.zeros(3, np.int64)
    if model.arx is not None:
        a, b, nk = stacked([angle_polynomial(model, axis) for axis in AXES])
        nk = np.maximum(nk, 1) if delay is None else np.full(3, delay)  # speeds act after a row
    wanted = np.ascontiguousarray(reference, np.float64)
    rows = len(wanted)
    # new arrays: numba compiles the kernel anew, half a minute, for one that is read-only
    supply = np.full(rows, supply_mv, np.float64)
    lift = np.array(plant.hover_duty(supply) * PWM_FULL)
    angles, controls, pwm = np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros((rows, 4))
    whole_run(
        plant.craft[0],
        plant.mixer,
        plant.start,
        a,
        b,
        nk,
        model.arx is not None,
        np.array([one.as_tuple() for one in gains]),
        lift,
        supply,
        wanted,
        SAMPLE_PERIOD_S,
        _late(plant, delay),
        angles,
        controls,
        pwm,
    )
    return WholeResponse(angles, controls, pwm)


def _late(plant: Plant, delay: int | None) -> int:
    """Samples of measurement delay: ``delay``, or the model's own."""
    return round(float(plant.sensor[0]["delay"]) / SAMPLE_PERIOD_S) if delay is None else delay


def counts_per_control(model: Model, supply_mv: float = SUPPLY_MV) -> Array:
    """PWM counts that change u' by 1 (rev/s)^2 at hover once the motors have settled, (3,).

    Turns gains of the direct loop into gains of the whole simulation.
    """
    hover, pole = hover_and_pole(model)
    slope = model.motor.a0 * supply_mv / PWM_FULL / pole
    return 1.0 / (2 * hover * slope * np.array([2.0, 2.0, 4.0]))


def hover_and_pole(model: Model) -> tuple[float, float]:
    """Rotor speed that carries the craft (rev/s), and the motors' pole around it (1/s)."""
    hover, motor = motors_and_body(model).hover_rev_s, model.motor
    return hover, motor.a1 + 2 * motor.a2 * hover


def whole_loop(
    model: Model,
    gains: PidGains,
    axis: str,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
) -> LoopResponse:
    """One axis, linear around hover and broken at the controller's output; its margins mean
    something where it is stable.

    The rigid body with its model's damping and rotor torques; of polynomials, the settled motors'
    slope and their lag before them.
    """
    omega = grid(SAMPLE_PERIOD_S)
    z = np.exp(1j * omega * SAMPLE_PERIOD_S)
    s, model = 1j * omega, _of_the_loop(model)
    if model.arx is None:
        # its controller's output is PWM
        plant = replace(motors_and_body(model), firmware=RELEASE_2014)
        late = np.exp(-_late(plant, delay) * SAMPLE_PERIOD_S * s)
        index = AXES.index(axis)
        rate = rate_per_pwm(plant, plant.slopes(index), index, s, supply_mv)
        angle = FULL / PWM_FULL * rate / s * (hold_response(s, SAMPLE_PERIOD_S) * late)
    else:
        polynomials, (_, pole) = axis_plant(model, axis, delay), hover_and_pole(model)
        motor = pole / (s + pole) / counts_per_control(model, supply_mv)[AXES.index(axis)]
        angle = frequency_response(polynomials, np.exp(s * polynomials.ts)) * motor
    return LoopResponse(omega, angle * controller(gains, z, SAMPLE_PERIOD_S))


def motors_and_body(model: Model) -> Plant:
    """What the loop flies beside polynomials: the motors, and the body where the model has one."""
    if model.body is None:
        return motors_of_model(model)
    return plant_of_model(model, fusion=False)


def _of_the_loop(model: Model) -> Model:
    """The model with its polynomials only where they step as the loop does, every 2 ms.

    Raises BadInputError where it has others and no body.
    """
    steps = {one.ts for one in (model.arx or {}).values()}
    if all(abs(ts / SAMPLE_PERIOD_S - 1.0) <= SAME_PERIOD for ts in steps):
        return model
    if model.body is None:
        raise BadInputError(
            f"the ARX polynomials make a step every {1e3 * max(steps):g} ms, the loop every"
            f" {1e3 * SAMPLE_PERIOD_S:g} ms, and the model has no body: --loop direct takes them"
        )
    return msgspec.structs.replace(model, arx=None)


# Gains from one loop's form to another's.
#
# direct: u' in (rev/s)^2 per rad. whole: PWM counts (4096 full) per rad. Between them stand the
# motors around hover, as they are once settled. firmware: that of 2014, whose cascade is, for a
# setpoint that stands still,
#
#     out = (K_r + F K_ri / s) ((K_a + S K_ai / s) e - w),    w = -de/dt
#
# in 16-bit PWM per deg, with the release's ratios F = 3 and S = 1/2 of its integrals. So K_D is
# K_r, K_P is K_r K_a + F K_ri, K_I is K_r S K_ai + F K_ri K_a; a product of both integrals is no
# PID. What a conversion cannot keep: the derivative of a moving setpoint, and limits of
# integrals.


FORMS = ("direct", "whole", "firmware")
PER_DEG = FULL / PWM_FULL * math.pi / 180.0
"""16-bit PWM per deg for one count of 4096 per rad."""


def scaled(gains: PidGains, factor: float) -> PidGains:
    """All three gains times a factor."""
    return PidGains(*(factor * value for value in gains.as_tuple()))


def convert_gains(
    gains: Mapping[str, PidGains] | Mapping[str, float],
    source: str,
    target: str,
    model: Model,
    supply_mv: float = SUPPLY_MV,
) -> dict[str, PidGains] | dict[str, float]:
    """Gains of the form ``source`` as those of the form ``target`` for a model's motors.

    From the firmware's form all axes of which gains are given, the rest of them stock.
    Raises BadInputError for gains that the other form does not have.
    """
    counts = dict(zip(AXES, counts_per_control(model, supply_mv).tolist(), strict=True))
    if source == "firmware":
        values = {name: g for name, g in gains.items() if not isinstance(g, PidGains)}
        whole = {
            axis: _of_cascade({**RELEASE_2014.stock, **values}, axis)
            for axis in AXES
            if any(f".{axis}_" in name for name in values)
        }
    else:
        factor = counts if source == "direct" else dict.fromkeys(AXES, 1.0)
        by_axis = {axis: g for axis, g in gains.items() if isinstance(g, PidGains)}
        whole = {axis: scaled(g, factor[axis]) for axis, g in by_axis.items()}
    if target == "direct":
        return {axis: scaled(one, 1.0 / counts[axis]) for axis, one in whole.items()}
    if target == "whole":
        return whole
    made = {name: value for axis, one in whole.items() for name, value in _cascade(one, axis)}
    require_gains(made, "converted to the firmware's form")
    return made


def _of_cascade(values: Mapping[str, float], axis: str) -> PidGains:
    fast, slow = integral_ratios(RELEASE_2014)
    rate, rate_i = (values[f"pid_rate.{axis}_{k}"] for k in ("kp", "ki"))
    angle, angle_i, angle_d = (values[f"pid_attitude.{axis}_{k}"] for k in ("kp", "ki", "kd"))
    rate_i, angle_i = fast * rate_i, slow * angle_i
    if rate_i and angle_i:
        raise BadInputError(
            f"{axis}: an angle integral over a rate integral is no PID; set one of"
            f" pid_rate.{axis}_ki and pid_attitude.{axis}_ki to 0"
        )
    kp = rate * angle + rate_i * (1.0 + angle_d / slow)
    ki = rate * angle_i + rate_i * angle
    return scaled(PidGains(kp, ki, rate * (1.0 + angle_d / slow)), 1.0 / PER_DEG)


def _cascade(gains: PidGains, axis: str) -> list[tuple[str, float]]:
    fast, slow = integral_ratios(RELEASE_2014)
    kp, ki, kd = (PER_DEG * value for value in gains.as_tuple())
    if not kd > 0.0:
        raise BadInputError(f"{axis}: kd {gains.kd:g}: the firmware's rate loop needs one above 0")
    if axis == "yaw":
        if ki:
            raise BadInputError(
                f"yaw: ki {gains.ki:g}: the firmware's yaw has no loop for it; set it to 0"
            )
        return [("pid_rate.yaw_kp", kd), ("pid_rate.yaw_ki", kp / fast)]
    return [
        (f"pid_rate.{axis}_kp", kd),
        (f"pid_attitude.{axis}_kp", kp / kd),
        (f"pid_attitude.{axis}_ki", ki / kd / slow),
    ]


# Gains on a model, in one of three loops: what a step gives and what margins are left.


Loop = Literal["direct", "whole", "firmware"]
LOOPS: tuple[Loop, ...] = ("direct", "whole", "firmware")
WHOLE_STEP_RAD = 0.2
"""Step of the whole simulation, in which a larger one saturates."""
STEADY_S = 4.0
"""Over so long a window a loop with motors shows whether it calms down."""
STILL = 0.1
"""A response that swings by less than this share of the step at its end is calm."""


@dataclass(frozen=True)
class AxisResult:
    """One axis. response: (k,) over the step, one row per 2 ms. step: in rad, yaw of the
    firmware in rad/s. loop: its frequency response, stable or not. most_delay: samples up to
    which it is stable, only on the direct loop."""

    axis: str
    gains: dict[str, float]
    step: float
    metrics: StepMetrics
    stable: bool
    response: Array
    loop: LoopResponse
    most_delay: int | None = None

    @cached_property
    def margins(self) -> Margins | None:
        """None where the loop is unstable."""
        return self.loop.margins if self.stable else None

    def as_dict(self) -> dict[str, Any]:
        """The design's keys for ``pid evaluate --json``, and more."""
        return {
            **self.metrics.as_dict(),
            **(dict.fromkeys(MARGINS) if self.margins is None else self.margins.as_dict()),
            "stable": self.stable,
            "most_delay_samples": self.most_delay,
            "step": self.step,
            "gains": self.gains,
        }


def evaluate(
    model: Model,
    gains: Mapping[str, PidGains] | Mapping[str, float],
    loop: Loop,
    seconds: float = 1.0,
    delay: int | None = None,
    release: str | None = None,
) -> list[AxisResult]:
    """A step on each axis for which there are gains, one axis at a time.

    gains: by axis for ``direct`` (u' per rad) and ``whole`` (PWM counts per rad), by parameter
    for ``firmware``. delay: samples instead of the model's, not for ``firmware``. release: whose
    loops ``firmware`` is, None: the vehicle's; they fly the model's body, the other two its
    polynomials where it has them.

    Raises BadInputError for gains of the other form, or a model that the loop cannot use.
    """
    by_axis = {name: g for name, g in gains.items() if isinstance(g, PidGains)}
    if loop == "firmware":
        if by_axis:
            raise BadInputError("gains by axis are the thesis's form: --loop direct or whole")
        if delay is not None:
            raise BadInputError("--delay: the firmware's loop has the model's dead time")
        values = {name: g for name, g in gains.items() if not isinstance(g, PidGains)}
        plant = plant_of_model(model, release=release)
        return [_firmware(plant, values, axis, seconds) for axis in AXES]
    if not by_axis:
        raise BadInputError(f"--loop {loop} needs gains by axis, [roll] kp = ...")
    if loop == "direct":
        return [_direct(model, g, axis, seconds, delay) for axis, g in by_axis.items()]
    return [_whole(model, by_axis, axis, seconds, delay) for axis in by_axis]


def _direct(
    model: Model, gains: PidGains, axis: str, seconds: float, delay: int | None
) -> AxisResult:
    plant = axis_plant(model, axis, delay)
    y = step_direct(plant, gains, seconds)
    return AxisResult(
        axis,
        msgspec.structs.asdict(gains),
        1.0,
        step_metrics(y, plant.ts),
        is_stable(plant, gains),
        y,
        direct_loop(plant, gains),
        most_delay(plant, gains),
    )


def _whole(
    model: Model, gains: Mapping[str, PidGains], axis: str, seconds: float, delay: int | None
) -> AxisResult:
    index = AXES.index(axis)
    reference = np.zeros((round(max(seconds, STEADY_S) / SAMPLE_PERIOD_S), 3))
    reference[:, index] = WHOLE_STEP_RAD
    every = [gains.get(name, PidGains(0.0)) for name in AXES]
    long = run_whole(model, every, reference, delay=delay).angles[:, index]
    y = long[: round(seconds / SAMPLE_PERIOD_S)]
    return AxisResult(
        axis,
        msgspec.structs.asdict(gains[axis]),
        WHOLE_STEP_RAD,
        step_metrics(y, SAMPLE_PERIOD_S, WHOLE_STEP_RAD),
        calms(long / WHOLE_STEP_RAD),
        y / WHOLE_STEP_RAD,
        whole_loop(model, gains[axis], axis, delay),
    )


def _firmware(plant: Plant, gains: Mapping[str, float], axis: str, seconds: float) -> AxisResult:
    step = STEP_RAD[axis]
    y = step_response(plant, gains, axis, seconds)
    return AxisResult(
        axis,
        {n: gains.get(n, plant.firmware.stock[n]) for n in plant.firmware.gain_names(axis)},
        step,
        step_metrics(y * step, SAMPLE_PERIOD_S, step),
        calms(step_response(plant, gains, axis, max(seconds, STEADY_S))),
        y,
        cascade_loop(plant, gains, axis),
    )


def calms(response: Array) -> bool:
    """Whether a response over its step calms down: its last quarter swings little, or less than
    the one before, and about the reference."""
    parts: Sequence[Array] = np.array_split(response, 4)
    swings = [float(np.ptp(part)) for part in parts]
    if not math.isfinite(swings[3]):
        return False
    return swings[3] < STILL or (swings[3] < 0.8 * swings[2] and swings[3] < 1.0)


# What motors can follow: gains of the direct loop, in which u' is free, beside the motors' own.


JUDGED_S = 1.5
MORE = 2.0
"""Times the RMS error of the direct loop that the motors may make of it."""


def most_control(model: Model, axis: str, supply_mv: float = SUPPLY_MV) -> float:
    """The largest u' in (rev/s)^2 that the rotors give around hover with the thrust kept."""
    plant = motors_and_body(model)
    hover, full = plant.hover_rev_s, model.motor.steady_rev_s(supply_mv)
    either_way = min(full**2 - hover**2, hover**2)
    return float(np.abs(plant.mixer[AXES.index(axis)]).sum() * max(either_way, 0.0))


def reason_not_followed(
    model: Model,
    gains: PidGains,
    axis: str,
    delay: int | None = None,
    supply_mv: float = SUPPLY_MV,
) -> str:
    """Why the motors of a model cannot follow gains on u'; empty where they can.

    The gains are flown through a step of 0.2 rad, on the direct loop and, as PWM counts, on the
    whole one: there they must calm down, and not miss the reference by much more.
    """
    index, rows = AXES.index(axis), round(STEADY_S / SAMPLE_PERIOD_S)
    counts = float(counts_per_control(model, supply_mv)[index])
    three = [scaled(gains, counts) if one == axis else PidGains(0.0) for one in AXES]
    reference = np.zeros((rows, 3))
    reference[:, index] = WHOLE_STEP_RAD
    flown = run_whole(model, three, reference, delay=delay, supply_mv=supply_mv)
    behind = flown.angles[:, index] / WHOLE_STEP_RAD
    plant = axis_plant(model, axis, delay)
    free = step_direct(plant, gains, STEADY_S)
    missed, promised = (
        float(np.sqrt(np.mean((1.0 - y[: round(JUDGED_S / period_s)]) ** 2)))
        for y, period_s in ((behind, SAMPLE_PERIOD_S), (free, plant.ts))
    )
    calm = calms(behind)
    if calm and missed <= MORE * promised:
        return ""
    asked = (gains.kp + gains.kd / SAMPLE_PERIOD_S) * WHOLE_STEP_RAD  # in the step's first row
    most = most_control(model, axis, supply_mv)
    lag = 1.0 / hover_and_pole(model)[1]
    return (
        f"{axis}: kp {gains.kp:.3g}, kd {gains.kd:.3g} ask u' = {asked:.2g} (rev/s)^2 for a step of"
        f" {WHOLE_STEP_RAD:g} rad; the rotors give {most:.2g} around hover and follow with a lag of"
        f" {1e3 * lag:.0f} ms, behind which "
        + (
            f"the angle misses the step by {missed:.2f} of it instead of {promised:.2f} (RMS over"
            f" {JUDGED_S:g} s)"
            if calm
            else "the loop is unstable"
        )
    )
