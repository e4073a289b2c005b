"""The thesis's chapters on identification: flights, motors, body and ARX."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import msgspec
import numpy as np

from groundstation.dynamics.model import (
    THESIS,
    ArxAxis,
    Model,
    arx_ahead,
    model_vehicle,
    rotor_motors,
    vehicle_model,
)
from groundstation.dynamics.simulation import armature_mv
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.identification.arx import (
    WINDOW_S,
    ArxCandidate,
    ArxData,
    ArxSearch,
    arx_data,
    free_run_rms,
    residuals,
    search_arx,
    step_response,
)
from groundstation.identification.estimate import cross_correlation_test, liveliest
from groundstation.identification.flight import Stretch, stretches_of, turning
from groundstation.identification.motor.fit import bench_run, speed_from_gate
from groundstation.identification.motor.fit import simulate_run as simulate_motor
from groundstation.identification.report import angle_rms, simulate_run
from groundstation.identification.runs import Run, rotor_squares
from groundstation.report.page import Cell, against, lines, points
from groundstation.telemetry.arrays import AXES, Array
from groundstation.thesis.workshop import (
    BODY_RMS,
    CROSS,
    MOTOR_FIT,
    ROLL_ARX,
    ROLL_ON_PITCH,
    ROLL_STEPS,
    YAW_ARX,
    Entry,
    Made,
    Order,
    Table,
    Workshop,
    both_steps,
    correlation,
    overlay,
)

# Figures 7.13 to 7.25: what a flight's recording becomes before anything is fitted to it.


EXAMPLE_S = 4.0


def airborne(workshop: Workshop, name: str) -> list[Stretch]:
    """The stretches of a flight in the air, their rotors by the fitted motor."""
    motors = rotor_motors(workshop.model("body.json"))
    runs = workshop.runs(name)
    return workshop.once(("airborne", name), lambda: stretches_of(runs, motors))


def longest(workshop: Workshop, name: str = "flight.csv") -> Run:
    """The longest stretch in the air as a run of its own."""
    one = max(airborne(workshop, name), key=len)
    return one.run[one.rows]


def torque(workshop: Workshop, run: Run) -> Array:
    """u' (n, 3) of eq. 7.19."""
    model = workshop.model("body.json")
    return rotor_squares(run, rotor_motors(model)).mixed(model_vehicle(model).configuration)


def _voltages(workshop: Workshop, one: int, other: int) -> Made:
    run = longest(workshop)
    volts = armature_mv(run.duty, run.supply_v) / 1e3
    full = 100.0 * float((run.duty[:, [one, other]] >= 0.995).any(axis=1).mean())
    return Made(
        f"Duty times the reported battery voltage (3.84). Saturated in {full:.1f} % of the"
        " rows; the thesis's tops are flat where they are.",
        figures=[lines(run.time_s, {f"M{i + 1}": volts[:, i] for i in (one, other)}, "V")],
    )


def _speeds(workshop: Workshop, one: int, other: int) -> Made:
    run = longest(workshop)
    speed = np.sqrt(rotor_squares(run, rotor_motors(workshop.model("body.json"))).end)
    return Made(
        "By the fitted motor (7.10) from the voltages.",
        figures=[lines(run.time_s, {f"M{i + 1}": speed[:, i] for i in (one, other)}, "rev/s")],
    )


def _torque(workshop: Workshop, axis: int) -> Made:
    run = longest(workshop)
    mixed = torque(workshop, run)[:, axis]
    return Made(
        f"u'{axis + 1} of the mixer (7.19): between {mixed.min():.0f} and {mixed.max():.0f}"
        f" (rev/s)^2, mean {mixed.mean():.0f}.",
        figures=[lines(run.time_s, {AXES[axis]: mixed}, "u', (rev/s)^2")],
    )


def _angle(workshop: Workshop, axis: int) -> Made:
    run = longest(workshop)
    angle = np.degrees(run.attitude[:, axis])
    return Made(
        f"As reported, {angle.min():.1f} to {angle.max():.1f} deg.",
        figures=[lines(run.time_s, {AXES[axis]: angle}, "deg")],
    )


