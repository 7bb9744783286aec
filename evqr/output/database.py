"""Readings of many recordings in one SQLite file: a row a part, or one that says why there is none."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Any

from evqr.clock import utc_text
from evqr.errors import UsageError
from evqr.output.records import result_records
from evqr.output.sqlite_file import SqliteFile
from evqr.results import CodeReading, ReadResult, ReadStatus
from evqr.values import json_line

APPLICATION_ID = 0x65767172
"""By which a SQLite file says that it is of readings: "evqr"."""

SCHEMA = """
CREATE TABLE settings (given TEXT NOT NULL);
CREATE TABLE recordings (
    id INTEGER PRIMARY KEY,
    path TEXT NOT NULL UNIQUE,
    size INTEGER,
    modified_ns INTEGER,
    status TEXT,
    reason_code TEXT,
    reason TEXT,
    events INTEGER,
    duration_us INTEGER,
    windows INTEGER,
    warnings TEXT,
    compute_ms TEXT,
    evqr_version TEXT,
    t_utc TEXT
);
CREATE TABLE parts (
    recording INTEGER NOT NULL REFERENCES recordings (id),
    part INTEGER NOT NULL,
    status TEXT NOT NULL,
    text TEXT,
    content BLOB,
    symbology TEXT,
    version TEXT,
    t_first_us INTEGER,
    t_last_us INTEGER,
    t_read_us INTEGER,
    windows INTEGER,
    confidence REAL,
    errors_corrected INTEGER,
    reason_code TEXT,
    reason TEXT,
    record TEXT NOT NULL,
    PRIMARY KEY (recording, part)
);
"""

MIGRATIONS = (
    SCHEMA,
    """
