"""What a camera still owes, and the numbers of its records, over an end of its process.

The reader that a new process has begins at 0 and knows nothing of what was asked for before; this does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from evqr.clock import utc_text
from evqr.line.gates import Trigger, TriggerKind
from evqr.line.records import GapRecord, LineRecord, PartRecord, ReadRecord
from evqr.reason import Reason


class Ledger:
    """Accounts for the triggers and records of one camera.

    Parameters
    ----------
    line, camera : str
        Names that records carry.
    sequence : int
        Number of the first record.
    jobs : collection of str
        Names of the jobs there are.

    Attributes
    ----------
    job : str
        That is in use.
    known_us : int [us]
        Up to where events were read.
    """

    def __init__(self, line: str, camera: str, sequence: int, jobs: Collection[str]) -> None:
        self.job = ""
        self.known_us = 0
        self._identity = {"line": line, "camera": camera}
        self._jobs = jobs
        self._triggers = 0
        self._owed: list[tuple[Trigger, str]] = []
        self._next = {"sequence": sequence, "part": 0, "code": 0, "epoch": 0}
        self._before = dict(self._next)
        self._down = False

    def numbered(self, trigger: Trigger) -> Trigger:
        """Give a trigger that has come, with the index that it has by its place.

        Parameters
        ----------
        trigger : Trigger
            As it came.

        Returns
        -------
        trigger : Trigger
            The same, with an index if it opens a gate.
        """
        if not _opens(trigger):
            return trigger
        index = self._triggers if trigger.index is None else trigger.index
        self._triggers += 1
        return replace(trigger, index=index)

    def owe(self, trigger: Trigger) -> None:
        """Write a trigger down that was handed on.

        Parameters
        ----------
        trigger : Trigger
            That there is to be a part of, if it opens a gate.
        """
        if _opens(trigger):
            self._owed.append((trigger, self.job))

    def take(self, records: Sequence[LineRecord], known_us: int) -> list[LineRecord]:
        """Strike what has been told.

        Parameters
        ----------
        records : sequence of LineRecord
            Of the camera's reader.
        known_us : int [us]
            Up to where it has read.

        Returns
        -------
        records : list of LineRecord
            The same, with numbers that go on.
        """
        self._down, self.known_us = False, known_us
        return [self._going_on(record) for record in records]

    def lost(self, reason: str) -> list[LineRecord]:
        """Tell that the process has ended, and all parts that it owed.

        Parameters
        ----------
        reason : str
            What became of it, in words.

        Returns
        -------
        records : list of LineRecord
            A `GapRecord`, once until it is back, and a NO READ a trigger.
        """
        said = {"reason": Reason.WORKER_LOST.explained(reason), "reason_code": Reason.WORKER_LOST}
        made: list[LineRecord] = []
        if not self._down:
            made.append(self._made(GapRecord, t_from_us=self.known_us, t_to_us=self.known_us, **said))
        for trigger, job in self._owed:
            asked = {"trigger": trigger.index, "ticks": trigger.ticks, "job": job}
            matches = False if job in self._jobs else None
            made.append(self._made(PartRecord, part=self._counted("part"), matches=matches, **asked, **said))
        self._owed, self._down = [], True
        self._before = dict(self._next)  # the next reader begins at 0, and with the clock there is
        return made

    def _going_on(self, record: LineRecord) -> LineRecord:
        before = self._before
        numbers = {"sequence": record.sequence + before["sequence"], "epoch": record.epoch + before["epoch"]}
        if isinstance(record, PartRecord):
            numbers["part"] = record.part + before["part"]
            owed = next((each for each in self._owed if each[0].index == record.trigger), None)
            if owed is not None:
                self._owed.remove(owed)
        if isinstance(record, ReadRecord):
            numbers["code"] = record.code + before["code"]
        self._next.update({name: number + (name != "epoch") for name, number in numbers.items()})
        return replace(record, **numbers) if any(before.values()) else record

    def _counted(self, name: str) -> int:
        self._next[name] += 1
        return self._next[name] - 1

    def _made(self, kind: type[LineRecord], **fields: Any) -> LineRecord:
        return kind(
            sequence=self._counted("sequence"), epoch=self._next["epoch"], t_utc=utc_text(), **self._identity,
            **fields,
        )  # fmt: skip


def _opens(trigger: Trigger) -> bool:
    return trigger.kind in (TriggerKind.PULSE, TriggerKind.START)