def _example(workshop: Workshop, axis: int) -> Made:
    run = longest(workshop)
    rows = liveliest(run.attitude[:, axis], run.period_s, EXAMPLE_S)
    return Made(
        f"The {EXAMPLE_S:.0f} s in which {AXES[axis]} moves most: angle, and dashed the"
        " torque behind it.",
        figures=[
            against(
                run.time_s[rows],
                np.degrees(run.attitude[rows, axis]),
                f"{AXES[axis]}, deg",
                torque(workshop, run)[rows, axis],
                "u', (rev/s)^2",
            )
        ],
    )


FLIGHTS = (
    Entry("Figure 7.13", "Motor1 and Motor3 armature voltages", _voltages, (0, 2)),
    Entry("Figure 7.14", "Motor2 and Motor4 armature voltages", _voltages, (1, 3)),
    Entry("Figure 7.15", "Rotational speeds of Motor1 and Motor3", _speeds, (0, 2)),
    Entry("Figure 7.16", "Rotational speeds of Motor2 and Motor4", _speeds, (1, 3)),
    Entry("Figure 7.17", "Roll torque respect to the k constant", _torque, (0,)),
    Entry("Figure 7.18", "Pitch torque respect to the k constant", _torque, (1,)),
    Entry("Figure 7.19", "Yaw torque respect to the b constant", _torque, (2,)),
    Entry("Figure 7.20", "Roll angle of the flight data", _angle, (0,)),
    Entry("Figure 7.21", "Pitch angle of the flight data", _angle, (1,)),
    Entry("Figure 7.22", "Yaw angle of the flight data", _angle, (2,)),
    Entry("Figure 7.23", "Real-time flight data example-1", _example, (0,)),
    Entry("Figure 7.24", "Real-time flight data example-2", _example, (1,)),
    Entry("Figure 7.25", "Real-time flight data example-3", _example, (2,)),
)


# Figures 7.3 to 7.6 and 7.9 to 7.11, Table 7.1: the motor.


FITTED_S = (20.0, 28.0)
"""The 4000 samples that are fitted."""
START_S, PIECE_S, MOTOR_DRAWN_S = 0.5, 2.0, 8.0


def _piece(workshop: Workshop) -> Run:
    run = workshop.runs("bench.csv")[0]
    before_s = run.recording_start_s - run.start_s
    first, last = (round((s + before_s) / run.period_s) for s in FITTED_S)
    return run[max(first, 0) : last]


def _periods(workshop: Workshop) -> Made:
    run = _piece(workshop)
    return Made(
        "Half a revolution, as the optical gate times it, over the 8 s that are fitted:"
        f" {100 * speed_from_gate(run).glitches:.1f} % of the readings are missed or doubled"
        " passages.",
        figures=[points(run.time_s, {"gate": 1e3 * run.debug_s}, "half period, ms")],
    )


def _kept(workshop: Workshop) -> tuple[Array, Array]:
    """Time (s) and speed (rev/s) of the gate's readings that its filter keeps."""
    run = _piece(workshop)
    speed = speed_from_gate(run).rev_s
    kept = np.isfinite(speed)
    return run.time_s[kept], speed[kept]


def _filtered(workshop: Workshop) -> Made:
    time, speed = _kept(workshop)
    return Made(
        "Readings that differ by more than 10 % from the median of those around them are left out"
        " (the thesis does not say how its filter works), and nothing is put in their place.",
        figures=[points(time, {"kept": 500.0 / speed}, "half period, ms")],
    )


def _speed(workshop: Workshop) -> Made:
    time, speed = _kept(workshop)
    return Made("One over twice the half period.", figures=[lines(time, {"M1": speed}, "rev/s")])


def _voltage(workshop: Workshop) -> Made:
    run = _piece(workshop)
    voltage = armature_mv(run.duty, run.supply_v)[:, 0] / 1e3
    return Made(
        "Duty times the reported battery voltage (3.84).",
        figures=[lines(run.time_s, {"M1": voltage, "battery": run.supply_v}, "V")],
    )


