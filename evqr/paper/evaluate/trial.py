"""One trial: a method on one window or frame, watched."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evqr.events.window import Window
from evqr.paper.dataset.manifest import Sequence
from evqr.paper.dataset.truth import Modules, Truth, edges_of
from evqr.paper.evaluate.metrics import FEW_WRONG, Trial, bit_accuracy, wrong_codewords
from evqr.paper.methods.integrate import decode, stretch
from evqr.paper.methods.method import Method, Outcome, cut
from evqr.paper.methods.pattern import find_code
from evqr.symbol import qr
from evqr.symbol.decode import decode_grid
from evqr.symbol.decoded import Decoded
from evqr.symbol.qr_codewords import ErrorLevel, codeword_layout

CONTRAST = 2.4
"""Standard deviations from mid grey to black or white of the 8-bit images that the ordinary decoder gets."""

DENSE_UNTIL, SPARSER = 4, 1.5
"""Images are searched for a code in each iteration up to the first number, then ever less often by the
second: a search takes longer than many iterations."""


class Watcher:
    """Watches the iterates of one trial, on a clock that stands still meanwhile.

    The time to read is the time to the first iterate that reads, and that of searching (in an image) and
    decoding this one iterate: one who knew when to look would need as long.
    """

    def __init__(self, truth: Truth, version: int, level: ErrorLevel, *, matched: bool) -> None:
        self._truth = truth
        self._bits = codeword_layout(version, level).bits
        self._version = version
        self._matched = matched
        self._next = 1
        self._away = 0.0
        self._started = time.perf_counter()
        self.best_accuracy: float | None = None
        self.iterations_to_read: int | None = None
        self.iterations_to_few: int | None = None
        self.seconds_to_read: float | None = None
        self.seconds_to_converge: float | None = None
        self.search_seconds: float | None = None

    @property
    def seconds(self) -> float:
        """Time since the start, less that spent in watching [s]."""
        return time.perf_counter() - self._started - self._away

    def __call__(self, iteration: int, estimate: NDArray[Any], converged: bool, /) -> bool:
        """Look at an iterate; True when it read and nothing better can come."""
        seconds = self.seconds
        if converged and self.seconds_to_converge is None:
            self.seconds_to_converge = seconds
        if self._matched and iteration < self._next:
            return self.iterations_to_read is not None
        began = time.perf_counter()
        if self._matched and iteration >= DENSE_UNTIL:
            self._next = int(SPARSER * iteration) + 1
        modules = find_code(estimate, self._version) if self._matched else estimate
        searched = time.perf_counter() - began if self._matched else None
        self._note(modules, iteration, seconds, began, searched)
        self._away += time.perf_counter() - began
        read = self.iterations_to_read is not None
        return read and (self._matched or self.best_accuracy == 1.0)

    def note_last(self, modules: NDArray[Any] | None) -> None:
        """Take down the accuracy of what the method ended with, which it may not have shown."""
        if modules is not None:
            self.best_accuracy = max(bit_accuracy(signs(modules), self._truth), self.best_accuracy or 0.0)

    def _note(
        self,
        modules: NDArray[Any] | None,
        iteration: int,
        seconds: float,
        began: float,
        searched: float | None,
    ) -> None:
        """Take down what an iterate's modules are worth."""
        if modules is None or modules.shape != self._truth.modules.shape:
            return
        accuracy = bit_accuracy(signs(modules), self._truth)
        self.best_accuracy = max(accuracy, self.best_accuracy or 0.0)
        if self.iterations_to_few is None:
            wrong = wrong_codewords(signs(modules), self._truth, self._bits)
            self.iterations_to_few = iteration if wrong <= FEW_WRONG else None
        if self.iterations_to_read is None and text_of(modules) == self._truth.text:
            self.iterations_to_read = iteration
            self.seconds_to_read = seconds + time.perf_counter() - began
            self.search_seconds = searched


def signs(modules: NDArray[Any]) -> Modules:
    """-1 dark, +1 light, 0 undecided."""
    return np.sign(modules).astype(np.int8)


def text_of(modules: NDArray[Any]) -> str | None:
    """Text of modules, with all the effort that the decoder can make; the same for every method."""
    outcome = decode_grid(modules, qr.space(qr.version_of(len(modules))), effort="full")
    return outcome.text if isinstance(outcome, Decoded) else None


def run_trial(method: Method, seen: Any, sequence: Sequence) -> tuple[Trial, Outcome]:
    """Let a method read a window or a frame of a recording."""
    truth, version = sequence.truth, sequence.entry.version
    watcher = Watcher(truth, version, sequence.entry.level, matched=method.matched)
    outcome = method.read(seen, watcher)
    # what a method was shown to do after it had ended is not its time
    seconds = watcher.seconds_to_converge or watcher.seconds
    modules, text, image_text = outcome.modules, outcome.text, None
    if method.matched and outcome.image is not None:
        modules = find_code(outcome.image, version)
        text = None if modules is None else text_of(modules)
        watcher.note_last(modules)
        image_text = decode(stretch(outcome.image.astype(np.float32), CONTRAST))
    elif outcome.image is not None:
        image_text = outcome.text
    if modules is not None and modules.shape != truth.modules.shape:
        modules = None
    seconds_to_read = watcher.seconds_to_read
    if seconds_to_read is None and text == truth.text:  # by a method that has no iterates
        seconds_to_read = seconds
    found = (
        modules is not None if outcome.modules is not None or method.matched else outcome.image is not None
    )
    return Trial(
        modules=None if modules is None else signs(modules),
        converged=outcome.converged and found,
        text=text,
        image_text=image_text,
        has_image=method.takes == "frame" or method.matched or outcome.image is not None,
        best_accuracy=watcher.best_accuracy,
        iterations_to_read=watcher.iterations_to_read,
        seconds_to_read=seconds_to_read,
        seconds=seconds,
        windows=outcome.windows,
        confidence=outcome.confidence,
        events_per_edge=events_used(seen, method.windows, outcome.windows, sequence),
        start=outcome.start,
        pose_iterations=outcome.pose_iterations,
        iterations_to_few=watcher.iterations_to_few,
        search_seconds=outcome.search_seconds if watcher.search_seconds is None else watcher.search_seconds,
    ), outcome


def events_used(seen: Any, windows: int, used: int, sequence: Sequence) -> float | None:
    """Events per edge of the first ``used`` of the ``windows`` that a method was given; None of a frame."""
    if not isinstance(seen, Window):
        return None
    parts = [seen] if used == windows else [cut(seen, windows, index) for index in range(used)]
    counts = [events_per_edge(part, sequence) for part in parts]
    return None if None in counts else sum(count for count in counts if count is not None)


def events_per_edge(window: Window, sequence: Sequence) -> float | None:
    """Events of a window that lie on the code, over its edges; None where its pose is not known."""
    pose = sequence.pose_at(window.middle_us)
    if pose is None:
        return None
    size = len(sequence.truth.modules)
    velocity = 1e6 * sequence.velocity
    x, y = window.x - velocity[0] * window.t, window.y - velocity[1] * window.t
    u, v, z = (row[0] * x + row[1] * y + row[2] for row in np.linalg.inv(pose))
    on = (u > 0) & (u < size * z) & (v > 0) & (v < size * z)
    return float(on.sum()) / edges_of(sequence.truth.modules)
