"""Today's firmware as the official client library meets it: its own examples, not a mock."""

from __future__ import annotations

import errno
import itertools
import statistics
import struct
from collections.abc import Iterator

import cflib.crtp
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crazyflie.syncLogger import SyncLogger

from firmware_sim.contents import U8, U16
from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.crtp import (
    APPEND,
    CREATE,
    CREATE_V2,
    GET_INFO,
    GET_ITEM,
    RESET,
    START,
    START_V2,
    Conversation,
)
from support.crafts import ServedCraft, served
from support.plant import craft_after
from support.waiting import until


@pytest.fixture(scope="module")
def craft() -> Iterator[ServedCraft]:
    with served(craft="crazyflie21", plant="reduced", rotor_speed_deck=True) as running:
        yield running


@pytest.fixture
def connected(craft: ServedCraft) -> Iterator[SyncCrazyflie]:
    cflib.crtp.init_drivers()
    with SyncCrazyflie(craft.uri, cf=Crazyflie()) as crazyflie:
        yield crazyflie


def test_the_logging_example_of_the_library_reads_the_units_of_the_firmware(connected, craft):
    log = LogConfig("example", period_in_ms=10)
    for name in ("gyro.x", "acc.z", "stabilizer.roll", "stateEstimate.qw", "pm.vbat", "motor.m1"):
        log.add_variable(name)
    log.add_variable("rpm.m1", "uint16_t")
    with SyncLogger(connected, log) as logger:
        entries = list(itertools.islice(logger, 20))
    stamps = [stamp for stamp, _, _ in entries]
    assert statistics.median(b - a for a, b in itertools.pairwise(stamps)) == 10
    stamp, values, _ = entries[-1]
    said = craft.craft.logged(stamp)
    assert values["gyro.x"] == pytest.approx(said.gyro_dps[0], abs=1e-3)
    assert values["acc.z"] == pytest.approx(1.0, abs=0.1)
    assert values["pm.vbat"] == pytest.approx(said.battery_v, abs=1e-4)
    assert 3.5 < values["pm.vbat"] < 4.3
    assert values["stateEstimate.qw"] == pytest.approx(1.0, abs=0.01)
    assert values["motor.m1"] == values["rpm.m1"] == 0


def test_the_step_by_step_example_chooses_an_estimator_and_another(connected, craft):
    heard = []
    connected.wait_for_params()
    connected.cf.param.add_update_callback(
        "stabilizer", "estimator", lambda name, value: heard.append(value)
    )
    for number in ("2", "1"):
        connected.cf.param.set_value("stabilizer.estimator", number)
        until(lambda number=number: heard[-1:] == [number], "it is told")
        assert craft.craft.get_parameter("stabilizer.estimator") == float(number)


def test_the_library_is_told_protocol_and_device(connected, craft):
    assert connected.cf.platform.get_protocol_version() == craft.craft.protocol == 10


@pytest.fixture(scope="module")
def standing() -> StandIn:
    stand_in = craft_after(3.0, craft="crazyflie21", program="wait", plant="reduced")
    return stand_in


@pytest.fixture
def client(standing: StandIn) -> Conversation:
    return Conversation(standing)


def asked(client: Conversation, command: int, number: int, data: bytes = b"") -> int:
    (answer,) = client.answer(bytes([0x5D, command, number]) + data)
    assert answer[:3] == bytes([0x5D, command, number])
    return answer[3]


def place(client: Conversation, name: str) -> bytes:
    return struct.pack("<BH", 7, [n for n, *_ in client.contents.variables].index(name))


def test_periods_below_10_ms_are_kept_to_the_millisecond(client, standing):
    assert asked(client, CREATE_V2, 1, place(client, "gyro.x")) == 0
    assert asked(client, START_V2, 1, struct.pack("<H", 2)) == 0
    start = standing.uptime_ms
    stamps = [int.from_bytes(p[2:5], "little") for p in client.due(start + 100)]
    assert stamps == list(range(start + 2, start + 100, 2))


