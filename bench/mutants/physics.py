"""Units and signs: what a number means."""

from bench.mutants.fault import Fault

_PACKET = "groundstation/telemetry/packet.py"
_PACKET_TESTS = "tests/telemetry/test_packet.py"
_MIXER = "groundstation/dynamics/mixer.py"
_MIXER_TESTS = "tests/dynamics/test_mixer.py"
_ROTATIONS = "groundstation/dynamics/rotations.py"
_ROTATION_TESTS = "tests/dynamics/test_rotations.py"
_GYROSCOPIC = "groundstation/dynamics/effects/rotor_gyroscopic_torque.py"
_COUPLING = "groundstation/dynamics/effects/inertia_coupling.py"
_LAWS = "tests/dynamics/effects/test_laws.py"
_MAP = "groundstation/recording/column_map.py"
_PLAN = "groundstation/recording/map_plan.py"
_MAPPED = "tests/recording/test_column_map.py"
_SIGNS = "leans_and_turns_as_commanded_in_the_signs_of_the_telemetry"
_LEANS = f"tests/service/test_commander.py::test_the_craft_{_SIGNS}"
_HOLDS = (
    "tests/links/test_crazyflie.py::test_a_craft_that_knows_its_height_holds_it_and_leans_and_turns"
    "_in_the_signs_of_the_telemetry"
)

