"""The laws of effects as compiled code: at each stage one chain of all listed ones.

A chain asks of each effect whether it acts; those that do not cost a branch. A user's own effects
are a chain of the same make, compiled when a model names them and called by address, so that
the kernels around them stay cached.

Every chain is called alike: (e, craft, given, x, z) -> (x, slopes), with the effects' values e, the
stage's inputs ``given``, what is passed on x, and the states z with their slopes, tuples
(``dynamics/effect.py`` says what these are at each stage).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, get_type_hints

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import carray, types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.extending import intrinsic, register_jitable

from groundstation.compiled import callback, called, inner, spliced
from groundstation.dynamics import effect as laws
from groundstation.dynamics.effect import (
    STATE_SLOTS,
    VALUE_SLOTS,
    Body,
    Craft,
    Effect,
    Motor,
    Reading,
    Supply,
)
from groundstation.dynamics.registry import EFFECTS, at_stage
from groundstation.errors import BadInputError

for function in (
    laws.to_inertial,
    laws.to_body,
    laws.rotor_wrench,
    laws.butterworth_slopes,
    laws.butterworth_behind,
):
    register_jitable(function)  # laws may call them
GIVEN: dict[str, Any] = {
    "supply": Supply,
    "motor": Motor,
    "rotor": Body,
    "body": Body,
    "sensor": Body,
}
PASSED: dict[str, str] = {
    "supply": "x[0]",
    "motor": "x[0]",
    "rotor": "(x[0], x[1], x[2], x[3])",
    "body": "((x[0], x[1], x[2]), (x[3], x[4], x[5]))",
    "sensor": "Reading((x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7], x[8], x[9]))",
}
"""x of each stage, made of numbers in a row."""
NUMBERS = {"supply": 1, "motor": 1, "rotor": 4, "body": 6, "sensor": 10}
ARGUMENTS = {
    "supply": "craft, given, x",
    "motor": "given, x",
    "rotor": "craft, given, x",
    "body": "craft, given",
    "sensor": "craft, given, x",
}


@inner
def summed(one: Any, other: Any) -> Any:
    """Accelerations that two effects add, together."""
    return (
        (one[0][0] + other[0][0], one[0][1] + other[0][1], one[0][2] + other[0][2]),
        (one[1][0] + other[1][0], one[1][1] + other[1][1], one[1][2] + other[1][2]),
    )


@inner
def reckoned(body: Any, x: Any) -> Any:
    """A body with the accelerations that are known until now."""
    return Body(
        body.height,
        body.quaternion,
        body.velocity,
        body.rate,
        body.rotor,
        body.rotor_slope,
        body.thrust,
        x[0],
        x[1],
    )


def _compile(name: str, source: Iterable[str], pieces: dict[str, Any]) -> Any:
    names = {"Body": Body, "Reading": Reading, "summed": summed, "reckoned": reckoned, **pieces}
    exec("\n".join(source), names)
    return inner(names[name])


def _steps(effects: Sequence[Effect], values: Callable[[int], str], guarded: bool) -> list[str]:
    """Lines that apply the laws of a stage, one after the other; slopes go to s0, s1, ..."""
    found, state = [], 0
    for index, effect in enumerate(effects):
        pad = "    "
        if guarded:
            found.append(f"    if e[{index}][0] != 0.0:")
            pad = "        "
        stage, count = effect.stage, len(effect.states)
        if stage == "body" and effect.order > 0:
            found.append(f"{pad}given = reckoned(given, x)")
        states = "".join(f"z[{state + i}], " for i in range(count))
        more = f", ({states})" if count else ""
        call = f"law{index}({values(index)}, {ARGUMENTS[stage]}{more})"
        if stage == "body":
            slots = "t, f, s" if count else "t, f"
            found += [f"{pad}{slots} = {call}", f"{pad}x = summed(x, (t, f))"]
        else:
            found.append(f"{pad}{'x, s' if count else 'x'} = {call}")
        found += [f"{pad}s{state + i} = s[{i}]" for i in range(count)]
        state += count
    return found


def states_of(effects: Sequence[Effect]) -> int:
    """How many states effects have together."""
    return sum(len(effect.states) for effect in effects)


@cache
def chain(stage: str) -> Any:
    """The listed effects' chain: e holds, for each, (1.0 where it acts, values)."""
    effects = at_stage(stage)
    count = states_of(effects)
    source = [
        f"def {stage}_chain(e, craft, given, x, z):",
        *(f"    s{i} = 0.0" for i in range(count)),
        *_steps(effects, lambda index: f"e[{index}][1]", guarded=True),
        f"    return x, ({', '.join(f's{i}' for i in range(count)) or '0.0'},)",
    ]
    pieces = {f"law{i}": inner(effect.law) for i, effect in enumerate(effects)}
    return _compile(f"{stage}_chain", source, pieces)