@pytest.mark.parametrize("step_s", [0.01, 0.5])
def test_a_packet_holds_the_pass_of_its_stamp_however_the_craft_is_flown_on(step_s):
    """The clock shows the pass to come, whose values nobody has yet."""
    settings = StandInSettings(craft="crazyflie21", plant="reduced", truth=True)
    craft = StandIn(settings)
    craft.advance(6.0)
    client = Conversation(craft)
    assert asked(client, CREATE_V2, 1, place(client, "gyro.x")) == 0
    assert asked(client, START_V2, 1, struct.pack("<H", 2)) == 0
    packets, lasting = [], round(2.0 / step_s)
    for _ in range(lasting):
        craft.advance(craft.time_s + step_s)
        packets += client.due(craft.uptime_ms)
    late = StandIn(settings)
    late.advance(craft.time_s)
    said = [struct.unpack("<f", p[5:])[0] for p in packets]
    times = [int.from_bytes(p[2:5], "little") for p in packets]
    meant = [late.logged(time_ms).gyro_dps[0] for time_ms in times]
    assert len(set(meant[-500:])) > 50
    assert said[-500:] == pytest.approx(meant[-500:], rel=1e-6)


def test_blocks_started_at_different_moments_keep_their_distance(client, standing):
    for number in (1, 2):
        assert asked(client, CREATE_V2, number, place(client, "gyro.x")) == 0
        assert asked(client, START_V2, number, struct.pack("<H", 10)) == 0
        standing.advance(standing.time_s + 0.004)
    times = [
        (p[1], int.from_bytes(p[2:5], "little") % 10) for p in client.due(standing.uptime_ms + 99)
    ]
    assert len(set(times)) == 2


def test_limits_and_errors_are_those_of_the_firmware(client):
    gyro = place(client, "gyro.x")
    assert asked(client, CREATE_V2, 0, gyro * 6) == 0
    assert asked(client, CREATE_V2, 0, gyro) == errno.EEXIST
    assert asked(client, CREATE_V2, 1, gyro * 7) == errno.E2BIG
    assert asked(client, CREATE_V2, 2, struct.pack("<BH", 7, 999)) == errno.ENOENT
    assert asked(client, START_V2, 77, b"\x01\x00") == errno.ENOENT
    assert asked(client, 9, 3, b"\x07\x00") == errno.ENOEXEC
    for number in range(3, 16):
        assert asked(client, CREATE_V2, number, gyro) == 0
    assert asked(client, CREATE_V2, 16, gyro) == errno.ENOMEM
    assert asked(client, RESET, 0) == 0
    byte = gyro[:0] + b"\x01" + gyro[1:]
    for number in range(16):
        assert asked(client, CREATE_V2, number, byte * 8) == 0
    assert asked(client, 7, 0, byte) == errno.ENOMEM


def test_a_craft_that_restarts_has_forgotten_its_blocks():
    settings = StandInSettings(craft="crazyflie21", plant="reduced", charge=0.0, recharge_s=0.1)
    craft = StandIn(settings)
    craft.advance(0.5)
    client = Conversation(craft)
    assert asked(client, CREATE_V2, 1, place(client, "gyro.x")) == 0
    assert asked(client, START_V2, 1, struct.pack("<H", 10)) == 0
    assert client.due(craft.uptime_ms + 100)
    while craft.boots == 1:
        craft.advance(craft.time_s + 1.0)
    assert client.due(craft.uptime_ms + 100) == []


def test_an_older_release_sends_its_motors_in_32_bits():
    kinds = {
        protocol: {
            name: kind
            for name, kind, _ in Conversation(
                StandIn(StandInSettings(craft="brushless", program="wait", protocol=protocol))
            ).contents.variables
        }["motor.m1"]
        for protocol in (7, 8)
    }
    assert kinds == {7: 3, 8: 2}


