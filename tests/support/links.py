"""What every link promises, as tests: subclass ``LinkContract`` and say how to make one.

A link under contract is without loss: whatever its source sends arrives, in ``copies`` copies.
"""

import asyncio
import itertools

import numpy as np
import pytest

from groundstation.errors import BadInputError, LinkEndedError, LinkError
from groundstation.links.base import LinkState
from groundstation.links.command import steady_clock
from groundstation.telemetry.decoder import Decoder
from groundstation.telemetry.samples import COLUMNS, RawBatch, SampleBatch, empty_samples
from support.waiting import PATIENCE_S

SPAN_NS = 200_000_000
"""Telemetry that a test reads before it judges."""


async def read_span(link, span_ns=SPAN_NS):
    """Batches until ``span_ns`` of host time is covered or the source ends."""
    batches = []
    async with asyncio.timeout(PATIENCE_S):
        while not batches or batches[-1].host_time_ns[-1] - batches[0].host_time_ns[0] < span_ns:
            try:
                batch = await link.read()
            except LinkEndedError:
                break
            if batch is not None:
                batches.append(batch)
    return batches


async def read_to_end(link):
    """Every batch of a finite source."""
    return await read_span(link, span_ns=1 << 62)


async def packets_read(link, count):
    """Read until ``count`` packets have come; all of them."""
    batches, came = [], 0
    async with asyncio.timeout(PATIENCE_S):
        while came < count:
            batch = await link.read()
            if batch is not None:
                batches.append(batch)
                came += len(batch)
    return joined(batches)


def joined(batches):
    return type(batches[0]).concatenate(batches)


def span_of(link, span_ns=SPAN_NS):
    """Open the link, read for so long, close it."""

    async def session():
        async with link:
            return await read_span(link, span_ns)

    return asyncio.run(session())


def listen(link):
    """The link's events, as they come."""
    events = []
    link.on_event = events.append
    return events