FAULTS = (
    Fault(
        "pitch-nose-up",
        "pitch has the firmware's sign",
        "groundstation/telemetry/samples.py",
        "attitude[:, 1] *= -1  # the firmware's pitch is nose up positive",
        "attitude[:, 1] *= 1",
        (f"{_PACKET_TESTS}::test_the_golden_packet_in_physical_units",),
    ),
    Fault(
        "tick",
        "device time runs 1.4 % slow",
        _PACKET,
        "TICK_S = 73e-6 / 72",
        "TICK_S = 1e-6",
        (f"{_PACKET_TESTS}::test_a_sample_is_two_milliseconds_of_ticks",),
    ),
    Fault(
        "gyro-unit",
        "rates are 0.1 % too small",
        _PACKET,
        "GYRO_RAD_S = math.radians(1 / 16.384)",
        "GYRO_RAD_S = math.radians(1 / 16.4)",
        (f"{_PACKET_TESTS}::test_the_golden_packet_in_physical_units",),
    ),
    Fault(
        "accelerometer-in-g",
        "specific force is in g",
        _PACKET,
        "ACCELEROMETER_M_S2 = STANDARD_GRAVITY / 4096",
        "ACCELEROMETER_M_S2 = 1.0 / 4096",
        (f"{_PACKET_TESTS}::test_the_golden_packet_in_physical_units",),
    ),
    Fault(
        "motors-of-the-packet",
        "M1 and M2 are mixed up in the 48 bits",
        _PACKET,
        "counts[:, 0::2] = low | ((middle & 0x0F) << 8)",
        "counts[:, 0::2] = low | ((middle >> 4) << 8)",
        (f"{_PACKET_TESTS}::test_the_golden_packet_decodes_to_the_fields_of_the_real_log",),
    ),
    Fault(
        "armature-in-volts",
        "motors get a thousandth of their voltage",
        "groundstation/dynamics/motor.py",
        "supply_mv = 1000.0 * np.asarray(supply_v, np.float64)",
        "supply_mv = np.asarray(supply_v, np.float64)",
        ("tests/dynamics/test_motor.py::test_armature_voltage_is_duty_times_supply_in_mv",),
    ),
    Fault(
        "mixer-x-yaw",
        "an X craft yaws the other way",
        _MIXER,
        "[-1, 1, 1, -1], [-1, 1, -1, 1]]",
        "[-1, 1, 1, -1], [1, -1, 1, -1]]",
        (_MIXER_TESTS,),
        least=2,
    ),
    Fault(
        "mixer-plus-yaw",
        "a plus craft yaws the other way",
        _MIXER,
        "[-1, 0, 1, 0], [-1, 1, -1, 1]]",
        "[-1, 0, 1, 0], [1, -1, 1, -1]]",
        (_MIXER_TESTS,),
        least=2,
    ),
    Fault(
        "mixer-plus-roll",
        "a plus craft rolls the other way",
        _MIXER,
        "[[0, -1, 0, 1], ",
        "[[0, 1, 0, -1], ",
        (_MIXER_TESTS,),
        least=2,
    ),
    Fault(
        "mixer-x-pitch",
        "an X craft pitches the other way",
        _MIXER,
        "[[-1, -1, 1, 1], [-1, 1, 1, -1], ",
        "[[-1, -1, 1, 1], [1, -1, -1, 1], ",
        (_MIXER_TESTS,),
        least=2,
    ),
    Fault(
        "euler-kinematics",
        "a turning craft that leans is drawn leaning the other way",
        _ROTATIONS,
        "q * cr - r * sr, across",
        "q * cr + r * sr, across",
        (f"{_ROTATION_TESTS}::test_euler_rates_invert_body_rates",),
    ),
    Fault(
        "rotation-matrix",
        "nose down is drawn as nose up",
        _ROTATIONS,
        "        (-sp, cp * sr, cp * cr),",
        "        (sp, cp * sr, cp * cr),",
        (f"{_ROTATION_TESTS}::test_nose_down_is_a_positive_pitch_and_left_up_a_positive_roll",),
    ),
    Fault(
        "gyroscopic-sign",
        "spinning rotors push the craft to the wrong side",
        _GYROSCOPIC,
        "(momentum * q / craft.inertia[0], -momentum * p / craft.inertia[1], 0.0)",
        "(-momentum * q / craft.inertia[0], momentum * p / craft.inertia[1], 0.0)",
        (_LAWS,),
    ),
    Fault(
        "gyroscopic-in-rev-s",
        "rotors are as heavy as six of them",
        _GYROSCOPIC,
        "values[0] * 2.0 * math.pi * (-n1 + n2 - n3 + n4)",
        "values[0] * (-n1 + n2 - n3 + n4)",
        (_LAWS,),
    ),
    Fault(
        "coupling-sign",
        "a craft that yaws and pitches rolls the other way",
        _COUPLING,
        "share * (iyy - izz) * q * r / ixx,",
        "share * (izz - iyy) * q * r / ixx,",
        (_LAWS,),
    ),
    Fault(
        "commanded-yaw",
        "a craft turns the other way than commanded",
        "groundstation/links/crazyflie.py",
        "commander.send_setpoint(roll_deg, pitch_deg, -yaw_dps, thrust)",
        "commander.send_setpoint(roll_deg, pitch_deg, yaw_dps, thrust)",
        (_LEANS,),
    ),
    Fault(
        "commanded-pitch-at-a-height",
        "a craft that holds its height leans the other way than commanded",
        "groundstation/links/crazyflie.py",
        'struct.pack("<Bffff", kind, roll_deg, -pitch_deg, turn, height_m)',
        'struct.pack("<Bffff", kind, roll_deg, pitch_deg, turn, height_m)',
        (_HOLDS,),
    ),
    Fault(
        "map-without-signs",
        "the signs of a column map do nothing",
        _PLAN,
        "factor = UNITS[quantity][units[0]] * scale * column.sign",
        "factor = UNITS[quantity][units[0]] * scale",
        (f"{_MAPPED}::test_a_foreign_log_in_its_own_units_axes_and_signs",),
    ),
    Fault(
        "map-with-swapped-motors",
        "a foreign log's M1 and M2 are exchanged",
        _PLAN,
        'yield f"{quantity}.{name}", quantity, field, index, column',
        'yield f"{quantity}.{name}", quantity, field, index ^ (quantity == "duty"), column',
        (
            f"{_MAPPED}::test_a_foreign_log_in_its_own_units_axes_and_signs",
            f"{_MAPPED}::test_the_thesis_s_own_layout_through_a_map_is_what_the_csv_reader_says",
        ),
    ),
    Fault(
        "yaw-from-north",
        "a heading that counts from north is turned by half a turn",
        _MAP,
        "np.remainder(yaw + 1.5 * np.pi, math.tau) - np.pi",
        "np.remainder(yaw + 0.5 * np.pi, math.tau) - np.pi",
        (
            "tests/recording/test_other_programs.py::test_a_flight_is_recognised_and_read_as_what_it_was",
        ),
    ),
    Fault(
        "log-in-radians",
        "rates of a log in deg/s are taken for rad/s",
        "groundstation/recording/microsd_channels.py",
        'samples.gyro[:] = np.radians(gyro) if unit == "deg/s" else gyro',
        "samples.gyro[:] = gyro",
        (
            "tests/links/test_log_rows.py::test_blocks_of_the_same_moment_make_one_row_in_the_units_of_a_sample",
        ),
    ),
    Fault(
        "motors-a-row-late",
        "the motors of a row are those that act after it",
        "groundstation/links/log_rows.py",
        "        samples.duty[follows] = duty[follows]\n",
        "",
        ("tests/links/test_log_rows.py::test_the_motors_of_a_row_are_those_that_acted_before_it",),
    ),
    Fault(
        "accelerometer-pitch",
        "the accelerometer says nose up where the nose is down",
        "groundstation/attitude/sensors.py",
        "np.arctan2(-x, np.hypot(y, z))",
        "np.arctan2(x, np.hypot(y, z))",
        ("tests/attitude/test_sensors.py::test_gravity_shows_roll_and_pitch_whatever_the_yaw",),
    ),
)
