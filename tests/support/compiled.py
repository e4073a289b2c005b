"""Compile what the tests run, once: ``make test`` does it while the linter is busy.

Numba keeps what it compiles beside the sources, but programs that start together all compile.
What the pieces below find is of no interest.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

RECORDINGS = Path(__file__).parents[2] / "recordings"


def craft():
    """The software craft, the decoder and what reads its motor bench and its attitude."""
    import numpy as np

    from firmware_sim.craft import StandIn, StandInSettings
    from groundstation import (
        RawBatch,
        complementary,
        decode_all,
        fit_motor,
        kalman,
        load_vehicle,
        runs_of,
        vehicle_model,
    )
    from support.plant import fly, plant, slopes

    flights = [StandInSettings(plant="reduced", program="motor_bench"), StandInSettings()]
    for settings in flights:
        packets, heard_s = StandIn(settings).advance(14.0)
        raw = RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64))
        samples, _ = decode_all(raw)
        if settings.program == "motor_bench":
            vehicle = load_vehicle("crazyflie1")
            fit_motor(runs_of(samples, "bench"), [], vehicle_model(vehicle), vehicle)
    fly(*plant(), 0.01)
    slopes(*plant())
    kalman(samples.time_s, samples.gyro, samples.accelerometer)
    complementary(samples.time_s, samples.gyro, samples.accelerometer)


def models():
    """What fits a body, flies a model, compares and searches."""
    from groundstation import (
        Criterion,
        compare,
        find_discrepancy,
        fit_arx,
        fit_body,
        flights_of,
        fly_reference,
        load_reference,
        load_vehicle,
        open_recording,
        runs_of,
        simulate_run,
        vehicle_model,
    )
    from groundstation.twin.twin import warm_up

    samples = open_recording(RECORDINGS / "stand_in_flight.mcap").samples[:10_000]
    vehicle = load_vehicle("crazyflie1")
    model = vehicle_model(vehicle)
    warm_up(model)
    runs, flights = runs_of(samples, "flight"), flights_of(samples, "flight")
    fit_body(runs, [], model, vehicle, effects=())
    fit_arx(runs, [], model, vehicle, Criterion.PREDICTION, channel="gyro", decimate=4)
    simulate_run(model, runs[0], window_s=0.5)
    fly_reference(model, load_reference("doublet"))
    compare(flights, model)
    find_discrepancy([flights], model)


def controllers():
    """The loops, and what judges the gains of a design."""
    import numpy as np

    from groundstation import evaluate, load_model, load_vehicle, vehicle_model
    from groundstation.control.firmware_loop import CascadeJudge, plant_of_model
    from groundstation.control.firmwares import PidGains
    from groundstation.control.linear_loop import DirectJudge, axis_plant
    from groundstation.dynamics.sensing import gyro_step, settled_reading

    model, thesis = vehicle_model(load_vehicle("crazyflie1")), load_model("thesis")
    evaluate(model, {}, "firmware")
    plant = plant_of_model(model)
    # Asked only of a craft whose sensors are not ideal.
    gyro_step(plant.craft[0], 0.002, np.empty(1))
    settled_reading(plant.craft[0], np.zeros(3), np.zeros(3), np.empty(6))
    CascadeJudge([plant], "yaw", 0.1)(np.ones((1, 2)))
    for loop in ("direct", "whole"):
        evaluate(thesis, {"yaw": PidGains(1000.0)}, loop)
    DirectJudge(axis_plant(thesis, "yaw"), 0.1)(np.ones((1, 3)))


def main():
    """Each piece in a process of its own."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(piece) for piece in (models, controllers, craft)]:
            if error := done.exception():  # the tests will say more; they compile what is left
                print(f"compiling: {error!r}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