def _results(workshop: Workshop) -> Made:
    true = msgspec.structs.astuple(THESIS.motor)
    rows: list[list[Cell]] = [["printed (7.10)", *MOTOR_FIT.values(), *true]]
    for name, words in (
        ("motor.json", "8 s, battery as reported (3.84)"),
        ("supplied.json", "60 s, sag and lag of the battery modelled"),
    ):
        model = workshop.model(name)
        account = model.fit["motor"]
        held = [one["rotor_fit_percent"] for one in account["validation"]]
        own = float(np.mean(account["identification"]["rotor_fit_percent"]))
        rows.append([words, own, *held, *msgspec.structs.astuple(model.motor)])
    rows.append(["true of the stand-in", None, None, None, *true])
    return Made(
        "The reported voltage passes a filter of 155 ms and does not know what wires lose. Taking"
        " it for the armature's, as 3.84 does, costs 15 % of a0 and a1 while the fit still reads"
        " 97 %: fit percent is no proof of parameters.",
        [Table(["fit %", *MOTOR_FIT, "a0", "a1", "a2"], rows)],
    )


def _fit_motors(workshop: Workshop, part: str) -> Made:
    motor = workshop.model("motor.json")
    account = motor.fit["motor"]
    if part == "identification":
        run = _piece(workshop)
        percent = float(np.mean(account["identification"]["rotor_fit_percent"]))
    else:
        number = int(part[-1])
        whole = workshop.runs(f"bench{number}.csv")[0]
        (run, *_) = whole.parts(turning(whole), PIECE_S)
        run = run[round(START_S / run.period_s) :]
        percent = account["validation"][number - 1]["rotor_fit_percent"]
    estimates = account["estimates"]
    values = dict(zip(estimates["names"], estimates["values"], strict=True))
    bench = bench_run(run[: round(MOTOR_DRAWN_S / run.period_s)], 0)
    modelled = simulate_motor(bench, motor.motor, values["delay_s"])
    known = np.isfinite(bench.rev_s)
    time = run.time_s[: len(known)][known]
    return Made(
        f"Fit {percent:.1f} % (printed {MOTOR_FIT[part]:.2f} %), simulated from the voltage"
        f" alone; {MOTOR_DRAWN_S:.0f} s are drawn.",
        figures=[overlay(time, bench.rev_s[known], modelled[known], "rev/s", "simulated")],
    )


MOTORS = (
    Entry("Figure 7.3", "Logged motor revolution period data", _periods),
    Entry("Figure 7.4", "Filtered motor revolution period data", _filtered),
    Entry("Figure 7.5", "Measured motor speed", _speed),
    Entry("Figure 7.6", "Armature voltage", _voltage),
    Entry("Table 7.1", "Motor model identification results", _results),
    Entry("Figure 7.9", "Identification data fit", _fit_motors, ("identification",)),
    Entry("Figure 7.10", "Validation-1 data fit", _fit_motors, ("validation 1",)),
    Entry("Figure 7.11", "Validation-2 data fit", _fit_motors, ("validation 2",)),
)


# Figures 7.27 to 7.31, Table 7.2: the grey box of the body.


WINDOWS_S = (0.5, 2.0)
BODY_DRAWN_S = 6.0
FILES = {"identification": "flight.csv", "validation": "held.csv"}


def by_roll(model: Model) -> Model:
    """The model with roll's constant for pitch, as in the thesis."""
    body = model.body
    if body is None:
        return model
    return msgspec.structs.replace(model, body=msgspec.structs.replace(body, c1=body.c0))


def _rms(workshop: Workshop, axis: str, part: str, window_s: float) -> float:
    def make() -> Array:
        model = by_roll(workshop.model("body.json"))
        return angle_rms(model, [longest(workshop, FILES[part])], window_s)

    return float(workshop.once(("angle rms", part, window_s), make)[AXES.index(axis)])


