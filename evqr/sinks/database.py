"""Records in a SQLite file, kept for some time or up to some size."""

from __future__ import annotations

import time
from collections.abc import Sequence
from os import PathLike
from typing import Any

from evqr.clock import utc_text
from evqr.errors import UsageError
from evqr.output.sqlite_file import SqliteFile
from evqr.sinks.sink import JsonRecord
from evqr.values import json_line

DAY_S = 86_400.0

APPLICATION_ID = 0x65766C72
"""By which a SQLite file says that it is of a line's records: "evlr"."""

MIGRATIONS = (
    """
CREATE TABLE records (
    id INTEGER PRIMARY KEY,
    t_written TEXT NOT NULL,
    t_utc TEXT NOT NULL,
    line TEXT NOT NULL,
    camera TEXT NOT NULL,
    sequence INTEGER NOT NULL,
    record TEXT NOT NULL,
    part INTEGER,
    trigger INTEGER,
    text TEXT,
    matches INTEGER,
    reason_code TEXT,
    content TEXT NOT NULL,
    UNIQUE (line, camera, sequence, t_utc, record)
);
CREATE INDEX records_by_time ON records (t_written);
CREATE TABLE pruned (t_written TEXT NOT NULL, records INTEGER NOT NULL, last_t_utc TEXT NOT NULL)
""",
)

ADD = """INSERT OR IGNORE INTO records
    (t_written, t_utc, line, camera, sequence, record, part, trigger, text, matches, reason_code, content)
    VALUES (:t_written, :t_utc, :line, :camera, :sequence, :record, :part, :trigger, :text, :matches,
            :reason_code, :content)"""

PRUNE_EVERY = 256
"""Records between two looks at what is to go."""


class Database:
    """Writes a row a record; one that comes twice is there once.

    Parameters
    ----------
    path : path
        The file; made where there is none.
    keep_days : float, optional [d]
        Rows that are older go. Default: none do.
    keep_rows : int, optional
        The oldest rows beyond so many go. Default: none do.
    """

    def __init__(
        self, path: str | PathLike[str], *, keep_days: float | None = None, keep_rows: int | None = None
    ) -> None:
        self.name = f"database {path}"
        self._path, self._keep_days, self._keep_rows = path, keep_days, keep_rows
        self._file: SqliteFile | None = None
        self._until_pruned = 0

    def open(self) -> None:
        """Open the file."""
        try:
            self._file = SqliteFile(
                self._path, application_id=APPLICATION_ID, what="a line's records", migrations=MIGRATIONS
            )
        except UsageError as error:
            raise ConnectionError(str(error)) from error

    def write(self, records: Sequence[JsonRecord]) -> str:
        """Write rows, all of them or none."""
        assert self._file is not None
        now_s = time.time()
        try:
            with self._file.together():
                self._file.db.executemany(ADD, [_row(record, utc_text(now_s)) for record in records])
                self._until_pruned -= len(records)
                if self._until_pruned <= 0:
                    self._until_pruned = PRUNE_EVERY
                    self._prune(now_s)
        except UsageError as error:
            raise ConnectionError(str(error)) from error
        return ""

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _prune(self, now_s: float) -> None:
        """Let old rows go, and note that they have gone."""
        assert self._file is not None
        db = self._file.db
        old: list[tuple[str, tuple[Any, ...]]] = []
        if self._keep_days is not None:
            old.append(("t_written < ?", (utc_text(now_s - DAY_S * self._keep_days),)))
        if self._keep_rows is not None:
            old.append(("id <= (SELECT max(id) FROM records) - ?", (self._keep_rows,)))
        for condition, values in old:
            count, last = db.execute(
                f"SELECT count(*), max(t_utc) FROM records WHERE {condition}", values
            ).fetchone()
            if count:
                db.execute(f"DELETE FROM records WHERE {condition}", values)
                db.execute("INSERT INTO pruned VALUES (?, ?, ?)", (utc_text(now_s), count, last))


def _row(record: JsonRecord, t_written: str) -> dict[str, Any]:
    texts = record.get("texts")
    return {
        "t_written": t_written,
        "t_utc": record.get("t_utc") or "",
        "line": record.get("line") or "",
        "camera": record.get("camera") or "",
        "sequence": record.get("sequence", record.get("first", 0)),
        "record": record["record"],
        "part": record.get("part"),
        "trigger": record.get("trigger"),
        "text": record.get("text") if texts is None else "\n".join(texts) if texts else None,
        "matches": record.get("matches"),
        "reason_code": record.get("reason_code"),
        "content": json_line(record),
    }