class LinkContract:
    """Subclasses set the constants and override ``make``.

    copies: of each sample. kind: of its batches.
    bad: link name, stand-in options and what the one-line refusal must mention.
    """

    copies = 4
    kind: type = RawBatch
    bad: tuple = ()

    def make(self, tmp_path):
        """A new, closed link to a source without loss, at normal speed."""
        raise NotImplementedError

    def open_wrongly(self, name, options):
        """Make and open a link that cannot work."""
        raise NotImplementedError

    @pytest.fixture
    def link(self, tmp_path):
        return self.make(tmp_path)

    def test_events_tell_opening_streaming_and_closing_in_this_order(self, link):
        events = listen(link)

        async def session():
            assert link.state is LinkState.CLOSED
            await link.open()
            assert link.state is LinkState.OPENING
            await read_span(link)
            await link.close()
            assert link.state is LinkState.CLOSED

        asyncio.run(session())
        kinds = [event.kind for event in events if event.kind in set(LinkState)]
        begun = [kind for kind in kinds if kind not in ("silent", "ended")][:2]
        assert begun == ["opening", "streaming"]
        assert kinds[-1] == "closed"
        assert kinds.count("opening") == kinds.count("closed") == 1
        stamps = [event.time_ns for event in events]
        assert stamps == sorted(stamps)
        assert {event.link for event in events} == {link.name}

    def test_batches_have_the_shapes_and_types_of_the_interface(self, link):
        for batch in span_of(link):
            assert type(batch) is self.kind
            assert len(batch) > 0
            assert batch.host_time_ns.shape == (len(batch),)
            assert batch.host_time_ns.dtype == np.int64
            if isinstance(batch, RawBatch):
                assert batch.packets.shape == (len(batch), 32)
                assert batch.packets.dtype == np.uint8
            else:
                like = empty_samples(len(batch))
                for name in COLUMNS:
                    assert getattr(batch, name).shape == getattr(like, name).shape, name
                    assert getattr(batch, name).dtype == getattr(like, name).dtype, name

    def test_host_stamps_never_run_backwards_and_are_never_early(self, link):
        async def session():
            opened_ns = link.clock()
            async with link:
                async with asyncio.timeout(PATIENCE_S):
                    stamps = np.empty(0, np.int64)
                    while len(stamps) == 0 or stamps[-1] - stamps[0] < SPAN_NS:
                        try:
                            batch = await link.read()
                        except LinkEndedError:
                            break
                        if batch is not None:
                            stamps = np.append(stamps, batch.host_time_ns)
                            assert stamps[-1] <= link.clock(), "a stamp from the future"
                return opened_ns, stamps

        opened_ns, stamps = asyncio.run(session())
        assert (np.diff(stamps) >= 0).all()
        assert stamps[0] >= opened_ns

    def test_a_cancelled_read_loses_nothing(self, link):
        """The silence limit and a daemon that stops both cancel reads at any moment."""

        async def session():
            async with link:
                batches = []
                async with asyncio.timeout(PATIENCE_S):
                    for turns in itertools.cycle((0, 1, 2, 3, 5, 8, 13, 21)):
                        reading = asyncio.create_task(link.read())
                        for _ in range(turns):
                            await asyncio.sleep(0)
                        if turns == 21:
                            await asyncio.wait([reading], timeout=0.003)
                        cancelled = reading.cancel()
                        done = (await asyncio.gather(reading, return_exceptions=True))[0]
                        if cancelled:  # never swallowed, or a daemon could not stop
                            assert isinstance(done, asyncio.CancelledError), done
                        elif isinstance(done, LinkEndedError):
                            break
                        else:
                            batches.append(done)
                        covered = batches and (
                            batches[-1].host_time_ns[-1] - batches[0].host_time_ns[0]
                        )
                        if covered and covered > SPAN_NS:
                            break
                return batches

        self.require_complete(asyncio.run(session()))

    def test_the_silence_limit_loses_nothing(self, link):
        link.silence_s = 0.001
        self.require_complete(span_of(link))

    def require_complete(self, batches):
        """No sample is missing, and none of the copies of those in the middle."""
        stream = joined(batches)
        if isinstance(stream, SampleBatch):
            steps = np.diff(stream.ticks)
            assert len(steps) > 50
            assert steps.max() < 1.5 * np.median(steps)
            return
        decoder = Decoder()
        samples = joined([decoder.decode(stream).samples, decoder.finish().samples])
        assert len(samples) > 50
        assert decoder.counts().lost == 0
        assert (samples.copies[1:-1] == self.copies).all()

    def test_two_full_cycles_both_deliver(self, link):
        events = listen(link)
        first, second = (joined(span_of(link)) for _ in range(2))
        assert len(first) > 50
        assert len(second) > 50
        assert second.host_time_ns[0] >= first.host_time_ns[0]
        assert [event.kind for event in events].count("closed") == 2

    def test_closing_twice_or_before_opening_is_harmless(self, link):
        events = listen(link)

        async def session():
            await link.close()
            await link.open()
            await link.close()
            await link.close()

        asyncio.run(session())
        assert [event.kind for event in events] == ["opening", "closed"]

    def test_a_fault_in_the_users_code_closes_the_link(self, link):
        async def session():
            async with link:
                raise RuntimeError

        with pytest.raises(RuntimeError):
            asyncio.run(session())
        assert link.state is LinkState.CLOSED

    def test_a_closed_link_refuses_to_be_read_in_one_line(self, link):
        async def read_closed():
            with pytest.raises(LinkError, match="not open"):
                await link.read()
            async with link:
                pass
            with pytest.raises(LinkError, match="not open"):
                await link.read()

        asyncio.run(read_closed())

    def test_opening_an_open_link_is_refused_and_leaves_it_working(self, link):
        async def session():
            async with link:
                with pytest.raises(LinkError, match="open already"):
                    await link.open()
                return await read_span(link)

        assert len(joined(asyncio.run(session()))) > 50

    def test_wrong_options_are_refused_in_one_line_that_names_them(self, tmp_path):
        assert self.bad
        for name, options, mentions in self.bad:
            with pytest.raises(BadInputError) as refused:
                self.open_wrongly(name.format(tmp_path=tmp_path), options)
            assert mentions in str(refused.value)
            assert "\n" not in str(refused.value)

    def test_stamps_come_from_the_clock_that_was_given(self, link):
        """The daemon gives all its parts one clock."""
        real = steady_clock()
        link.clock = lambda: real() + 3_600_000_000_000
        stamps = joined(span_of(link, 20_000_000)).host_time_ns
        assert stamps[0] - real() > 3_500_000_000_000


class FiniteLinkContract(LinkContract):
    """A link whose source ends by itself, soon."""

    def test_reading_past_the_end_says_so_again(self, link):
        events = listen(link)

        async def session():
            async with link:
                await read_to_end(link)
                for _ in range(2):
                    with pytest.raises(LinkEndedError, match="the end of"):
                        await link.read()
                    assert link.state is LinkState.ENDED

        asyncio.run(session())
        assert [event.kind for event in events][-2:] == ["ended", "closed"]