def test_firmware_built_to_run_in_software_repeats_a_request_to_arm_and_does_not_say_what_it_is():
    """As that of April 2024 does: whether a craft is armed only its log says."""
    craft = craft_after(3.0, craft="brushless", protocol=7, software_build=True)
    talk = Conversation(craft)
    assert talk.answer(b"\xd0\x01\x01") == [b"\xd0\x01\x01"]
    craft.advance(3.2)
    assert not craft.state().armed
    assert talk.answer(b"\xd1\x01") == [b"\xd1\x012023.11"]
    assert talk.answer(b"\xd1\x02") == []
    kinds = {name: kind for name, kind, _ in talk.contents.variables}
    assert not [name for name in kinds if name.startswith(("pm.", "pwm."))]
    assert kinds["motor.m1"] == U16
    assert not [name for name, _ in talk.contents.parameters if name.startswith("deck.")]


def logged_as_in_2014(craft: StandIn) -> list[bytes]:
    """What a client that knows only the commands of 2014 is answered: table, block, start."""
    client = Conversation(craft)
    table = client.answer(bytes([0x50, GET_INFO]))
    if not table:
        return []
    items = [client.answer(bytes([0x50, GET_ITEM, number]))[0] for number in range(table[0][2])]
    (place,) = [n for n, item in enumerate(items) if item[4:] == b"gyro\0z\0"]
    kind = items[place][3]
    create = client.answer(bytes([0x51, CREATE, 3, kind, place]))
    append = client.answer(bytes([0x51, APPEND, 3, kind, place]))
    start = client.answer(bytes([0x51, START, 3, 2]))
    craft.advance(craft.time_s + 0.1)
    return [*create, *append, *start, *client.due(craft.uptime_ms)]


@pytest.mark.parametrize("protocol", [7, 10])
def test_the_log_commands_of_2014_work_as_well_until_2026(protocol: int) -> None:
    craft = craft_after(2.0, craft="crazyflie21", plant="reduced", protocol=protocol)
    create, append, start, *packets = logged_as_in_2014(craft)
    assert [create[1:], append[1:], start[1:]] == [
        bytes([command, 3, 0]) for command in (CREATE, APPEND, START)
    ]
    stamps = [int.from_bytes(packet[2:5], "little") for packet in packets]
    assert {b - a for a, b in itertools.pairwise(stamps)} == {20}
    values = struct.unpack("<ff", packets[-1][5:])
    said = craft.logged(stamps[-1]).gyro_dps[2]
    assert values == pytest.approx((said, said), abs=1e-4)
    client = Conversation(craft)
    assert client.answer(bytes([0x20, GET_INFO])) == [bytes([0x20, GET_INFO, 0, 0, 0])]
    assert client.answer(bytes([0x20, GET_ITEM, 5])) == [bytes([0x20, GET_ITEM])]


def test_from_2026_on_the_log_commands_of_2014_are_gone() -> None:
    craft = craft_after(2.0, craft="crazyflie21", plant="reduced", protocol=12)
    assert logged_as_in_2014(craft) == []
    client = Conversation(craft)
    for command in (CREATE, APPEND):
        (answer,) = client.answer(bytes([0x51, command, 3, 7, 0]))
        assert answer[-1] == errno.ENOEXEC
    assert client.answer(bytes([0x20, GET_INFO])) == []


def test_a_number_that_does_not_fit_is_cut_to_its_lowest_bytes() -> None:
    craft = craft_after(2.0, craft="crazyflie21", plant="reduced")
    client = Conversation(craft)
    place = [name for name, *_ in client.contents.variables].index("pm.vbatMV")
    ask = struct.pack("<BHBH", U16, place, U8, place)
    assert asked(client, CREATE_V2, 1, ask) == 0
    assert asked(client, START_V2, 1, b"\x05\x00") == 0
    craft.advance(craft.time_s + 0.1)
    whole, cut = struct.unpack("<HB", client.due(craft.uptime_ms)[-1][5:])
    assert whole > 3000
    assert cut == whole % 256