def _body_table(workshop: Workshop) -> Made:
    rows: list[list[Cell]] = [
        [f"{axis}, {part}", printed, *(_rms(workshop, axis, part, w) for w in WINDOWS_S)]
        for (axis, part), printed in BODY_RMS.items()
    ]
    found = workshop.model("body.json")
    true = vehicle_model(load_vehicle("crazyflie1")).body
    said = found.fit["body"]["estimates"]
    error = dict(zip(said["names"], said["stderr"], strict=True))
    constants = [
        [name, *(getattr(one, name) for one in (THESIS.body, found.body, true))]
        for name in ("c0", "c1", "c2")
    ]
    for row in constants:
        row.insert(3, error[row[0]])
    return Made(
        "RMS of the angles in rad when the fitted body runs freely from measured rates and angles;"
        " pitch by roll's constant, as in the thesis. How long a run lasts decides what is read"
        " off, which the thesis does not say: runs of 2 s come near the printed errors of roll and"
        " yaw. An unstable plant's free run measures how disturbances add up. The fit itself"
        " predicts rates one row ahead, with a noise model.",
        [
            Table(["data fit", "printed", *(f"runs of {w:g} s" for w in WINDOWS_S)], rows),
            Table(
                ["constant", "printed (7.18)", "fitted", "standard error", "true of the stand-in"],
                constants,
                "The printed constants are another craft's.",
            ),
        ],
    )


def _fit_body(workshop: Workshop, axis: str, part: str) -> Made:
    run = longest(workshop, FILES[part])
    index = AXES.index(axis)
    rows = liveliest(run.attitude[:, index], run.period_s, BODY_DRAWN_S)
    model = by_roll(workshop.model("body.json"))
    done = workshop.once(("replayed", part), lambda: simulate_run(model, run, max(WINDOWS_S)))
    error = _rms(workshop, axis, part, max(WINDOWS_S))
    words = " by roll's constant" if axis == "pitch" else ""
    measured = np.unwrap(run.attitude, axis=0)[rows, index]
    apart = np.angle(np.exp(1j * (measured - done.attitude[rows, index])))
    drawn = np.degrees(measured), np.degrees(measured - apart)
    return Made(
        f"Free runs of {max(WINDOWS_S):g} s each{words}: RMS {error:.3f} rad over the flight,"
        f" printed {BODY_RMS[axis, part]:.4f}.",
        figures=[overlay(run.time_s[rows], *drawn, f"{axis}, deg", "free run")],
    )


BODY = (
    *(
        Entry(f"Figure 7.{27 + i}", f"{axis.capitalize()} axis {part} data fit", _fit_body, which)
        for i, which in enumerate(BODY_RMS)
        for axis, part in (which,)
    ),
    Entry("Table 7.2", "Results of nonlinear grey-box identification", _body_table),
)


# Figures 7.34 to 7.56, Tables 7.3 to 7.5: ARX models on angles.


CHOSEN: Order = (2, 1, 8)
DRAWN_S = 6.0
MODEL = "arx.json"
PRINTED_ARX = {"roll": ROLL_ARX, "yaw": YAW_ARX}
RMS_HEAD = ("printed identification", "printed validation", "identification", "validation")


@dataclass(frozen=True, slots=True)
class AxisSearch:
    """All structures of an axis, and the data that they were fitted and judged on."""

    search: ArxSearch
    fit: list[ArxData]
    held: list[ArxData]

    def of(self, order: Order) -> ArxCandidate:
        """One structure."""
        return next(one for one in self.search.candidates if one.order == order)

    @property
    def longest(self) -> ArxData:
        """Of the held-out data."""
        return max(self.held, key=lambda data: len(data.outputs))


def _searched(workshop: Workshop, axis: str) -> AxisSearch:
    def make() -> AxisSearch:
        model = workshop.model("body.json")
        configuration = model_vehicle(model).configuration
        fit, held = (
            [
                arx_data(one.run[one.rows], axis, rotor_motors(model), configuration)
                for one in airborne(workshop, name)
            ]
            for name in ("flight.csv", "held.csv")
        )
        return AxisSearch(search_arx(fit, held), fit, held)

    workshop.use(MODEL)
    return workshop.once(("searched", axis), make)


def label(order: Order) -> str:
    """The structure as the thesis writes it."""
    return f"ARX({','.join(map(str, order))})"


