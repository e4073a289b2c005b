"""Tables in a recording: any further series (motion capture, say) as a topic of its own.

ROS field names are lower-case words, so each column gets such a name; what the file it came
from called it is kept in the channel's metadata.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec
import numpy as np
from mcap.records import Channel, Schema

from groundstation.documents import decode_json
from groundstation.errors import RecordingError
from groundstation.recording.cdr import Definition
from groundstation.recording.mcap_schemas import Topic
from groundstation.recording.session import Table

TABLE_PREFIX = "/tables/"
_TIME = "time_s"
_ROWS = 1000


class TableTopic:
    """How one table is written. Raises RecordingError where a column does not hold numbers."""

    def __init__(self, name: str, number: int, table: Table) -> None:
        self._table = table
        self._fields = _field_names(list(table.columns))
        lines = [f"float64[] {_TIME}"]
        for column, field in self._fields.items():
            kind = table.columns[column].dtype
            if kind.kind not in "iufb" or kind.itemsize > 8 or kind == np.float16:
                raise RecordingError(
                    f"table {name}: column {column} is {kind}; MCAP takes numbers only"
                )
            lines.append(f"{'uint8' if kind == np.bool_ else kind.name}[] {field}")
        self._definition = Definition.parse("\n".join(lines) + "\n")
        self.topic = Topic(
            name=TABLE_PREFIX + name,
            message_encoding="cdr",
            schema_name=f"groundstation_msgs/msg/Table{number}",
            schema_encoding="ros2msg",
            schema=self._definition.text.encode(),
        )
        names = {field: column for column, field in self._fields.items()}
        self.metadata = {"columns": msgspec.json.encode(names).decode()}

    def messages(self, origin_ns: int) -> Iterator[tuple[int, bytes]]:
        """Log time and payload of each message; ``origin_ns`` is the Unix time of time 0."""
        times = self._table.time_s
        for start in range(0, len(times), _ROWS):
            rows = slice(start, start + _ROWS)
            columns = {name: values[rows] for name, values in self._table.columns.items()}
            newest_ns = origin_ns + int(np.nanmax(times[rows], initial=0.0) * 1e9)
            yield newest_ns, self.encode(Table(times[rows], columns))

    def encode(self, rows: Table) -> bytes:
        """The payload of a message of some rows, whose columns are this table's."""
        values = {field: rows.columns[column] for column, field in self._fields.items()}
        return self._definition.encode({_TIME: rows.time_s, **values})


class TableColumns:
    """Collects the messages of one table. Raises ValueError where they are not a table's."""

    def __init__(self, channel: Channel, schema: Schema) -> None:
        self._definition = Definition.parse(schema.data.decode())
        names = decode_json(channel.metadata.get("columns", "{}"), dict[str, str])
        self._names = [names.get(field.name, field.name) for field in self._definition.fields]
        if self._names[:1] != [_TIME]:
            raise ValueError(f"{channel.topic} has no {_TIME}")
        self._columns = [bytearray() for _ in self._names]

    def add(self, payload: memoryview) -> None:
        parts = self._definition.slices(payload)
        rows = len(parts[0]) // 8
        sizes = [rows * field.size for field in self._definition.fields]
        if sizes != [len(part) for part in parts]:
            raise ValueError("a table's columns differ in length")
        for column, part in zip(self._columns, parts, strict=True):
            column += part

    def table(self) -> Table:
        fields = self._definition.fields
        arrays = [
            np.frombuffer(column, field.dtype)
            for column, field in zip(self._columns, fields, strict=True)
        ]
        return Table(arrays[0], dict(zip(self._names[1:], arrays[1:], strict=True)))


def _field_names(columns: list[str]) -> dict[str, str]:
    """Column -> a ROS field name, all different."""
    names: dict[str, str] = {}
    taken = {_TIME}
    for column in columns:
        words = re.findall("[a-z0-9]+", column.lower()) or ["column"]
        base = "_".join(words if words[0][0].isalpha() else ["n", *words])
        name, number = base, 2
        while name in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name)
        names[column] = name
    return names
