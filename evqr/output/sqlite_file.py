"""SQLite files of ours: told from others, of a known schema, and a line for whatever is wrong with them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from evqr.errors import UsageError

WAIT_S = 30.0
"""How long to wait for another process that writes to the same file [s]."""


class SqliteFile:
    """A SQLite file with a write-ahead log: others may read it meanwhile, and a kill leaves it whole.

    Parameters
    ----------
    path : path
        The file; made where there is none.
    application_id : int
        By which the file says whose it is.
    what : str
        It holds, for messages.
    migrations : sequence of str
        SQL: the first makes the tables, each other brings them from the schema before it to its own. The
        schema's version is their number.
    threads : bool
        Whether it is used by other threads than the one that opens it.

    Attributes
    ----------
    path : Path
        The file.
    db : sqlite3.Connection
        To it, without transactions of its own: `together` makes them.
    made : bool
        Whether there was none.

    Raises
    ------
    UsageError
        The file is another program's, of a newer evqr, or cannot be written.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        application_id: int,
        what: str,
        migrations: Sequence[str],
        threads: bool = False,
    ) -> None:
        self.path = Path(path)
        with self.checked():
            self.db = sqlite3.connect(
                self.path, timeout=WAIT_S, isolation_level=None, check_same_thread=not threads
            )
            try:
                self._prepare(application_id, what, migrations)
            except BaseException:
                self.db.close()
                raise

    def _prepare(self, application_id: int, what: str, migrations: Sequence[str]) -> None:
        with self.together():
            found, schema = (self._one(f"PRAGMA {of}") for of in ("application_id", "user_version"))
            self.made = not self._one("SELECT count(*) FROM sqlite_master")
            if not self.made and found != application_id:
                raise UsageError(f"{self.path}: is a database, but none of {what}; name another file")
            if schema > len(migrations):
                raise UsageError(
                    f"{self.path}: has schema {schema}, this evqr knows {len(migrations)}; use a newer one"
                )
            for migration in migrations[schema:]:
                for statement in migration.split(";"):
                    self.db.execute(statement)
            self.db.execute(f"PRAGMA application_id = {application_id}")
            self.db.execute(f"PRAGMA user_version = {len(migrations)}")
        self.db.execute("PRAGMA journal_mode = WAL")
        self.db.execute("PRAGMA synchronous = NORMAL")  # only a power cut loses what was written last
        self.db.execute("PRAGMA foreign_keys = ON")

    def _one(self, query: str) -> int:
        return self.db.execute(query).fetchone()[0]

    def close(self) -> None:
        """Close the file."""
        self.db.close()

    @contextmanager
    def together(self) -> Iterator[None]:
        """All that is written inside is, or nothing of it."""
        with self.checked():
            self.db.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                if self.db.in_transaction:  # a full disk has ended it already
                    self.db.execute("ROLLBACK")
                raise
            self.db.execute("COMMIT")

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Say in a line what SQLite finds wrong with the file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            raise UsageError(
                f"{self.path}: cannot be used as a database ({error}); free it, or name another file"
            ) from error
