"""The official client library over UDP, and datagrams that no client sends."""

from __future__ import annotations

import asyncio
import itertools
import os
import socket
import statistics
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cflib.crtp
import psutil
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig

from firmware_sim.contents import PARAMETERS, VARIABLES
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp import MAX_CLIENTS, CrtpServer
from support.crafts import ServedCraft, run_flat, served
from support.waiting import until


@pytest.fixture(scope="module")
def flight() -> Iterator[ServedCraft]:
    with served() as running:
        yield running


def test_a_port_that_is_given_back_can_be_served_at_once():
    async def served_again():
        server = CrtpServer(StandIn(StandInSettings()), port=0)
        await server.start()
        port = server.port
        await server.close()
        other = CrtpServer(StandIn(StandInSettings()), port=port)
        await other.start()
        assert other.port == port
        await other.close()

    asyncio.run(served_again())


@contextmanager
def connected(flight: ServedCraft) -> Iterator[Crazyflie]:
    cflib.crtp.init_drivers()
    crazyflie = Crazyflie()
    ready = threading.Event()
    crazyflie.fully_connected.add_callback(lambda uri: ready.set())
    crazyflie.open_link(flight.uri)
    try:
        assert ready.wait(10), "never fully connected"
        yield crazyflie
    finally:
        crazyflie.close_link()


def test_the_client_lists_every_parameter_and_log_variable_twice_in_a_row(flight):
    for _ in range(2):
        with connected(flight) as crazyflie:
            listed = {f"{g}.{n}" for g, names in crazyflie.param.toc.toc.items() for n in names}
            logged = {f"{g}.{n}" for g, names in crazyflie.log.toc.toc.items() for n in names}
    assert listed == {name for name, _ in PARAMETERS}
    assert logged == {name for name, *_ in VARIABLES}


def test_log_blocks_come_100_times_a_second_and_setpoints_fly_the_craft(flight):
    with connected(flight) as crazyflie:
        received: list[tuple[int, dict[str, float]]] = []
        enough = threading.Event()

        def arrived(stamp: int, values: dict[str, float], _: LogConfig) -> None:
            received.append((stamp, values))
            if len(received) >= 150:
                enough.set()

        log = LogConfig("live", 10)
        for name in ("stabilizer.thrust", "stabilizer.roll", "motor.m1", "pm.vbat", "gyro.x"):
            log.add_variable(name)
        crazyflie.log.add_config(log)
        log.data_received_cb.add_callback(arrived)
        log.start()

        def steered():
            crazyflie.commander.send_setpoint(0.0, 0.0, 0.0, 46000)
            return enough.wait(0.02)

        until(steered, "150 rows")
        steps = [b[0] - a[0] for a, b in itertools.pairwise(received)]
        assert statistics.median(steps) == 10
        assert received[-1][1]["stabilizer.thrust"] == 46000
        assert 30000 < received[-1][1]["motor.m1"] < 60000
        assert flight.craft.state().position_m[2] > 0.2
        assert flight.craft.state().rotor_rev_s[0] > 200


def test_a_client_that_falls_silent_is_levelled_and_stopped_in_the_firmwares_time(flight):
    with connected(flight) as crazyflie:
        crazyflie.commander.send_setpoint(8.0, 0.0, 0.0, 30000)
        until(lambda: flight.craft.state().thrust == 30000, "thrust")
        sent_s = flight.craft.time_s
        seen: dict[str, float] = {}

        def watch() -> None:
            now = flight.craft.time_s - sent_s
            if flight.craft._firmware[0]["setpoint"][0] == 0.0:
                seen.setdefault("level", now)
            if flight.craft.state().thrust == 0:
                seen.setdefault("stopped", now)

        flight.each_step = watch
        until(lambda: len(seen) == 2, "levelled and stopped")
        flight.each_step = lambda: None
    assert seen["level"] == pytest.approx(0.5, abs=0.1)
    assert seen["stopped"] == pytest.approx(2.0, abs=0.1)


def test_garbage_neither_stops_the_server_nor_fills_its_memory(flight):
    process = psutil.Process()
    address = ("127.0.0.1", flight.server.port)
    senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3 * MAX_CLIENTS)]
    senders[0].settimeout(10)
    sizes = (0, 1, 2, 15, 31, 32, 64, 1500, 9000)

    def flood(rounds: int) -> None:
        for number in range(rounds):
            sender = senders[number % len(senders)]
            sender.sendto(os.urandom(sizes[number % len(sizes)]), address)
            if number % 20 == 0:  # the kernel's buffer is not the subject: wait for an echo
                senders[0].sendto(b"\xff", address)
                while senders[0].recv(64) != b"\xff":
                    pass

    flood(10000)
    settled = process.memory_info().rss
    flood(60000)
    assert process.memory_info().rss - settled < 3e6
    assert len(flight.server._clients) <= MAX_CLIENTS
    assert flight.server.counts.received > 69000
    assert flight.server.counts.forgotten > 0
    for sender in senders:
        sender.close()
    with connected(flight) as crazyflie:
        assert crazyflie.param.values["pid_rate"]["roll_kp"] == "70.0"


def test_a_craft_whose_cell_is_empty_says_nothing():
    """It told of motors that turn for as long as somebody listened."""
    with served() as off, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(("127.0.0.1", off.server.port))
        client.settimeout(5)
        client.send(b"\xff")
        assert client.recv(64) == b"\xff"
        run_flat(off.craft)
        until(lambda: not off.craft.powered, "it is off")
        client.settimeout(0.5)
        client.send(b"\xff")
        with pytest.raises(TimeoutError):
            client.recv(64)


def test_a_port_that_is_taken_is_an_os_error(flight):
    async def second() -> None:
        server = CrtpServer(flight.craft, port=flight.server.port)
        with pytest.raises(OSError, match=r"[Aa]ddress"):
            await server.start()
        await server.close()
        await server.close()

    asyncio.run(second())