@cache
def state_access(stage: str) -> Any:
    """((array, first) -> the listed effects' states of a stage as a tuple, and the way back)."""
    count = states_of(at_stage(stage))
    names: dict[str, Any] = {}
    numbers = "".join(f"array[first + {i}], " for i in range(count)) or "0.0,"
    exec(f"def read(array, first):\n    return ({numbers})", names)
    lines = "\n".join(f"    array[first + {i}] = z[{i}]" for i in range(count)) or "    pass"
    exec(f"def write(array, first, z):\n{lines}", names)
    return spliced(names["read"]), spliced(names["write"])


@cache
def loader(*stages: str) -> Any:
    """(craft record) -> e of each of ``stages``, by value."""
    source = ["def load(c):", "    return ("]
    for stage in stages:
        source.append("        (")
        for effect in at_stage(stage):
            numbers = "".join(f"c.{effect.name}[{i + 1}], " for i in range(len(effect.parameters)))
            source.append(f"            (c.{effect.name}[0], ({numbers})),")
        source.append("        ),")
    source.append("    )")
    return _compile("load", source, {})


# A user's own effects.


def _unpacked(kind: Any, array: str, start: int) -> tuple[str, int]:
    """Source of a named tuple made of an array's numbers from ``start`` on, and how many."""
    place, parts = start, []
    for hint in get_type_hints(kind).values():
        size = len(getattr(hint, "__args__", ()))
        if size:
            parts.append(f"({', '.join(f'{array}[{place + i}]' for i in range(size))})")
        else:
            parts.append(f"{array}[{place}]")
        place += size or 1
    return f"{kind.__name__}({', '.join(parts)})", place - start


def _packing(kind: Any, name: str, array: str, start: int) -> tuple[list[str], int]:
    """Lines that store a named tuple's numbers, and how many they are."""
    place, lines = start, []
    for field, hint in get_type_hints(kind).items():
        size = len(getattr(hint, "__args__", ()))
        parts = [f"{name}.{field}[{i}]" for i in range(size)] or [f"{name}.{field}"]
        for part in parts:
            lines.append(f"    {array}[{place}] = {part}")
            place += 1
    return lines, place - start


@intrinsic
def call_law(typing: Any, address: Any, values: Any, given: Any, x: Any) -> Any:
    """Call the chain at ``address`` with the data of three float64 arrays."""
    arrays = (values, given, x)
    if not isinstance(address, types.Integer) or not all(
        isinstance(one, types.Array) and one.dtype == types.float64 for one in arrays
    ):
        return None
    signature = types.void(address, *arrays)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer] * 3)
        target = builder.inttoptr(arguments[0], function.as_pointer())
        data = [
            cgutils.create_struct_proxy(kind)(context, builder, value=value).data
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        ]
        builder.call(target, [builder.bitcast(one, pointer) for one in data])
        return context.get_dummy_value()

    return signature, codegen