ALTER TABLE parts ADD COLUMN log10_chance REAL;
ALTER TABLE parts ADD COLUMN unused_correction REAL;
ALTER TABLE parts ADD COLUMN grade TEXT
""",
)
"""One a version of the file."""

PART = """INSERT INTO parts VALUES (
    :recording, :part, :status, :text, :content, :symbology, :version, :t_first_us, :t_last_us, :t_read_us,
    :windows, :confidence, :errors_corrected, :reason_code, :reason, :record, :log10_chance,
    :unused_correction, :grade
)"""

READING = (
    "text", "content", "symbology", "version", "t_first_us", "t_last_us", "t_read_us", "windows",
    "confidence", "errors_corrected", "log10_chance", "unused_correction", "grade",
)  # fmt: skip
"""Columns of parts that are empty where nothing was read."""

DONE = """UPDATE recordings SET
    size = :size, modified_ns = :modified_ns, status = :status, reason_code = :reason_code, reason = :reason,
    events = :events, duration_us = :duration_us, windows = :windows, warnings = :warnings,
    compute_ms = :compute_ms, evqr_version = :evqr_version, t_utc = :t_utc
    WHERE path = :path"""


class ReadingsDatabase:
    """A SQLite file of recordings and the parts in them; a context manager.

    A recording's rows are written together, or not at all, whatever ends the program.

    Parameters
    ----------
    path : path
        The file; made where there is none.
    settings : mapping
        How recordings are read, where it is not the default, as JSON has it: those of a file are all read
        alike.

    Raises
    ------
    UsageError
        The file is none of ours, of a newer evqr, made with other settings, or cannot be written.
    """

    def __init__(self, path: str | PathLike[str], settings: Mapping[str, Any]) -> None:
        self._file = SqliteFile(path, application_id=APPLICATION_ID, what="readings", migrations=MIGRATIONS)
        self._db = self._file.db
        given = json_line(settings)
        try:
            with self._file.together():
                if self._file.made:
                    self._db.execute("INSERT INTO settings VALUES (?)", (given,))
                (before,) = self._db.execute("SELECT given FROM settings").fetchone()
            if before != given:
                raise UsageError(
                    f"{path}: was made with settings {before}, not {given}; use those, or name another file"
                )
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> ReadingsDatabase:
        return self

    def __exit__(self, *failure: object) -> None:
        self._file.close()

    def pending(self, recordings: Sequence[Path]) -> list[Path]:
        """Take recordings in, and say which are still to be read.

        Parameters
        ----------
        recordings : sequence of Path
            All that the file is to have, in order.

        Returns
        -------
        pending : list of Path
            Those that were not read yet, have changed since, or could not be read then.
        """
        with self._file.together():
            self._db.executemany(
                "INSERT OR IGNORE INTO recordings (path) VALUES (?)", [(_key(path),) for path in recordings]
            )
            known = {
                path: (size, modified_ns)
                for path, size, modified_ns in self._db.execute(
                    "SELECT path, size, modified_ns FROM recordings WHERE status IN (?, ?)",
                    (ReadStatus.READ.value, ReadStatus.NO_READ.value),
                )
            }
        return [path for path in recordings if known.get(_key(path), ()) != _stamp(path)]

    def add(self, path: Path, result: ReadResult) -> None:
        """Write what a recording gave, instead of what it gave before.

        Parameters
        ----------
        path : Path
            One that `pending` gave.
        result : ReadResult
            Of it.
        """
        size, modified_ns = _stamp(path)
        seen = result.seen
        with self._file.together():
            (number,) = self._db.execute("SELECT id FROM recordings WHERE path = ?", (_key(path),)).fetchone()
            self._db.execute("DELETE FROM parts WHERE recording = ?", (number,))
            self._db.executemany(PART, _parts(number, result))
            self._db.execute(
                DONE,
                {
                    "path": _key(path),
                    "size": size,
                    "modified_ns": modified_ns,
                    "status": result.status.value,
                    "reason_code": _or_none(result.reason_code),
                    "reason": result.reason or None,
                    "events": seen.events,
                    "duration_us": seen.duration_us,
                    "windows": seen.windows,
                    "warnings": "\n".join(result.warnings) or None,
                    "compute_ms": json_line(result.compute_ms),
                    "evqr_version": version("evqr"),
                    "t_utc": utc_text(),
                },
            )

    def statuses(self, recordings: Sequence[Path]) -> list[tuple[ReadStatus, str | None]]:
        """Give status and code of the reason of recordings that were read, in their order."""
        with self._file.checked():
            rows = {path: rest for path, *rest in self._db.execute(
                "SELECT path, status, reason_code FROM recordings WHERE status IS NOT NULL"
            )}  # fmt: skip
        found = (rows[_key(path)] for path in recordings if _key(path) in rows)
        return [(ReadStatus(status), reason_code) for status, reason_code in found]


def _parts(number: int, result: ReadResult) -> Iterator[dict[str, Any]]:
    """Give the rows of a recording; one that could not be read has none."""
    if result.status is ReadStatus.ERROR:
        return
    for part, (reading, record) in enumerate(
        zip(result.readings or (None,), result_records(result), strict=True)
    ):
        record = {key: value for key, value in record.items() if key != "compute_ms"}
        yield {
            "recording": number,
            "part": part,
            "status": record["status"],
            "reason_code": _or_none(result.reason_code),
            "reason": result.reason or None,
            "record": json_line(record),
            **_reading_columns(reading),
        }


def _reading_columns(reading: CodeReading | None) -> dict[str, Any]:
    if reading is None:
        return dict.fromkeys(READING)
    return {
        "text": reading.text,
        "content": reading.data,
        "symbology": reading.symbology,
        "version": str(reading.version),
        "t_first_us": int(reading.t_first_us),
        "t_last_us": int(reading.t_last_us),
        "t_read_us": int(reading.t_read_us),
        "windows": int(reading.windows),
        "confidence": float(reading.confidence),
        "errors_corrected": int(reading.errors_corrected),
        "log10_chance": float(reading.log10_chance),
        "unused_correction": _float_or_none(reading.unused_correction),
        "grade": None if reading.grade is None else reading.grade.letter,
    }


def _key(path: Path) -> str:
    """Name a recording wherever the command is run from."""
    return os.path.abspath(path)


def _stamp(path: Path) -> tuple[int | None, int | None]:
    """Give what shows that a file has changed: its size and time; None where it cannot be seen."""
    try:
        status = path.stat()
    except OSError:
        return None, None
    return status.st_size, status.st_mtime_ns


def _float_or_none(value: float | None) -> float | None:
    return None if value is None else float(value)


def _or_none(reason: Any) -> str | None:
    return None if reason is None else str(reason)