def _fit_arx(workshop: Workshop, axis: str, order: Order) -> Made:
    found = _searched(workshop, axis)
    one = found.of(order)
    printed = PRINTED_ARX[axis].get(order)
    beside = f" (printed {printed[1]:.4f})" if printed else " (not in the printed table)"
    return _run_freely(
        one.axis,
        found.longest,
        axis,
        f"{label(order)}, free runs of {WINDOW_S:g} s on the held-out flight: RMS"
        f" {one.rms_validation:.4f} rad{beside}; step response {_step_of(one)}.",
    )


def _step_of(one: ArxCandidate) -> str:
    return "plausible" if one.plausible else "not plausible"


def _run_freely(model: ArxAxis, data: ArxData, axis: str, words: str) -> Made:
    every = max(1, round(WINDOW_S / data.period_s))
    starts = np.arange(0, len(data.outputs) - every, every)
    flown = arx_ahead(model, data.inputs, data.outputs, starts, every - 1, 1).ravel()
    measured = data.outputs[: len(flown)]
    rows = liveliest(measured, data.period_s, DRAWN_S)
    time = np.asarray(data.period_s * np.arange(len(measured)), np.float64)
    reach = 3.0 * float(np.abs(measured[rows]).max())
    drawn = np.degrees(measured[rows]), np.degrees(np.clip(flown[rows], -reach, reach))
    return Made(words, figures=[overlay(time[rows], *drawn, f"{axis}, deg", "free run")])


def _table(workshop: Workshop, axis: str) -> Made:
    found, printed = _searched(workshop, axis), PRINTED_ARX[axis]
    best, chosen = found.search.candidates[0], found.search.chosen
    shown = {order: label(order) for order in printed}
    shown.setdefault(best.order, f"{best.label}, best here")
    rows: list[list[Cell]] = []
    for order, name in shown.items():
        one = found.of(order)
        beside = printed.get(order, (None, None))
        rows.append([name, *beside, one.rms_fit, one.rms_validation, _step_of(one)])
    return Made(
        "The thesis's procedure: 88 structures on angles, least squares, ranked by free run,"
        f" here over {WINDOW_S:g} s at a time; RMS in rad. Chosen here: {chosen.label}. The"
        " reported angle is fresh in every second row only, and least squares spends its"
        " coefficients on the repetition (docs/identification.md, ARX models).",
        [
            Table(
                ["structure", *RMS_HEAD, "step response"],
                rows,
                f"The whole list: fit.arx.axes.{axis}.table in {MODEL}.",
            )
        ],
    )


def _steps(workshop: Workshop, axis: str, order: Order) -> Made:
    one = _searched(workshop, axis).of(order)
    time, output = step_response(one.axis)
    printed = ROLL_STEPS[order] if axis == "roll" else "same sign, no oscillations"
    poles = ", ".join(f"{abs(p):.3f}" for p in np.sort_complex(np.roots([1.0, *one.axis.a])))
    return Made(
        f"Printed: {printed}. Here: {_step_of(one)};"
        f" after 0.5 s {output[-1]:.2e} rad per (rev/s)^2; magnitudes of the poles {poles}.",
        figures=[both_steps(time, output, f"{axis}, rad")],
    )


def _cross(workshop: Workshop, axis: str, order: Order) -> Made:
    found = _searched(workshop, axis)
    one = found.of(order)
    data = found.held[0]
    left = residuals(one.axis, data)
    rows = sum(len(part.outputs) for part in found.fit)
    test = cross_correlation_test(left, data.inputs[-len(left) :], fitted_rows=rows)
    printed = CROSS[order] if axis == "roll" else "passes"
    return Made(
        f"Printed: {printed}. Here on held-out data: {test.outside} of {len(test.lags)} lags"
        f" outside the 99 % band, the test {'passes' if test.passes else 'fails'} (it allows"
        " for slow inputs, whose neighbouring lags leave the band together).",
        figures=[correlation(test, "correlation")],
    )


def _roll_on_pitch(workshop: Workshop) -> Made:
    model = _searched(workshop, "roll").of(CHOSEN).axis
    pitch = _searched(workshop, "pitch")
    return _run_freely(
        model,
        pitch.longest,
        "pitch",
        f"{label(CHOSEN)} of roll on pitch: RMS {free_run_rms(model, pitch.held):.4f} rad"
        f" (printed {ROLL_ON_PITCH}).",
    )


