"""Records that wait for their sink: in memory, or on disk, where they outlive the program."""

from __future__ import annotations

import json
from collections import deque
from os import PathLike
from typing import Protocol

from evqr.output.sqlite_file import SqliteFile
from evqr.sinks.sink import JsonRecord
from evqr.values import json_line

APPLICATION_ID = 0x65767370
"""By which a SQLite file says that it is a spool: "evsp"."""

SCHEMA = """
CREATE TABLE waiting (id INTEGER PRIMARY KEY AUTOINCREMENT, record TEXT NOT NULL);
CREATE TABLE size (bytes INTEGER NOT NULL);
INSERT INTO size VALUES (0)
"""


class Waiting(Protocol):
    """Records in the order in which they came."""

    def __len__(self) -> int:
        """Count the records."""
        ...

    def put(self, record: JsonRecord) -> bool:
        """Add a record at the end; False where there is no room."""
        ...

    def first(self, most: int) -> list[JsonRecord]:
        """Give the first records, which stay."""
        ...

    def done(self, count: int) -> None:
        """Let go of the first records."""
        ...

    def close(self) -> None:
        """Let go of all that it holds open."""
        ...


class InMemory:
    """Records in memory.

    Parameters
    ----------
    most : int
        Records that there is room for.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._records: deque[JsonRecord] = deque()

    def __len__(self) -> int:
        return len(self._records)

    def put(self, record: JsonRecord) -> bool:
        """Add a record at the end; False where there is no room."""
        if len(self._records) >= self._most:
            return False
        self._records.append(record)
        return True

    def first(self, most: int) -> list[JsonRecord]:
        """Give the first records, which stay."""
        return [record for record, _ in zip(self._records, range(most), strict=False)]

    def done(self, count: int) -> None:
        """Let go of the first records."""
        for _ in range(count):
            self._records.popleft()

    def close(self) -> None:
        """Nothing is held open."""


class Spool:
    """Records in a SQLite file: they are there again when the program is.

    Parameters
    ----------
    path : path
        The file; made where there is none.
    most_bytes : int
        Of records that there is room for.

    Raises
    ------
    UsageError
        The file cannot be used.
    """

    def __init__(self, path: str | PathLike[str], most_bytes: int) -> None:
        self._file = SqliteFile(
            path, application_id=APPLICATION_ID, what="records that wait", migrations=(SCHEMA,), threads=True
        )
        self._most_bytes = most_bytes
        (self._count,) = self._file.db.execute("SELECT count(*) FROM waiting").fetchone()

    def __len__(self) -> int:
        return self._count

    def put(self, record: JsonRecord) -> bool:
        """Add a record at the end; False where there is no room."""
        line = json_line(record)
        with self._file.together():
            (size,) = self._file.db.execute("SELECT bytes FROM size").fetchone()
            if size + len(line) > self._most_bytes:
                return False
            self._file.db.execute("INSERT INTO waiting (record) VALUES (?)", (line,))
            self._file.db.execute("UPDATE size SET bytes = bytes + ?", (len(line),))
        self._count += 1
        return True

    def first(self, most: int) -> list[JsonRecord]:
        """Give the first records, which stay."""
        query = "SELECT record FROM waiting ORDER BY id LIMIT ?"
        with self._file.checked():
            return [json.loads(line) for (line,) in self._file.db.execute(query, (most,))]

    def done(self, count: int) -> None:
        """Let go of the first records."""
        first = "SELECT id, length(record) AS bytes FROM waiting ORDER BY id LIMIT ?"
        with self._file.together():
            freed, last = self._file.db.execute(
                f"SELECT sum(bytes), max(id) FROM ({first})", (count,)
            ).fetchone()
            self._file.db.execute("DELETE FROM waiting WHERE id <= ?", (last,))
            self._file.db.execute("UPDATE size SET bytes = bytes - ?", (freed,))
        self._count -= count

    def close(self) -> None:
        """Close the file; what is in it is there next time."""
        self._file.close()
