"""How a flight ends, whoever ends it: the craft is landed, or its motors are stopped at once."""

from __future__ import annotations

import math
from collections.abc import Callable

from groundstation.errors import BadInputError, TakenError
from groundstation.links.command import CommandLink
from groundstation.service.arming import Asking
from groundstation.service.lander import LANDS, Descent, Lander, refusal
from groundstation.service.lease import Lease
from groundstation.service.motor_stop import Motors, Note, Stop, Stopping

FRESH_S, RESTS_S = 0.5, 1.5
"""How old what a craft says of its motors may be, where they must stand, and how long ago they must
have been asked to turn: the radio may have taken that late."""
LATE_S = 1.7
"""So long after the last setpoint nothing is landed: the firmware stops the motors after 2 s, and
nobody knows where a craft is that fell. A daemon that stood still comes so late."""


class FlightEnd:
    """The landing and the stop that go on. Who uses it holds a lock.

    motors: what the telemetry says of the motors of a craft, None where it does not. note: told
    (kind, text). asking: what is asked of the craft besides, which a stop ends. clock: monotonic,
    s. held: why no motor may begin, in words, or empty.
    """

    def __init__(
        self,
        motors: Callable[[CommandLink], Motors | None],
        note: Note,
        asking: Asking,
        clock: Callable[[], float],
    ) -> None:
        self.stopping = Stopping(motors, note, clock)
        self.lander = Lander(note, self.stopping.ask, clock)
        self._note, self._asking, self._clock = note, asking, clock
        self._motors, self.held, self._begun_s = motors, "", -math.inf

    @property
    def doing(self) -> str:
        """What is going on, in words, or empty."""
        if self.lander.runs:
            return LANDS
        return "the motors are being stopped" if self.stopping.runs else self.held

    def begun(self) -> None:
        """Motors are asked to turn."""
        self._begun_s = self._clock()

    def drives(self, link: CommandLink | None) -> bool:
        """Whether the craft says that its motors turn, and nobody lands it."""
        return link is not None and self._duty(link) > 0.0 and not self.lander.runs

    def turns(self, link: CommandLink) -> bool:
        """Whether motors turn, as far as the craft says."""
        return link.supervisor.flies or self._duty(link) > 0.0

    def _duty(self, link: CommandLink) -> float:
        said = self._motors(link)
        return 0.0 if said is None else said.duty

    def is_still(self, link: CommandLink) -> bool:
        """Whether the craft itself says just now that its motors stand and that it does not fly,
        and nothing is going on that may turn them."""
        said = self._motors(link)
        stands = said is not None and said.age_s <= FRESH_S and said.duty == 0.0
        late = self._clock() - self._begun_s < RESTS_S
        goes_on = link.supervisor.flies or self.lander.runs or self.stopping.runs
        return stands and not (late or goes_on)

    def require_none(self, refused: str) -> None:
        """Raises TakenError while one goes on. refused: what then was not done."""
        if self.doing:
            raise TakenError(f"{self.doing}: {refused}")

    def goes_on(self, now_s: float) -> bool:
        """Whether one is not over, or zero thrust has to go on."""
        return self.lander.runs or self.stopping.goes_on(now_s)

    def look(self, now_s: float, *, repeat: bool) -> None:
        """Do what the time demands. repeat: whether nobody else sends setpoints."""
        self.lander.look(now_s)
        self.stopping.look(now_s, repeat=repeat and not self.lander.runs)

    def stop(self, link: CommandLink, lease: Lease | None, client: str) -> Stop:
        """Stop the motors at once, in the name of ``client``; lease: that in force."""
        self._asking.end()
        stop = self.stopping.ask(link, client)
        self.lander.cancel(stop)
        if lease is not None:
            lease.set_down()
            lease.stop, lease.descent = stop, None
        return stop

    def land(self, link: CommandLink, lease: Lease | None, client: str) -> Descent | Stop:
        """Land the craft that flies for a lease, in the name of ``client``; a landing that runs
        goes on. Where none flies no motor is begun, for the craft may be in somebody's hand: they
        are stopped.

        Raises BadInputError where it cannot be landed, TakenError while its motors are being
        stopped."""
        descent = self.lander.present
        if descent is None:
            if self.stopping.runs:
                raise TakenError("the motors are being stopped: there is nothing to land")
            if trouble := refusal(link, self._clock()):
                raise BadInputError(f"{trouble}: it cannot be landed, its motors can be stopped")
            if lease is None or not lease.flies:
                return self.stop(link, lease, client)
            self._asking.end()
            self.stopping.cancel()
            descent = self.lander.begin(link, client, lease.height_m)
        if lease is not None:
            lease.set_down()
            lease.descent = descent
        return descent

    def land_or_stop(self, link: CommandLink, lease: Lease) -> None:
        """As its client wishes: land its craft, or stop its motors where that cannot be."""
        try:
            self.land(link, lease, lease.client)
        except BadInputError as error:
            self._note("fault", str(error))
            self.stop(link, lease, lease.client)
        except TakenError:  # they are being stopped
            lease.descent = None

    def give_up(self) -> None:
        """The craft is left: who waits for what becomes of it is told that nobody knows."""
        self.lander.cancel()
        self.stopping.give_up()

    def end(self, link: CommandLink | None, lease: Lease, client: str) -> bool:
        """End what runs for a lease that is over; whether the craft is landed."""
        if link is None:
            return False
        if lease.descent is not None and not lease.descent.over:
            return True
        now_s = self._clock()
        is_late = now_s - lease.setpoint_s > LATE_S
        if lease.flies and not (is_late or self.stopping.runs or refusal(link, now_s, waits=True)):
            self.land(link, lease, client)
            return True
        self.stop(link, lease, client)
        return False
