"""What others wrote, read within bounds: regular files only, of limited length and depth."""

from __future__ import annotations

import difflib
import errno
import os
import re
import stat
from pathlib import Path
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")

DOCUMENT_MOST = 64 << 20
"""Bytes. The largest of ours is a model with its covariance: well below one MiB."""
TOML_MOST = 1 << 20
DEPTH_MOST = 32
"""Of lists and tables in one another; ours go six deep. Python recurses about 1000 deep."""

_TOO_DEEP = f"nested deeper than {DEPTH_MOST}"
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_TOML_TOKEN = (
    rf"""(?P<long>(?:{_PART}[ \t]*+\.[ \t]*+){{{DEPTH_MOST}}})"""
    r"""|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?|[\w-]++"""
)
_JSON_TOKEN = rb'(?s:"(?:[^"\\]++|\\.)*+"?|[\[{]|[\]}])'


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """A descriptor of a regular file. Raises OSError, at once, for a pipe, device or folder."""
    descriptor = os.open(path, flags | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return descriptor
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "Not a regular file", str(path))


def read_document(path: Path, most: int = DOCUMENT_MOST) -> bytes:
    """The content of a regular file. Raises OSError, also where it is longer than ``most``."""
    with open(open_regular(path), "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"Longer than {most} bytes", str(path))
    return content


def decode_json(content: bytes | bytearray | memoryview | str, kind: type[T]) -> T:
    """JSON as ``kind``. Raises ValueError, also where it is nested too deep."""
    content = content.encode() if isinstance(content, str) else bytes(content)
    require_shallow(content)
    try:
        return msgspec.json.decode(content, type=kind)
    except msgspec.ValidationError as error:
        raise ValueError(explained(error, kind)) from error
    except msgspec.DecodeError as error:
        raise ValueError(str(error)) from error


def require_shallow(content: bytes) -> None:
    """Raises ValueError for JSON that is nested too deep."""
    if content.count(b"[") + content.count(b"{") <= DEPTH_MOST:  # it cannot be
        return
    depth = 0
    for token in re.finditer(_JSON_TOKEN, content):
        depth += {b"[": 1, b"{": 1, b"]": -1, b"}": -1}.get(token[0], 0)
        if depth > DEPTH_MOST:
            raise ValueError(_TOO_DEEP)


def decode_toml(content: bytes, kind: type[T]) -> T:
    """TOML as ``kind``. Raises ValueError, also where it is too long or nested too deep."""
    import tomllib  # no command line needs it to show its help

    if len(content) > TOML_MOST:
        raise ValueError(f"longer than {TOML_MOST} bytes")
    text = content.decode("utf-8")
    # tomllib takes time in the square of the number of a dotted key's parts
    if any(token["long"] for token in re.finditer(_TOML_TOKEN, text)):
        raise ValueError(_TOO_DEEP)
    try:
        table = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    level: list[Any] = [table]
    for _ in range(DEPTH_MOST):
        level = [inner for outer in level for inner in _inside(outer)]
    if level:
        raise ValueError(_TOO_DEEP)
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise ValueError(explained(error, kind)) from error


def explained(error: msgspec.ValidationError, kind: Any) -> str:
    """What msgspec says of a value that is no ``kind``, and what there is instead."""
    text = str(error)
    place = re.search(r" - at `\$(.*)`$", text)
    at: Any = msgspec.inspect.type_info(kind)
    for name in re.findall(r"\w+", place[1]) if place else ():
        at = _part(at, name)
    unknown = re.search(r"unknown field `([^`]*)`", text)
    if unknown and isinstance(at, msgspec.inspect.StructType):
        names = [field.encode_name for field in at.fields]
        near = difflib.get_close_matches(unknown[1], names, 1)
        return (
            f"{text}: did you mean {near[0]}?" if near else f"{text}: there are {', '.join(names)}"
        )
    values = _choices(at)
    return f"{text}: there are {', '.join(map(str, values))}" if values else text


def seems(content: bytes) -> str:
    """What a document that was taken for another probably is, in words to end an error with."""
    start = content.lstrip()[:1]
    if start == b"{":
        what = "a model file, for --model" if b'"motor"' in content else "JSON"
        return f"; it looks like {what}"
    if re.search(rb'(?m)^\s*("?[\w.]+"?\s*=|\[[\w."]+\])', content[:4096]):
        return "; it looks like TOML (gains? they are for --gains)"
    return ""


def _part(kind: Any, name: str) -> Any:
    """The type of a struct's field, or of what a list or table holds."""
    for field in getattr(kind, "fields", ()):
        if field.encode_name == name:
            return getattr(field.type, "type", field.type)
    inner = getattr(kind, "value_type", getattr(kind, "item_type", None))
    return getattr(inner, "type", inner)


def _choices(kind: Any) -> list[Any]:
    if isinstance(kind, msgspec.inspect.LiteralType):
        return list(kind.values)
    if isinstance(kind, msgspec.inspect.EnumType):
        return [one.value for one in kind.cls]
    if isinstance(kind, msgspec.inspect.UnionType):
        return [value for one in kind.types for value in _choices(one)]
    return []


def _inside(value: Any) -> list[Any]:
    """The lists and tables in a list or table."""
    parts = value.values() if isinstance(value, dict) else value
    return [part for part in parts if isinstance(part, dict | list)]
