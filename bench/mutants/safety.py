"""What keeps motors from running when they must not."""

from bench.mutants.fault import Fault

_COMMANDER = "groundstation/service/commander.py"
_LEASE = "groundstation/service/lease.py"
_STOP = "groundstation/service/motor_stop.py"
_ON_A_CLOCK = "tests/safety/test_stop_on_a_clock.py"
_LINK = "groundstation/links/command.py"
_CRAZYFLIE = "groundstation/links/crazyflie.py"

FAULTS = (
    Fault(
        "dead-man-levels",
        "a craft whose client fell silent keeps leaning",
        _LEASE,
        ">= limits.level_s",
        ">= float('inf')",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "dead-man-stops",
        "a craft whose client fell silent flies on",
        _LEASE,
        "self.flies and now_s - self.setpoint_s >= limits.stop_s",
        "False",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "dead-man-hears-words",
        "a client that sends anything keeps motors running without setpoints",
        _LEASE,
        "self.setpoint_s, self.levelled = ",
        "self.setpoint_s, self.levelled = float('inf'), False; _ = ",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "lease-never-ends",
        "a silent client on the ground keeps everybody else from commanding",
        _LEASE,
        "elif lease.has_lapsed(now_s, limits):",
        "elif False:",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "two-clients-command",
        "a second client takes the craft from the first",
        _LEASE,
        'raise TakenError(f"{self.present.client} is commanding; one client at a time")',
        "pass",
        ("tests/service/test_commander.py::test_two_clients_cannot_both_command",),
    ),
    Fault(
        "stale-setpoint",
        "after the daemon stood still an old setpoint flies the craft on",
        "groundstation/service/freshness.py",
        "if self._stands(now_s) or now_s < self._until_s:",
        "if False:",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "end-leaves-motors",
        "a client that releases the craft, or the daemon's end, leaves motors running",
        _LEASE,
        "if lease.flies or (lease.flew and self._turns()):",
        "if False:",
        ("tests/service/test_commander.py::test_a_daemon_that_ends_stops_the_motors_first",),
    ),
    Fault(
        "operator-cannot-stop",
        "who commanded goes on after the operator has stopped the motors",
        _COMMANDER,
        'self.leases.end(text, kind="stop", why=BY_OPERATOR)',
        "pass",
        (_ON_A_CLOCK,),
        least=2,
    ),
    Fault(
        "hold-level-ignored",
        "the operator levels the craft and its client leans it all the same",
        _COMMANDER,
        "            roll_deg = pitch_deg = yaw_dps = 0.0",
        "            yaw_dps = 0.0",
        (
            "tests/service/test_commander.py::test_an_operator_holds_the_craft_level_and_leaves_the_thrust_to_the_client",
        ),
    ),
    Fault(
        "rate-limit",
        "a client floods the radio with setpoints",
        "groundstation/service/limits.py",
        "        if self._left < 1.0:\n            return False",
        "        if self._left < 0.0:\n            return False\n        self._left = self._burst",
        (f"{_ON_A_CLOCK}::test_a_hundred_setpoints_a_second_pass_and_a_thousand_do_not",),
    ),
    Fault(
        "zero-thrust-not-repeated",
        "one lost packet, and the craft never hears that it has to stop",
        _STOP,
        "repeat and self._settles(now_s):",
        "False:",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "escalation-never-comes",
        "motors that turn on after a stop are left to turn",
        _STOP,
        "elif said_s > STILL_S * (stop.forced + 1):",
        "elif False:",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "escalation-without-disarm",
        "motors that turn on after a stop are not disarmed",
        _STOP,
        "stop.forced == 1 and ",
        "False and ",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "escalation-without-emergency-stop",
        "motors that turn on after they were disarmed are not stopped by the firmware",
        _STOP,
        "stop.forced > 1 and ",
        "False and ",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "stopped-too-early",
        "what the craft said of its motors before the stop is taken for its answer",
        _STOP,
        "said_s > 0.0 and said.duty <= 0.0",
        "said.duty <= 0.0",
        (_ON_A_CLOCK,),
    ),
    Fault(
        "emergency-stop-on-another-port",
        "the emergency stop goes where this firmware does not listen",
        _CRAZYFLIE,
        "EMERGENCY if self._connection.protocol < SUPERVISED else SUPERVISED_STOP",
        "EMERGENCY if self._connection.protocol >= SUPERVISED else SUPERVISED_STOP",
        (
            "tests/links/test_crazyflie.py::test_an_emergency_stop_locks_the_craft_of_either_supervisor",
        ),
    ),
    Fault(
        "thrust-without-limit",
        "more thrust than the firmware allows is sent",
        _LINK,
        "if not 0 <= thrust <= THRUST_MOST:",
        "if not 0 <= thrust:",
        (
            "tests/links/test_crazyflie.py::test_a_setpoint_that_is_not_sane_is_refused_before_it_is_sent",
        ),
    ),
    Fault(
        "lean-that-is-no-number",
        "NaN is sent to the craft as its attitude",
        _LINK,
        "if not (math.isfinite(value) and abs(value) <= most):",
        "if abs(value) > most:",
        (
            "tests/links/test_crazyflie.py::test_a_setpoint_that_is_not_sane_is_refused_before_it_is_sent",
        ),
    ),
    Fault(
        "gain-without-limit",
        "a controller gets a gain that no craft should get",
        _LINK,
        'if name.startswith("pid_") and not 0 <= value <= GAIN_MOST:',
        "if False:",
        (
            "tests/links/test_crazyflie.py::test_unknown_parameters_and_values_that_no_craft_should_get_are_refused",
        ),
    ),
    Fault(
        "arms-in-trouble",
        "a craft that says what is wrong with it is armed",
        "groundstation/service/arming.py",
        "if on and link.supervisor.trouble:",
        "if False:",
        (
            "tests/service/test_arming.py::test_a_craft_that_says_what_is_wrong_with_it_is_not_even_asked_to_arm",
        ),
    ),
    Fault(
        "stand-in-flies-a-real-craft",
        "who watches a simulated flight flies a real craft",
        "groundstation/service/craft_links.py",
        'if is_stand_in(link.name) and not self.command_uri.startswith("udp://"):',
        "if False:",
        (
            "tests/service/test_commander.py::test_where_no_craft_can_be_commanded_a_client_is_told_why",
        ),
    ),
    Fault(
        "bits-of-the-supervisor",
        "a craft that has crashed is taken for one that is locked, and the other way round",
        "groundstation/links/supervisor.py",
        "(1 << place for place in (5, 6, 7, 11))",
        "(1 << place for place in (5, 7, 6, 11))",
        ("tests/links/test_supervisor.py",),
    ),
    Fault(
        "flight-goes-on-blind",
        "a programme flies on without telemetry",
        "groundstation/control/programme.py",
        "    if not age <= limits.silent_s:",
        "    if age > 10.0 * limits.silent_s:",
        ("tests/control/test_programme.py",),
    ),
    Fault(
        "stick-cannot-stop",
        "the gamepad's button stops and the stick starts again",
        "groundstation/cli/sticks.py",
        "thrust=0 if self._hands.stop else round(",
        "thrust=round(",
        ("tests/cli/test_sticks.py",),
    ),
)
