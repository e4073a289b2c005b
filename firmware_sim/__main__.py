"""``python -m firmware_sim``: the stand-in alone, in real time or as fast as it goes."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.output import write_csv, write_npz, write_truth
from firmware_sim.settings import load_settings
from groundstation.dynamics.vehicle import BUILT_IN
from groundstation.text import printable

if TYPE_CHECKING:
    from firmware_sim.serial_port import SerialPort

STEP_S = 0.01
SERIAL_STEP_S = 0.002
"""A line is served more often: what a reader stamps should not wait for us."""
FAST_STEP_S = 1.0
CATCH_UP_S = 0.05
"""Longest step of a flight in real time that is late: each step costs about as much, however long,
and short ones alone would never catch up on a busy machine."""

EXAMPLES = """examples:
  python -m firmware_sim --for 60 --fast -o flight.npz
  python -m firmware_sim --plant reduced --program motor_bench --for 64 --fast -o bench.csv
  python -m firmware_sim --effect rotor_drag:drag_n_s_m=0.01 --for 60 --fast -o hidden.npz
  python -m firmware_sim --crtp 127.0.0.1:19850          (then: cflib, udp://127.0.0.1:19850)
  python -m firmware_sim --serial pty:/tmp/craft         (then: --link serial:/tmp/craft)

An .npz file holds `packets` (n, 32) uint8, every copy the bridge forwarded, and `arrival_s`
(n,) float64, seconds since power-on, and `vehicle`, the craft's profile; a .csv file holds the
decoded samples in the telemetry layout (Timestamp in ticks of 73/72 us). Both are recordings for
`groundstation`. Neither says what was hidden in the craft.
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the stand-in. Returns 0, or 1 after one line on stderr."""
    options = _parser().parse_args(arguments)
    try:
        settings = _settings(options)
        craft = StandIn(settings)
        _require_writable(options)
        if craft.added_by_plant:
            print(craft.added_by_plant, flush=True)
        with _line(options) as line:
            flight = asyncio.run(_fly(craft, options, line))
        if options.output is not None:
            if options.output.suffix == ".npz":
                write_npz(options.output, *flight, craft.profile)
            else:
                write_csv(options.output, *flight)
        if options.truth is not None:
            write_truth(options.truth, craft.truth())
    except ValueError as error:
        print(f"firmware_sim: {printable(str(error))}", file=sys.stderr)
        return 1
    except OSError as error:
        print(
            f"firmware_sim: {error.filename or options.crtp}: {error.strerror}",
            file=sys.stderr,
        )
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m firmware_sim",
        description="A software stand-in for a Crazyflie 1.0 and its telemetry bridge.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--settings", type=Path, help="TOML file of settings (docs/stand_in.md)")
    parser.add_argument("--plant", choices=("reduced", "faithful", "model"))
    parser.add_argument("--craft", help=f"{', '.join(BUILT_IN)}, thesis, a .toml or a model file")
    parser.add_argument("--program", help="pilot programme, built in or a TOML file")
    parser.add_argument("--seed", type=int)
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[:PARAMETER=VALUE,...]",
        help="hide an effect in the craft; may be given several times",
    )
    parser.add_argument(
        "--for", dest="seconds", type=float, help="stop after so many simulated seconds"
    )
    parser.add_argument("--fast", action="store_true", help="as fast as it goes (needs --for)")
    parser.add_argument("-o", "--output", type=Path, help="write what was received (.npz or .csv)")
    parser.add_argument("--truth", type=Path, help="write what really happened (.npz)")
    parser.add_argument("--crtp", metavar="HOST:PORT", help="serve CRTP on UDP")
    parser.add_argument(
        "--serial",
        metavar="pty[:LINK]|PORT[@BAUD]",
        help="send telemetry to a new pseudo-terminal (and link to it) or a serial port",
    )
    return parser


def _require_writable(options: argparse.Namespace) -> None:
    for path in filter(None, (options.output, options.truth)):
        if path.exists():
            raise ValueError(f"{path}: exists already; give another name or remove it")
    if options.output is not None and options.output.suffix not in (".npz", ".csv"):
        raise ValueError(f"{options.output}: the name must end in .npz or .csv")


def _settings(options: argparse.Namespace) -> StandInSettings:
    settings = load_settings(options.settings) if options.settings else StandInSettings()
    names = ("plant", "craft", "program", "seed")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    effects = {**settings.effects, **dict(_effects(options.effect))}
    if options.fast and options.seconds is None:
        raise ValueError("--fast: say for how long with --for SECONDS")
    if options.fast and options.serial is not None:
        raise ValueError("--serial: a line runs in real time, leave --fast out")
    if options.seconds is not None and not 0 < options.seconds < 1e7:
        raise ValueError(f"--for {options.seconds:g}: must be positive")
    return msgspec.structs.replace(
        settings, **given, effects=effects, truth=settings.truth or options.truth is not None
    )


def _effects(texts: list[str]) -> Iterator[tuple[str, dict[str, float]]]:
    for text in texts:
        name, _, rest = text.partition(":")
        parameters = {}
        for item in filter(None, rest.split(",")):
            key, _, value = item.partition("=")
            try:
                parameters[key] = float(value)
            except ValueError as error:
                raise ValueError(f"--effect {text}: {key}={value!r} is no number") from error
        yield name, parameters


@contextlib.contextmanager
def _line(options: argparse.Namespace) -> Iterator[SerialPort | None]:
    """The serial line to send on, if one was asked for."""
    if options.serial is None:
        yield None
        return
    from firmware_sim.serial_port import SerialPort

    with SerialPort(options.serial) as line:
        yield line
    print(f"{line.unheard} packets while nobody listened, {line.dropped} dropped")


async def _fly(
    craft: StandIn, options: argparse.Namespace, line: SerialPort | None
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Advance until the time is up or Ctrl-C; packets are kept only if they will be written."""
    stopped = asyncio.Event()
    for sign in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(sign, stopped.set)
    # compiles on a machine's first run; what is announced below answers at once
    powered_on = await asyncio.to_thread(craft.advance, 0.0)
    server = None
    if options.crtp is not None:
        from firmware_sim.crtp import CrtpServer

        host, _, port = options.crtp.rpartition(":")
        if not host or not port.isdigit():
            raise ValueError(f"--crtp {options.crtp}: give HOST:PORT")
        server = CrtpServer(craft, host, int(port))
        await server.start()
        print(f"CRTP on udp://{host}:{server.port}", flush=True)
    end_s = float("inf") if options.seconds is None else options.seconds
    step_s = FAST_STEP_S if options.fast else STEP_S if line is None else SERIAL_STEP_S
    parts: list[tuple[NDArray[np.uint8], NDArray[np.float64]]] = [powered_on]
    if line is not None:
        print(f"telemetry on serial:{line.path}", flush=True)
    if options.output is None and line is None and server is None:
        print("flying for nobody (see --help: -o, --serial, --crtp); Ctrl-C ends it")
    start, flown_s = time.monotonic(), 0.0
    try:
        while flown_s < end_s and not stopped.is_set():
            late_s = 0.0 if options.fast else time.monotonic() - start - flown_s
            flown_s = min(flown_s + max(step_s, min(late_s, CATCH_UP_S)), end_s)
            part = craft.advance(flown_s)
            if options.output is not None:
                parts.append(part)
            if line is not None:
                line.send(part[0])
            ahead_s = 0.0 if options.fast else start + flown_s - time.monotonic()
            await asyncio.sleep(max(ahead_s, 0.0))
    finally:
        if server is not None:
            await server.close()
    return np.concatenate([p for p, _ in parts]), np.concatenate([t for _, t in parts])


if __name__ == "__main__":
    sys.exit(main())