def _performance(workshop: Workshop) -> Made:
    roll, pitch = _searched(workshop, "roll"), _searched(workshop, "pitch")
    rows: list[list[Cell]] = []
    for words, one in (
        (label(CHOSEN), roll.of(CHOSEN)),
        (f"{roll.search.chosen.label}, chosen here", roll.search.chosen),
    ):
        printed = ROLL_ARX[CHOSEN] if one.order == CHOSEN else (None, None)
        on_pitch = ROLL_ON_PITCH if one.order == CHOSEN else None
        rows.append([f"roll, {words}", *printed, one.rms_fit, one.rms_validation])
        rows.append(
            [f"pitch by it, {words}", None, on_pitch, None, free_run_rms(one.axis, pitch.held)]
        )
    return Made(
        "Roll's model serves pitch as well as roll, as the thesis found.",
        [Table(["data axis", *RMS_HEAD], rows)],
    )


COMPARED = {
    "by_body.json": "grey box",
    "by_arx.json": "ARX, angles",
    "by_rates.json": "ARX, rates, one row of 4",
}


def _decision(workshop: Workshop) -> Made:
    said = {words: workshop.said(name)["gap"] for name, words in COMPARED.items()}
    first, *_ = said.values()
    rows: list[list[Cell]] = [
        [channel, *(one["channels"][channel]["before"] for one in said.values())]
        for channel in first["channels"]
    ]
    rows.append(["all", *(one["validation"]["before"] for one in said.values())])
    chosen, rates = (
        ", ".join(
            f"{axis} {one['chosen']}"
            for axis, one in workshop.model(name).fit["arx"]["axes"].items()
        )
        for name in ("arx.json", "rates.json")
    )
    return Made(
        "Printed: ARX is better than the grey box on all axes, for its delay. Here, errors 20 and"
        " 50 ms ahead on the held-out flight over what noise leaves (1: nothing left). The grey box"
        " is the fitted body with its delay and rotor torques; the polynomials turn the craft, its"
        f" thrust is the body's. Angles: the best of the thesis's four structures, {chosen};"
        f" rates: {rates}. On the rates a body that has its delay leaves least; on the reported"
        " angles, which the on-board filter makes and holds for two rows, polynomials are better,"
        " as the thesis found, and those of rates more so than those of angles.",
        [Table(["error over noise", *said], rows)],
    )


def _of_roll(
    first: int, title: str, make: Callable[..., Made], orders: Iterable[Order]
) -> list[Entry]:
    """A figure of each structure, numbered from 7.``first`` on."""
    return [
        Entry(f"Figure 7.{number}", f"{label(order)} {title}", make, ("roll", order))
        for number, order in enumerate(orders, first)
    ]


FITS: tuple[Order, ...] = (
    *((2, 1, 0), (2, 1, 4), (2, 1, 8), (2, 1, 10), (3, 1, 0), (3, 1, 4)),
    *((4, 2, 0), (2, 2, 0), (2, 2, 4), (3, 2, 0), (3, 2, 4)),
)
ARX = (
    *_of_roll(34, "roll model", _fit_arx, FITS),
    Entry("Table 7.3", "Top results of the iterative ARX identification (roll)", _table, ("roll",)),
    *_of_roll(45, "roll model step responses", _steps, ROLL_STEPS),
    *_of_roll(49, "roll model cross-correlation", _cross, CROSS),
    Entry("Figure 7.53", "Roll model with pitch axis data", _roll_on_pitch),
    Entry("Table 7.4", "Performance of the selected ARX model (roll and pitch)", _performance),
    Entry("Table 7.5", "Top results of ARX identification (yaw)", _table, ("yaw",)),
    Entry("Figure 7.54", f"{label(CHOSEN)} yaw model", _fit_arx, ("yaw", CHOSEN)),
    Entry("Figure 7.55", f"{label(CHOSEN)} yaw model step responses", _steps, ("yaw", CHOSEN)),
    Entry("Figure 7.56", f"{label(CHOSEN)} yaw model cross-correlation", _cross, ("yaw", CHOSEN)),
    Entry("Section 7.3.8", "Model decision", _decision),
)
