"""What an operator may do to the craft, whoever commands it."""

from __future__ import annotations

import threading
import time

from groundstation.errors import BadInputError, TakenError
from groundstation.service.arming import Asking, ask_to_arm, ask_to_recover
from groundstation.service.command_connection import CommandConnection
from groundstation.service.flight_end import FlightEnd
from groundstation.service.lander import outcome_of
from groundstation.service.lease import Leases
from groundstation.service.motor_stop import BY_OPERATOR, LANDED_BY_OPERATOR, Note, Stop, outcome
from groundstation.service.readiness import Readiness

OPERATOR = "operator"


class Operator:
    """stops: counts every Stop and every Land, and is no number of an earlier daemon: a program
    that began before the last of them does not command again. What does not wait is safe to call
    from any thread."""

    def __init__(
        self,
        lock: threading.RLock,
        connection: CommandConnection,
        leases: Leases,
        end: FlightEnd,
        asking: Asking,
        ready: Readiness,
        note: Note,
    ) -> None:
        self.stops = time.time_ns() // 1_000_000
        self._lock, self._connection, self._leases = lock, connection, leases
        self._end, self._asking, self._ready, self._note = end, asking, ready, note

    async def stop(self) -> str:
        """Stop the motors, whoever commands, and end that lease: the operator's way out. What the
        craft then says of them, in words: ``STOPPED`` where they stand. It ends a landing, too.

        Motors that do not stop are asked again, disarmed and stopped by the firmware, as after any
        stop."""
        with self._lock:
            self.stops += 1
            self._asking.end()  # whatever became of the connection
            link = self._connection.require_connected("the stop was not sent")
            stop = self._end.stop(link, self._leases.present, OPERATOR)
            text = f"the operator stops the motors; {self._former_client()}"
            self._leases.end(text, kind="stop", why=BY_OPERATOR)
        return await outcome(stop)

    async def land(self) -> str:
        """Land the craft, whoever commands, and end that lease. ``LANDED``, or what the craft then
        says of its motors, also where nobody flew it: they are stopped then.

        Raises BadInputError for a craft that holds no height, or leans too far, or does not say
        where it is; TakenError while its motors are being stopped."""
        with self._lock:
            link = self._connection.require_connected("the craft was not landed")
            ended = self._end.land(link, self._leases.present, OPERATOR)
            self.stops += 1
            text = f"the operator lands the craft; {self._former_client()}"
            self._leases.end(text, kind="stop", why=LANDED_BY_OPERATOR)
        return await (outcome(ended) if isinstance(ended, Stop) else outcome_of(ended))

    def level(self, on: bool) -> None:
        """Whether attitude and yaw rate of every setpoint are replaced by zero, the client's thrust
        or height kept; until it is switched off or the lease is over. Raises BadInputError where
        nobody commands."""
        lease = self._leases.present
        if lease is None:
            raise BadInputError("nobody commands: there is nothing to hold level")
        if on is not lease.held_level:
            lease.held_level = on
            what = "holds the craft level" if on else "gives the attitude back"
            self._note("level", f"the operator {what}; {lease.client} commands")

    async def arm(self, on: bool) -> None:
        """Arm the motors or disarm them, whoever commands, and wait for the craft's answer.

        Raises BadInputError for a firmware that knows no arming, LinkError where it refuses or
        does not answer, TakenError where a stop or another such request came in between."""
        self._connection.require()
        if on:
            self._ready.require_craft("be armed")
            self._ready.require_calm("the motors were not armed")
            self._end.begun()
        await ask_to_arm(self._connection.require_connected(), on, self._asking.begin())
        kind, does = ("armed", "arms") if on else ("disarmed", "disarms")
        self._note(kind, f"the operator {does} the motors")

    async def recover(self) -> None:
        """Let a craft that calls itself crashed be ready again, and wait until it says so.

        Raises BadInputError for one that has not crashed, TakenError while a client asks for
        thrust, LinkError where it does not recover."""
        lease = self._leases.present
        if lease is not None and lease.flies:
            raise TakenError(f"{lease.client} asks for thrust: motors might turn at once")
        self._ready.require_craft("recover")
        self._ready.require_calm("the craft was not asked to recover")
        await ask_to_recover(self._connection.require_connected(), self._asking.begin())
        self._note("recovered", "the operator has had the craft recover from its crash")

    def _former_client(self) -> str:
        client = self._leases.client
        return "nobody commanded" if client is None else f"{client} commands no more"
