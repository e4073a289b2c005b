"""A flight written as other programs write it: in their axes, units, orders and containers."""

import struct
import zlib

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from groundstation.telemetry.packet import STANDARD_GRAVITY

PX4_MOTOR = (0, 2, 3, 1)
"""Ours in PX4's order: front right, rear left, front left, rear right."""
BETAFLIGHT_MOTOR = (1, 0, 2, 3)
"""Rear right, front right, rear left, front left."""
UNIX_NS = 1_790_000_000_000_000_000
LOG_TYPE = "crazyflie_interfaces/msg/LogDataGeneric"
FIXED = 0xFFFF


def quaternion_of(roll, pitch, yaw):
    """(n, 4), w first, of angles about z, then y, then x, each by the right-hand rule."""
    (cr, cp, cy), (sr, sp, sy) = (
        [one(angle / 2) for angle in (roll, pitch, yaw)] for one in (np.cos, np.sin)
    )
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def write_cfclient(path, samples, extra=True):
    """A log block with text as ``str`` makes it, stamps in ms, and pitch nose up."""
    columns = {f"gyro.{a}": np.degrees(samples.gyro[:, i]) for i, a in enumerate("xyz")}
    columns |= {
        f"acc.{a}": samples.accelerometer[:, i] / STANDARD_GRAVITY for i, a in enumerate("xyz")
    }
    columns |= {f"motor.m{m + 1}": np.rint(samples.duty[:, m] * 65535) for m in range(4)}
    if extra:
        angles = np.degrees(samples.attitude) * [1, -1, 1]
        names = ("roll", "pitch", "yaw")
        columns |= {f"stabilizer.{name}": angles[:, i] for i, name in enumerate(names)}
        columns["pm.vbat"] = samples.battery_v
    stamps = np.rint(samples.time_s * 1000).astype(int)
    rows = zip(stamps.tolist(), *(one.tolist() for one in columns.values()), strict=True)
    lines = [",".join(["Timestamp", *columns]), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def write_betaflight(path, samples, pwm=False):
    """As blackbox_decode 0.4 does: spaces behind commas, flags as words, whole numbers."""
    header = (
        "loopIteration, time (us), axisP[0], setpoint[0], setpoint[1], setpoint[2], setpoint[3], "
        "vbatLatest (V), gyroADC[0], gyroADC[1], gyroADC[2], accSmooth[0], accSmooth[1], "
        "accSmooth[2], motor[0], motor[1], motor[2], motor[3], flightModeFlags (flags), "
        "failsafePhase (flags)"
    )
    low, span = (1000, 1000) if pwm else (48, 1999)
    gyro = np.rint(np.degrees(samples.gyro)).astype(int)
    force = np.rint(samples.accelerometer / STANDARD_GRAVITY * 2048).astype(int)
    motors = np.rint(low + samples.duty[:, BETAFLIGHT_MOTOR] * span).astype(int)
    lines = [header]
    for row in range(len(samples)):
        numbers = [row, round(samples.time_s[row] * 1e6), 0, 0, 0, 0, 0]
        rest = [*gyro[row], *force[row], *motors[row]]
        battery = f"{samples.battery_v[row]:.3f}"
        cells = [*map(str, numbers), battery, *map(str, rest), "ANGLE_MODE", "IDLE"]
        lines.append(", ".join(cells))
    path.write_text("\n".join(lines) + "\n")


def write_ulog(
    path, samples, motors="actuator_motors", motors_late_us=0, parameters=None, dropouts_ms=()
):
    """By the public specification of the format: formats, subscriptions, then data as it came."""
    kinds = {
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
        "battery_status": "uint64_t timestamp;float voltage_v;",
        "actuator_motors": "uint64_t timestamp;float[12] control;",
        "actuator_outputs": "uint64_t timestamp;float[16] output;",
    }

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    out += [message("F", f"{name}:{fields}".encode()) for name, fields in kinds.items()]
    for name, value in {"THR_MDL_FAC": 0, **(parameters or {})}.items():
        key = f"int32_t {name}".encode()
        out.append(message("P", struct.pack("<B", len(key)) + key + struct.pack("<i", value)))
    names = ["sensor_combined", "vehicle_attitude", "battery_status", motors]
    out += [message("A", struct.pack("<BH", 0, n) + name.encode()) for n, name in enumerate(names)]
    down = np.array([1, -1, -1])
    roll, pitch, yaw = samples.attitude.astype(np.float64).T
    attitude = quaternion_of(roll, -pitch, np.pi / 2 - yaw)
    commands = samples.duty[:, PX4_MOTOR]
    if motors == "actuator_outputs":
        commands = 1000 + 1000 * commands
    room = 12 if motors == "actuator_motors" else 16
    for row, stamp_us in enumerate(np.rint(samples.time_s * 1e6).astype(int)):
        sensors = [*(samples.gyro[row] * down), *(samples.accelerometer[row] * down)]
        rest = [float("nan")] * (room - 4)
        for number, values in enumerate(
            (sensors, attitude[row], [samples.battery_v[row]], [*commands[row], *rest])
        ):
            if number != 2 or row % 50 == 0:
                late_us = motors_late_us if number == 3 else 0
                body = struct.pack(f"<HQ{len(values)}f", number, stamp_us + late_us, *values)
                out.append(message("D", body))
    out += [message("O", struct.pack("<H", one)) for one in dropouts_ms]
    path.write_bytes(b"".join(out))


def _imu(named, header, samples, row, attitude=(1.0, 0.0, 0.0, 0.0)):
    """sensor_msgs/Imu of one row. attitude: w, x, y, z."""
    vector = named["geometry_msgs/msg/Vector3"]
    w, x, y, z = attitude
    return named["sensor_msgs/msg/Imu"](
        header,
        named["geometry_msgs/msg/Quaternion"](x, y, z, w),
        np.zeros(9),
        vector(*map(float, samples.gyro[row])),
        np.zeros(9),
        vector(*map(float, samples.accelerometer[row])),
        np.zeros(9),
    )


def write_ros1(path, samples):
    """A bag of ROS 1 with one IMU."""
    types = get_typestore(Stores.ROS1_NOETIC)
    named = types.types
    with Writer1(path) as bag:
        imu = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=types)
        for row, time_s in enumerate(samples.time_s):
            stamp_ns = UNIX_NS + round(time_s * 1e9)
            stamp = named["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
            one = _imu(named, named["std_msgs/msg/Header"](row, stamp, "body"), samples, row)
            bag.write(imu, stamp_ns, types.serialize_ros1(one, imu.msgtype))


def write_service_events(path, samples):
    """An MCAP bag in which ROS 2 also recorded a service's events, whose type no library parses."""
    from mcap.writer import Writer as McapWriter

    types = get_typestore(Stores.ROS2_HUMBLE)
    named = types.types
    definition, _ = types.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    event = "int8 REQUEST=0\n===\nMSG: my_interfaces/srv/Arm_Event\nthis is : none\n---\nbool ok"
    with path.open("wb") as file:
        bag = McapWriter(file)
        bag.start(profile="ros2", library="libmcap 0.8")
        channels = [
            bag.register_channel(name, "cdr", bag.register_schema(kind, "ros2msg", text.encode()))
            for name, kind, text in (
                ("/imu", "sensor_msgs/msg/Imu", definition),
                ("/arm/_service_event", "my_interfaces/srv/Arm_Event", event),
            )
        ]
        for row, time_s in enumerate(samples.time_s):
            stamp_ns = UNIX_NS + round(time_s * 1e9)
            one = _imu(named, _header(named, stamp_ns), samples, row)
            data = bytes(types.serialize_cdr(one, "sensor_msgs/msg/Imu"))
            bag.add_message(channels[0], stamp_ns, data, stamp_ns)
        bag.add_message(channels[1], stamp_ns, b"\0\1\0\0\0", stamp_ns)
        bag.finish()


def write_ros2(folder, samples, storage):
    """sensor_msgs of one IMU at every row and of the battery every second."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    named = types.types
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    roll, pitch, yaw = samples.attitude.astype(np.float64).T
    attitude = quaternion_of(roll, pitch, yaw)
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        imu = bag.add_connection("/drone/imu", "sensor_msgs/msg/Imu", typestore=types)
        battery = bag.add_connection("/drone/bat", "sensor_msgs/msg/BatteryState", typestore=types)
        words = bag.add_connection("/rosout", "std_msgs/msg/String", typestore=types)
        for row, time_s in enumerate(samples.time_s):
            stamp_ns = UNIX_NS + round(time_s * 1e9)
            late_ns = stamp_ns + 1_000_000 * (row % 7)
            header = _header(named, stamp_ns)
            one = _imu(named, header, samples, row, attitude[row])
            bag.write(imu, late_ns, types.serialize_cdr(one, imu.msgtype))
            if row % 500 == 0:
                nan, none = float("nan"), np.zeros(0, np.float32)
                volts = float(samples.battery_v[row])
                one = named["sensor_msgs/msg/BatteryState"](
                    *(header, volts, nan, nan, nan, nan, nan, nan, 0, 0, 0, True, none, none),
                    *("", ""),
                )
                bag.write(
                    battery, late_ns, types.serialize_cdr(one, "sensor_msgs/msg/BatteryState")
                )
                text = named["std_msgs/msg/String"]("hovering")
                bag.write(words, late_ns, types.serialize_cdr(text, "std_msgs/msg/String"))


def write_crazyswarm2(folder, samples, robots=("cf231",)):
    """Custom log topics as the server publishes them, heard up to 6 ms late."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    definition = "std_msgs/Header header\nuint32 timestamp\nfloat32[] values\n"
    types.register(get_types_from_msg(definition, LOG_TYPE))
    angles = np.degrees(samples.attitude) * [1, -1, 1]
    blocks = {
        "imu": np.column_stack(
            [np.degrees(samples.gyro), samples.accelerometer / STANDARD_GRAVITY]
        ),
        "motors": np.column_stack([np.rint(samples.duty * 65535), samples.battery_v * 1000]),
        "angles": angles,
    }
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        topics = {
            (robot, name): bag.add_connection(f"/{robot}/{name}", LOG_TYPE, typestore=types)
            for robot in robots
            for name in blocks
        }
        heard = UNIX_NS + np.rint(samples.time_s * 1e9).astype(np.int64)
        heard = np.maximum.accumulate(heard + 1_000_000 * (3 * np.arange(len(samples)) % 7))
        for row, time_s in enumerate(samples.time_s):
            for (_, name), topic in topics.items():
                heard_ns = int(heard[row])
                values = blocks[name][row].astype(np.float32)
                one = types.types[LOG_TYPE](
                    _header(types.types, heard_ns), round(time_s * 1000), values
                )
                bag.write(topic, heard_ns, types.serialize_cdr(one, LOG_TYPE))


def _header(named, stamp_ns):
    stamp = named["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return named["std_msgs/msg/Header"](stamp, "body")


def header_bytes(events, version=2):
    """``events``: id -> (name, {variable: struct letter})."""
    parts = [struct.pack("<BHH", 0xBC, version, len(events))]
    for number, (name, variables) in events.items():
        parts.append(struct.pack("<H", number) + name.encode() + b"\0")
        parts.append(struct.pack("<H", len(variables)))
        parts += [
            f"{variable}({letter})".encode() + b"\0" for variable, letter in variables.items()
        ]
    return b"".join(parts)


def record_bytes(events, number, time, values, version=2):
    """One record; ``time`` in the version's own unit (ms or us)."""
    letters = "".join(events[number][1].values())
    return struct.pack("<H" + ("I" if version == 1 else "Q") + letters, number, time, *values)


def log_bytes(events, records, version=2):
    """A whole file; ``records``: (id, time, values)."""
    body = header_bytes(events, version)
    body += b"".join(record_bytes(events, *record, version) for record in records)
    return body + struct.pack("<I", zlib.crc32(body))