@cache
def own_chain(stage: str) -> Any:
    """(address, values, craft, given, x, y, dy, first) -> x of a stage's own effects, whose states
    are y[first:] with slopes dy[first:].

    The numbers go to an array, followed by the states; x comes back with their slopes behind it.
    """
    count, states = NUMBERS[stage], STATE_SLOTS if stage in ("body", "sensor") else 0
    craft, size = _packing(Craft, "craft", "a", 0)
    given, more = _packing(GIVEN[stage], "given", "a", size)
    source = [
        "def own(address, values, craft, given, x, y, dy, first):",
        f"    a, b = np.empty({size + more + states}), np.zeros({count + states})",
        f"    v = np.empty({VALUE_SLOTS})",
        *(f"    v[{i}] = values[{i}]" for i in range(VALUE_SLOTS)),
        *craft,
        *given,
        *_stored(stage),
    ]
    if states:
        source += [f"    for i in range({states}):", f"        a[{size + more} + i] = y[first + i]"]
    source.append("    call_law(address, v, a, b)")
    if states:
        source += [f"    for i in range({states}):", f"        dy[first + i] = b[{count} + i]"]
    source.append(f"    return {PASSED[stage].replace('x[', 'b[')}")
    names = {"np": np, "call_law": call_law, "Reading": Reading}
    exec("\n".join(source), names)
    return called(names["own"])


@cache
def own_address(stage: str, effects: tuple[Effect, ...], first: tuple[int, ...]) -> int:
    """Address of the compiled chain of own effects, whose values begin at ``first`` each.

    Raises BadInputError for a law that numba cannot compile, or that returns something else.
    """
    states = STATE_SLOTS if stage in ("body", "sensor") else 0
    craft, size = _unpacked(Craft, "a", 0)
    given, more = _unpacked(GIVEN[stage], "a", size)

    def values(index: int) -> str:
        numbers = (f"values[{first[index] + i}]" for i in range(len(effects[index].parameters)))
        return f"({', '.join(numbers)},)"

    # A chain of listed effects is cached, under a name that tells it from every other.
    listed = all(EFFECTS.get(effect.name) is effect for effect in effects)
    entry = "_".join(("own", stage, *(effect.name for effect in effects), *map(str, first)))
    source = [
        f"def {entry}(v, given_at, x_at):",
        f"    values, a = carray(v, {VALUE_SLOTS}), carray(given_at, {size + more + states})",
        f"    b = carray(x_at, {NUMBERS[stage] + states})",
        f"    craft, given, z = {craft}, {given}, a[{size + more}:]",
        f"    x = {PASSED[stage].replace('x[', 'b[')}",
        *(f"    s{i} = 0.0" for i in range(states)),
        *_steps(effects, values, guarded=False),
        *_stored(stage),
        *(f"    b[{NUMBERS[stage] + i}] = s{i}" for i in range(states)),
    ]
    pieces = {f"law{i}": inner(effect.law) for i, effect in enumerate(effects)}
    names = {**vars(laws), "carray": carray, "summed": summed, "reckoned": reckoned, **pieces}
    exec(compile("\n".join(source), __file__, "exec"), names)
    pointer = types.CPointer(types.float64)
    try:
        signature = types.void(pointer, pointer, pointer)
        compiled = callback(names[entry], signature, cached=listed)
    except NumbaError as error:
        said = ", ".join(effect.name for effect in effects)
        reason = str(error).strip().splitlines()[-1]
        raise BadInputError(f"effect law of {said}: cannot be compiled: {reason}") from error
    _KEPT.append(compiled)
    return int(compiled.address)


def _stored(stage: str) -> list[str]:
    """Lines that store x to b."""
    parts = {
        "supply": ["x"],
        "motor": ["x"],
        "rotor": [f"x[{i}]" for i in range(4)],
        "body": [f"x[{i // 3}][{i % 3}]" for i in range(6)],
        "sensor": [f"x[{i // 3}][{i % 3}]" for i in range(6)] + [f"x[2][{i}]" for i in range(4)],
    }[stage]
    return [f"    b[{i}] = {part}" for i, part in enumerate(parts)]


_KEPT: list[Any] = []
"""Compiled chains live as long as the process: their addresses are in records of plain numbers."""
