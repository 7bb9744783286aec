"""From triggers to gates: the times of which each trigger asks, one gate a part.

A pulse asks for a time around it, or, where an encoder is there, for what passes between two positions of it;
a start and an end ask for the time between them.  Gates may overlap, an end may be lost, and all may be told
later than the events that they are of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from evqr.config import TriggerConfig
from evqr.errors import UsageError

MOST_GATES = 4096
"""Gates that may wait for their parts: more triggers than that are refused."""


class TriggerKind(str, Enum):
    """What a trigger says."""

    PULSE = "pulse"
    """a part passes"""
    START = "start"
    """a part's gate opens"""
    END = "end"
    """a part's gate closes"""
    TICKS = "ticks"
    """where the encoder is, and nothing of a part"""


@dataclass(frozen=True)
class Trigger:
    """What a light barrier, an encoder or a PLC says.

    Attributes
    ----------
    t_us : int [us]
        When, by the clock of the events.
    kind : TriggerKind
        What.
    index : int, optional
        Of the part. Default: triggers that open a gate are counted; an end closes the gate opened last.
    ticks : float, optional
        Where the encoder is.
    """

    t_us: int
    kind: TriggerKind = TriggerKind.PULSE
    index: int | None = None
    ticks: float | None = None


@dataclass(eq=False)
class Gate:
    """The time of which one trigger asks.

    Attributes
    ----------
    index : int
        Of the trigger.
    ticks : float, optional
        Of the encoder at the trigger.
    job : str
        That was set when it came.
    trigger_us : int [us]
        Time of the trigger.
    start_us, end_us : float [us]
        Infinite as long as they are not known.
    limit_us : float [us]
        Where it ends if no end comes.
    check_us : float [us]
        When it may be found out whether all of it is read.
    positions : tuple of 2 floats, optional
        Of the encoder, between which it is open.
    """

    index: int
    ticks: float | None
    job: str
    trigger_us: int
    start_us: float = math.inf
    end_us: float = math.inf
    limit_us: float = math.inf
    check_us: float = math.inf
    positions: tuple[float, float] | None = None

    @property
    def closed_us(self) -> float:
        """Where it ends [us]."""
        return min(self.end_us, self.limit_us)

    @property
    def opened_us(self) -> float:
        """Where it begins, at its end where it never did [us]."""
        return min(self.start_us, self.closed_us)

    def shared_us(self, first_us: float, last_us: float) -> float:
        """Give how much of a time it asks for; negative where there is time between them [us]."""
        return min(last_us, self.closed_us) - max(first_us, self.opened_us)


class Gates:
    """Gates that are open, or closed and not told yet, in the order of their triggers.

    Parameters
    ----------
    cfg : TriggerConfig
        What pulses ask for.

    Attributes
    ----------
    waiting : list of Gate
        Those whose parts are not told yet.
    ignored : int
        Ends that closed nothing.
    """

    def __init__(self, cfg: TriggerConfig) -> None:
        self.waiting: list[Gate] = []
        self.ignored = 0
        self._cfg = cfg
        self._count = 0
        self._encoder: tuple[int, float] | None = None

    def check(self, trigger: Trigger) -> None:
        """Refuse a trigger that cannot be taken.

        Parameters
        ----------
        trigger : Trigger
            That has come.

        Raises
        ------
        UsageError
            Too many wait for their parts, or it does not say what the settings ask for.
        """
        if len(self.waiting) >= MOST_GATES and trigger.kind in (TriggerKind.PULSE, TriggerKind.START):
            raise UsageError(
                f"{len(self.waiting)} triggers wait for their parts; give each when its events come"
            )
        needs = self._cfg.ticks is not None and trigger.kind is TriggerKind.PULSE
        if trigger.ticks is None and (needs or trigger.kind is TriggerKind.TICKS):
            raise UsageError(f"the {trigger.kind.value} trigger at {trigger.t_us} us must have ticks")

    def take(self, trigger: Trigger, job: str = "") -> None:
        """Take a trigger.

        Parameters
        ----------
        trigger : Trigger
            In the order in which they came.
        job : str
            What its part is read for.

        """
        if trigger.ticks is not None:
            self._move_to(trigger.t_us, trigger.ticks)
        if trigger.kind is TriggerKind.END:
            self._close(trigger)
        elif trigger.kind is not TriggerKind.TICKS:
            self._open(trigger, job)

    def _open(self, trigger: Trigger, job: str) -> None:
        cfg, t_us = self._cfg, trigger.t_us
        index = self._count if trigger.index is None else trigger.index
        gate = Gate(index, trigger.ticks, job, t_us, limit_us=t_us + cfg.longest_us)
        if trigger.kind is TriggerKind.START:
            gate.start_us = t_us
        elif cfg.ticks is None:
            gate.start_us, gate.end_us = t_us - cfg.before_us, t_us + cfg.after_us
            gate.limit_us = gate.end_us
        elif trigger.ticks is not None:
            first, last = cfg.ticks
            gate.positions = trigger.ticks + first, trigger.ticks + last
            if first <= 0.0:
                gate.start_us = t_us  # where the encoder was before the trigger is not asked
        gate.check_us = gate.closed_us
        self._count += 1
        self.waiting.append(gate)

    def _close(self, trigger: Trigger) -> None:
        for gate in reversed(self.waiting):
            if math.isinf(gate.end_us) and trigger.index in (None, gate.index):
                gate.end_us = max(trigger.t_us, gate.start_us)
                gate.check_us = gate.closed_us
                return
        self.ignored += 1

    def _move_to(self, t_us: int, ticks: float) -> None:
        """Open and close gates that the encoder has passed the positions of."""
        before, self._encoder = self._encoder, (t_us, ticks)
        if before is None or ticks <= before[1]:
            return

        def passed_us(position: float) -> float:
            """When it was there [us]; never, if it was not."""
            if not before[1] < position <= ticks:
                return math.inf
            return before[0] + (t_us - before[0]) * (position - before[1]) / (ticks - before[1])

        for gate in self.waiting:
            if gate.positions is not None:
                first, last = gate.positions
                gate.start_us = min(gate.start_us, passed_us(first))
                gate.end_us = min(gate.end_us, passed_us(last))
                gate.check_us = gate.closed_us
