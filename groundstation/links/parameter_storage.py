"""What a craft keeps of its parameters while it is switched off.

Firmware of 2022 and later has a memory for them and loads it when it is switched on, over the
values that its image was built with. The requests are those of CRTP port 2, channel 3: a command
and the parameter's number, 16 bits, little-endian, which the answer repeats.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from groundstation.errors import BadInputError, LinkError

MISC = (2, 3)
"""Port and channel."""
STORE, GET_STATE, CLEAR = 3, 4, 5
STORED, NOT_STORED = 1, 0
READS_S, WRITES_S = 1.0, 3.0
"""How long an answer is waited for: a memory that is full is tidied up before it is written."""

Ask = Callable[[bytes, float], Awaitable[bytes | None]]
"""Sends a request, up to so many s; what its answer has behind the request's own bytes, or None."""


@dataclass(frozen=True, slots=True)
class StoredValue:
    """A parameter that can be stored. default: of the firmware. stored: None where nothing is."""

    default: float
    stored: float | None

    @property
    def loaded(self) -> float:
        """What it is after the next power-on."""
        return self.default if self.stored is None else self.stored


class ParameterStorage:
    """That of one connected craft.

    numbers: of each parameter that can be stored, by full name, its number and the format of its
    value (``struct``). states: of those that were read. trouble: why the others were not, or empty.
    """

    def __init__(self, uri: str, numbers: Mapping[str, tuple[int, str]], ask: Ask) -> None:
        self.uri, self.numbers = uri, dict(numbers)
        self.states: dict[str, StoredValue] = {}
        self.trouble = ""
        self._ask = ask

    def require(self, name: str) -> None:
        """Raises BadInputError for a parameter that cannot be stored."""
        if name not in self.numbers:
            raise BadInputError(
                f"parameter {name} cannot be stored: this craft's firmware forgets it when it is"
                " switched off"
            )

    async def read(self, name: str) -> StoredValue:
        """Ask what is stored. Raises LinkError where the craft does not say."""
        answer = await self._asked(GET_STATE, name, READS_S)
        state = state_in(answer, self.numbers[name][1])
        if state is None:
            raise LinkError(f"{self.uri}: the craft does not say what it has stored of {name}")
        self.states[name] = state
        return state

    async def store(self, name: str, value: float) -> None:
        """Store the present value and read it back. value: what that is.

        Raises LinkError where the craft does not confirm it."""
        self.states.pop(name, None)
        if (await self._asked(STORE, name, WRITES_S))[:1] != b"\0":
            raise LinkError(
                f"{self.uri}: the craft refused to store {name}; its memory may be full"
            )
        state = await self.read(name)
        if state.stored is None or not math.isclose(state.stored, value, rel_tol=1e-6):
            raise LinkError(f"{self.uri}: {name} is stored as {state.stored}, not as {value:g}")

    async def clear(self, name: str) -> None:
        """Forget what is stored, if anything is, and read that back: the parameter is what it is
        until the next power-on. Raises LinkError where the craft does not confirm it."""
        self.states.pop(name, None)
        await self._asked(CLEAR, name, WRITES_S)
        if (await self.read(name)).stored is not None:
            raise LinkError(f"{self.uri}: the craft did not clear what it has stored of {name}")

    async def _asked(self, command: int, name: str, patience_s: float) -> bytes:
        self.require(name)
        answer = await self._ask(request(command, self.numbers[name][0]), patience_s)
        if answer is None:
            raise LinkError(
                f"{self.uri}: no answer about the stored value of {name} within {patience_s:g} s;"
                " try again"
            )
        return answer


def request(command: int, number: int) -> bytes:
    """What asks for something of a parameter."""
    return struct.pack("<BH", command, number)


def state_in(answer: bytes, form: str) -> StoredValue | None:
    """What the answer to ``GET_STATE`` says, behind the request's bytes; None for a refusal or an
    answer that is none. form: of the value, as ``<f``."""
    if not answer or answer[0] not in (STORED, NOT_STORED):
        return None
    size, is_stored = struct.calcsize(form), answer[0] == STORED
    if len(answer) < 1 + size * (1 + is_stored):
        return None
    (default,) = struct.unpack_from(form, answer, 1)
    stored = struct.unpack_from(form, answer, 1 + size)[0] if is_stored else None
    return StoredValue(float(default), None if stored is None else float(stored))
