"""The live twin in the daemon: fed from the stream, computed beside it, told as events."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.background import in_background
from groundstation.comparison.gap import CHANNELS
from groundstation.compiling import announced
from groundstation.dynamics.model import Model, load_model
from groundstation.errors import BadInputError
from groundstation.links.command import LinkEvent
from groundstation.telemetry.samples import SampleBatch

if TYPE_CHECKING:
    from groundstation.twin.twin import Episode, Shown, Twin

PERIOD_S = 0.25
"""How often the twin looks at what has come."""
ROWS_MOST = 30_000
"""A minute of telemetry waits while the twin is compiled; beyond that the oldest is dropped."""
PIECE_ROWS = 5000
CLOSE_S = 2.0
FAULTS_MOST = 3
SOURCE = "twin"
BEGAN, ENDED = "gap", "gap ended"
"""Kinds of events."""


class TwinService:
    """Feeds samples to a twin in a thread of its own; without a model it does nothing.

    tell: takes events. show: takes what is to be seen, twice a second of flight.
    """

    def __init__(
        self,
        model: str,
        *,
        tell: Callable[[LinkEvent], None],
        note: Callable[[str, str], None],
        show: Callable[[Shown], None],
    ) -> None:
        self.events = self.dropped = 0
        self._tell, self._note, self._show = tell, note, show
        self._waiting: deque[SampleBatch] = deque()
        self._rows = 0
        self._something = asyncio.Event()
        self._busy = asyncio.Lock()
        self._gap: list[float | None] | None = None
        self._text = ""
        self._learnt = False
        self._faults = 0  # in a row
        self._lasting: list[dict[str, Any]] = []  # disagreements, as told
        self._name = ""
        self._model: Model | None = None
        self._twin: Twin | None = None
        self._warm = False
        self._generation = 0
        if model:
            self._load(model)

    def configure(self, model: str) -> None:
        """Fly another model, or none, from the next sample on. Raises BadInputError, the present
        one flying on, where it cannot be flown."""
        if model:
            self._load(model)
        else:
            self._model, self._name = None, ""
        self.split()

    def split(self) -> None:
        """What follows comes from another craft."""
        if not self._busy.locked():  # otherwise a thread has it, whose work is of no interest
            self._end("the link or the model was changed")
        self._generation += 1
        self._faults = 0
        self._waiting.clear()
        self._rows = 0
        self._twin, self._gap, self._text = None, None, ""
        self._learnt, self._lasting = False, []

    def samples(self, batch: SampleBatch) -> None:
        """Queue samples; never waits."""
        if self._model is None or self._text:
            return
        self._waiting.append(batch)
        self._rows += len(batch)
        while self._rows > ROWS_MOST and len(self._waiting) > 1:
            oldest = self._waiting.popleft()
            self._rows -= len(oldest)
            self.dropped += len(oldest)
        self._something.set()

    def note(self, note: object) -> None:
        """Samples are all that it looks at."""

    @property
    def fullness(self) -> float:
        """How full the queue is, 0..1."""
        return self._rows / ROWS_MOST

    async def run(self) -> None:
        """For as long as the daemon runs."""
        while True:
            await self._something.wait()
            self._something.clear()
            # what a thread has begun goes on: the state of the twin is in its hands
            await asyncio.shield(asyncio.create_task(self.drain(), name="twin drain"))
            await asyncio.sleep(PERIOD_S if self.fullness < 0.1 else 0.0)

    async def drain(self) -> None:
        """Compute all that waits."""
        async with self._busy:
            while self._waiting and self._model is not None and not self._text:
                if not self._warm:
                    await self._warm_up(self._model)
                    continue
                await self._step(self._model)

    async def close(self) -> None:
        """Tell what there is to tell of what has come, within a moment."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_S):
                await asyncio.shield(asyncio.create_task(self.drain(), name="twin drain"))
                self._end("the daemon ended")
        self._model = None

    def status(self) -> dict[str, Any] | None:
        """None without a model; see ``requests.TwinStatus``."""
        if self._model is None:
            return None
        state = "failed" if self._text else "watching" if self._learnt else "learning"
        return {
            "state": state,
            "model": self._name,
            "gap": {} if self._gap is None else dict(zip(CHANNELS, self._gap, strict=True)),
            "disagreements": self._lasting,
            "events": self.events,
            "waiting": self._rows,
            "dropped": self.dropped,
            "text": self._text,
        }

    def _load(self, path: str) -> None:
        from groundstation.dynamics.craft import craft_of_model
        from groundstation.dynamics.model import require_body, require_fitted_body

        model = load_model(path)
        require_body(model)
        require_fitted_body(model, path)
        craft_of_model(model)
        self._model, self._name, self._warm = model, path, False

    async def _warm_up(self, model: Model) -> None:
        from groundstation.twin.twin import warm_up

        text = "preparing the twin, first start only: it is compiled once per machine"
        try:
            async with announced(lambda: self._note("preparing", text)):
                await in_background(lambda: warm_up(model))
            self._warm = True
        except Exception as error:  # whatever it is, the telemetry goes on
            self._give_up("fault", f"the twin cannot be prepared: {error!r}")

    async def _step(self, model: Model) -> None:
        from groundstation.twin.twin import Twin

        pieces: list[SampleBatch] = []
        rows = 0
        while self._waiting and (
            not pieces
            or (
                rows + len(self._waiting[0]) <= PIECE_ROWS
                and self._waiting[0].tick_s == pieces[0].tick_s
            )
        ):
            pieces.append(self._waiting.popleft())
            rows += len(pieces[-1])
        self._rows -= rows
        batch = SampleBatch.concatenate(pieces)
        generation, twin = self._generation, self._twin

        def work() -> tuple[Twin, list[tuple[Shown, list[Episode]]]]:
            beside = Twin(model) if twin is None else twin
            return beside, list(beside.feed(batch))

        try:
            beside, made = await in_background(work)
            if generation != self._generation:
                return  # of a craft that is gone
        except Exception as error:  # whatever it is, the telemetry goes on
            if generation == self._generation:
                self._failed(error)
            return
        self._twin, self._faults = beside, 0
        for shown, told in made:
            self._gap = [None if np.isnan(each) else round(float(each), 3) for each in shown.gap]
            self._show(shown)
            for episode in told:
                self._tell_of(episode)
        self._learnt = beside.learnt
        self._lasting = [_details(each) for each in beside.episodes]

    def _failed(self, error: Exception) -> None:
        """Begin anew with the next sample; give up where that is of no use."""
        self._twin, self._lasting, self._learnt = None, [], False
        self._faults += 1
        if isinstance(error, BadInputError):
            self._give_up("waiting", str(error))
        elif self._faults >= FAULTS_MOST:
            self._give_up("fault", f"the twin is given up: {error!r}")
        else:
            self._note("fault", f"the twin begins anew: {error!r}")

    def _give_up(self, kind: str, text: str) -> None:
        self._text = text
        self._waiting.clear()
        self._rows = 0
        self._note(kind, text)

    def _end(self, why: str) -> None:
        """Of every disagreement that lasts, tell that nothing more is known."""
        if self._twin is not None:
            for episode in self._twin.interrupt(why):
                self._tell_of(episode)
        self._lasting = []

    def _tell_of(self, episode: Episode) -> None:
        from groundstation.twin.twin import in_words

        kind = BEGAN if episode.end_s is None else ENDED
        self.events += kind == BEGAN
        details = {**_details(episode), "model": self._name}
        self._tell(LinkEvent(episode.host_ns, SOURCE, kind, in_words(episode), details))


def _details(episode: Episode) -> dict[str, Any]:
    from groundstation.twin.twin import LIMIT

    return {
        "channel": episode.place.channel,
        "regime": episode.place.regime,
        "statistic": round(episode.statistic, 2),
        "limit": LIMIT,
        "segment": episode.segment,
        "begin_s": round(episode.begin_s, 4),
        "noticed_s": round(episode.noticed_s, 4),
        "end_s": None if episode.end_s is None else round(episode.end_s, 4),
        "why": episode.why,
    }
