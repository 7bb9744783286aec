"""What reading gives: codes, windows, and all that one recording gave.

Conventions (docs/reference/conventions.md): x is the column and y the row, integers are pixel centres; time
stamps are int64 microseconds.  All results are values: frozen, with read-only arrays; two runs on the same
events give equal results, however long they took.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from os import PathLike, fsdecode
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evqr.grade import Grade
from evqr.reason import Reason
from evqr.seen import Nearest, Statistics
from evqr.symbol.messages import Message, join_messages
from evqr.symbol.payload import ContentType, Payload
from evqr.values import Value, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class ReadStatus(str, Enum):
    """How an attempt ended."""

    READ = "read"
    NO_READ = "no_read"
    NO_CODE = "no_code"
    ERROR = "error"


class _OfSymbol:
    """What a symbol is in short, for records that say its kind and hold its modules."""

    symbology: str
    version: int | str
    ec_level: str | None
    modules: NDArray[Any]

    @property
    def symbol(self) -> str:
        """Symbology, size and level in short: QRCode 7-H, MicroQRCode M1, DataMatrix 22x22."""
        level = "" if self.ec_level is None else f"-{self.ec_level}"
        return f"{plain(self.symbology)} {self.version}{level}"

    @property
    def rows(self) -> int:
        """Modules from top to bottom, V."""
        return self.modules.shape[0]

    @property
    def columns(self) -> int:
        """Modules from left to right, U."""
        return self.modules.shape[1]


@dataclass(frozen=True, eq=False)
class CodeReading(_OfSymbol, Payload):
    """One code that passed, read: what it says, and where and when.

    Attributes
    ----------
    text, data, symbology_identifier, content_type, eci, charset, charset_source : as in `Payload`
        What it says.
    structured_append, warnings : as in `Payload`
        Which part of a message it is, and what was odd about it.
    symbology : str
        Kind of symbol, by zxing-cpp's names: QRCode, ...
    version : int or str
        Which size of it: 1 to 40 for QR codes, text for others (M2, R11x27, 22x22).
    ec_level : str or None
        Level of error correction, "L", "M", "Q" or "H"; None where the symbology has none.
    mask : int or None
        Of the symbol, 0 to 7; None where the symbology has none.
    t_first_us, t_last_us : int [us]
        Event time of first and last sight.
    t_read_us : int [us]
        Event time at which it first decoded.
    windows : int
        Windows of events that were used until it decoded.
    corners_px : (4, 2) float64 [px]
        Outer corners, from the top-left one clockwise, at ``t_read_us``.
    motion_px_per_s : (2,) float64 [px/s]
        Velocity in the image.
    confidence : float
        That the text is right, 0 to 1.
    log10_chance : float
        Decimal logarithm of the number of contents expected to agree as well by chance, an upper bound: what
        the confidence is worked out from.
    errors_corrected : int
        Codewords that error correction changed.
    unused_correction : float
        Share of the error correction that was not needed, 0 to 1: of the block that has least left.
    grade : Grade
        How good the print was, A to F, as far as the events show.
    modules : (V, U) int8
        The symbol as decoded: -1 dark, +1 light.
    estimate : (V, U) float32
        The modules as estimated before decoding, same signs.
    dark : (V, U) float32
        Probability that each is dark, of its estimate and the noise alone, calibrated; 0 or 1 where it is
        known before.
    compute_ms : mapping of str to float [ms]
        By stage, and "total"; does not count in comparisons.
    """

    symbology: str
    version: int | str
    ec_level: str | None
    mask: int | None
    t_first_us: int
    t_last_us: int
    t_read_us: int
    windows: int
    corners_px: NDArray[np.float64]
    motion_px_per_s: NDArray[np.float64]
    confidence: float
    log10_chance: float
    errors_corrected: int
    unused_correction: float
    grade: Grade
    modules: NDArray[np.int8] = field(repr=False)
    estimate: NDArray[np.float32] = field(repr=False)
    dark: NDArray[np.float32] = field(repr=False)
    compute_ms: Mapping[str, float] = field(compare=False)

    def __str__(self) -> str:
        return f"{self.text!r} ({self.symbol}) at {self.t_read_us} us"

    def draw(self, source: Any, to: str | PathLike[str] | None = None, **drawing: Any) -> Figure:
        """Draw how the code was read, as `draw_reading` does.

        Parameters
        ----------
        source : path, EventArray, Recording or arrays
            The events.
        to : path, optional
            Picture file to write, .png, .svg or .pdf.
        **drawing : as for `draw_reading`
            Such as ``truth``, and what `open_recording` takes.

        Returns
        -------
        Figure
            Of matplotlib; its ``savefig`` writes it to a file.

        Raises
        ------
        MissingExtra, RecordingError
            Matplotlib is not installed; the source cannot be read.
        UsageError
            The file cannot be written.
        TypeError
            The source is none: a reading does not know where its events are.
        """
        import evqr

        source, to = _source_and_file(source, to)
        if source is None:
            raise TypeError(f"source must be given, what holds the events: draw(source, to={str(to)!r})")
        return evqr.draw_reading(source, self, to=to, **drawing)

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `evqr read --json`.

        Returns
        -------
        record : dict
            Plain values by key, in the order of docs/reference/records.md.
        """
        return {
            "status": ReadStatus.READ.value,
            "text": self.text,
            "bytes_base64": plain(self.data),
            "symbology": plain(self.symbology),
            "version": plain(self.version),
            "ec_level": plain(self.ec_level),
            "mask": plain(self.mask),
            "rows": self.rows,
            "columns": self.columns,
            "t_first_us": plain(self.t_first_us),
            "t_last_us": plain(self.t_last_us),
            "t_read_us": plain(self.t_read_us),
            "windows": plain(self.windows),
            "corners_px": plain(self.corners_px, 3),
            "motion_px_per_s": plain(self.motion_px_per_s, 2),
            "confidence": plain(self.confidence, 4),
            "log10_chance": plain(self.log10_chance, 1),
            "errors_corrected": plain(self.errors_corrected),
            "unused_correction": plain(self.unused_correction, 3),
            "grade": self.grade.to_dict(),
            "compute_ms": plain(self.compute_ms, 3),
            "warnings": [*self.warnings, *([self.gs1_error] if self.gs1_error else [])],
            **_beside_text(self),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowCode(_OfSymbol, Value):
    """One code in a window that was read alone.

    Attributes
    ----------
    status : ReadStatus
        READ, or NO_READ: it was found, but does not decode.
    reason : str
        Why not, in words; "" when read.
    reason_code : Reason or None
        The same for programs; None when read.
    payload : Payload or None
        What it says; None when not read.
    symbology : str
        Kind of symbol, by zxing-cpp's names: QRCode, ...
    version : int or str
        Which size of it: 1 to 40 for QR codes, text for others (M2, R11x27, 22x22).
    ec_level : str or None
        Level of error correction; None when not read, and where the symbology has none.
    mask : int or None
        Of the symbol; None when not read, and where the symbology has none.
    confidence : float or None
        That the text is right, 0 to 1; None when not read.
    log10_chance, unused_correction : float or None
        As of `CodeReading`; None when not read.
    grade : Grade or None
        As of `CodeReading`; None when not read.
    modules : (V, U) float32
        Estimate, < 0 dark, > 0 light.
    motion_px_per_s : (2,) float64 [px/s]
        Velocity in the image.
    affine : (2, 3) float64
        W of the paper: (column, row, 1) in px to (u, v) with integers at module centres.
    stage_one_iterations : int
        Of Gauss-Newton, for the pose.
    stage_two_iterations : int
        Of conjugate gradients, for the modules.
    """

    status: ReadStatus
    reason: str = ""
    reason_code: Reason | None = None
    payload: Payload | None = None
    symbology: str
    version: int | str
    ec_level: str | None = None
    mask: int | None = None
    confidence: float | None = None
    log10_chance: float | None = None
    unused_correction: float | None = None
    grade: Grade | None = None
    modules: NDArray[np.float32]
    motion_px_per_s: NDArray[np.float64]
    affine: NDArray[np.float64]
    stage_one_iterations: int = 0
    stage_two_iterations: int = 0

    @property
    def text(self) -> str | None:
        """Its text; None when not read."""
        return None if self.payload is None else self.payload.text

    def __str__(self) -> str:
        return f"{self.reason if self.text is None else repr(self.text)} ({self.symbol})"

    def to_dict(self) -> dict[str, Any]:
        """Return one of the ``codes`` of `evqr read --each-window --json`.

        Returns
        -------
        record : dict
            Plain values by key; modules are rows of "0" and "1", 1 dark.
        """
        fields = {("text" if key == "payload" else key): each for key, each in super().to_dict().items()}
        return {
            **fields,
            "text": self.text,
            "rows": self.rows,
            "columns": self.columns,
            "confidence": plain(self.confidence, 4),
            "log10_chance": plain(self.log10_chance, 1),
            "unused_correction": plain(self.unused_correction, 3),
            "modules": module_rows(self.modules),
            "motion_px_per_s": plain(self.motion_px_per_s, 2),
            "affine": plain(self.affine.ravel(), 8),
            **_beside_text(self.payload),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowReading(Value):
    """One window of events, read alone and from cold.

    What `codes` says of its first code is here too: `text`, `version`, `modules` and so on.

    Attributes
    ----------
    status : ReadStatus
        READ when any code was read, NO_READ when one was found, but none decodes, or NO_CODE.
    reason : str
        Why not, in words; "" when read.
    reason_code : Reason or None
        The same for programs; None when read.
    window : int
        Index of the window; those without events, which are left out, count.
    t_start_us, t_end_us : int [us]
        Bounds of the window.
    n_events : int
        Events in it.
    codes : tuple of WindowCode
        All codes in it, those that were read first.
    compute_ms : mapping of str to float [ms]
        By stage, and "total"; does not count in comparisons.
    warnings : tuple of str
        What was odd about the recording up to here, in words.
    """

    status: ReadStatus
    reason: str = ""
    reason_code: Reason | None = None
    window: int
    t_start_us: int
    t_end_us: int
    n_events: int
    codes: tuple[WindowCode, ...] = ()
    compute_ms: Mapping[str, float] = field(default_factory=dict, compare=False)
    warnings: tuple[str, ...] = ()

    @property
    def text(self) -> str | None:
        """Of the first code; None while unknown."""
        return self.codes[0].text if self.codes else None

    @property
    def version(self) -> int | str | None:
        """Of the first code; None without one."""
        return self.codes[0].version if self.codes else None

    @property
    def modules(self) -> NDArray[np.float32] | None:
        """Estimate (V, U) of the first code, < 0 dark, > 0 light; None without one."""
        return self.codes[0].modules if self.codes else None

    @property
    def motion_px_per_s(self) -> NDArray[np.float64] | None:
        """Velocity (2,) of the first code [px/s]; None without one."""
        return self.codes[0].motion_px_per_s if self.codes else None

    @property
    def affine(self) -> NDArray[np.float64] | None:
        """W (2, 3) of the first code; None without one."""
        return self.codes[0].affine if self.codes else None

    @property
    def stage_one_iterations(self) -> int:
        """Of Gauss-Newton, for the pose of the first code."""
        return self.codes[0].stage_one_iterations if self.codes else 0

    @property
    def stage_two_iterations(self) -> int:
        """Of conjugate gradients, for the modules of the first code."""
        return self.codes[0].stage_two_iterations if self.codes else 0

    def __str__(self) -> str:
        found = ", ".join(map(str, self.codes)) or self.reason
        return f"window {self.window}, {self.t_start_us} to {self.t_end_us} us: {found}"

    def to_dict(self) -> dict[str, Any]:
        """Return the record of `evqr read --each-window --json`.

        Returns
        -------
        record : dict
            Plain values by key, in the order of docs/reference/records.md.
        """
        first = self.codes[0].to_dict() if self.codes else {}
        return {
            "status": self.status.value,
            "reason": self.reason,
            "reason_code": plain(self.reason_code),
            "window": plain(self.window),
            "t_start_us": plain(self.t_start_us),
            "t_end_us": plain(self.t_end_us),
            "n_events": plain(self.n_events),
            **{key: first.get(key) for key in ("text", "version", "modules", "motion_px_per_s", "affine")},
            "stage_one_iterations": plain(self.stage_one_iterations),
            "stage_two_iterations": plain(self.stage_two_iterations),
            "codes": [code.to_dict() for code in self.codes],
            "compute_ms": plain(self.compute_ms, 3),
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True, eq=False)
class ReadResult(Value):
    """All that one recording gave.

    Attributes
    ----------
    status : ReadStatus
        READ when something was read, NO_READ otherwise, ERROR for a source that could not be read.
    reason : str
        Why nothing was read, or the error; "" when something was read.
    readings : tuple of CodeReading
        One a code, in order of ``t_read_us``.
    seen : Statistics
        How much was worked on.
    compute_ms : mapping of str to float [ms]
        By stage over the whole recording, and "total"; does not count in comparisons.
    source : str
        The path, or "" for arrays.
    reason_code : Reason or None
        The reason for programs; None when something was read.
    warnings : tuple of str
        What was odd about the recording, in words.
    nearest : Nearest or None
        What came nearest, where nothing was read but something moved; does not count in comparisons.
    """

    status: ReadStatus
    reason: str = ""
    readings: tuple[CodeReading, ...] = ()
    seen: Statistics = field(default_factory=Statistics)
    compute_ms: Mapping[str, float] = field(default_factory=dict, compare=False)
    source: str = ""
    reason_code: Reason | None = None
    warnings: tuple[str, ...] = ()
    nearest: Nearest | None = field(default=None, compare=False)

    @property
    def messages(self) -> tuple[Message, ...]:
        """Messages of which parts were read (structured append), joined where all parts have passed."""
        return join_messages(self.readings)

    def __str__(self) -> str:
        found = ", ".join(map(str, self.readings)) or f"{self.status.value}: {self.reason}"
        return f"{self.source}: {found}" if self.source else found

    def draw(
        self, source: Any = None, to: str | PathLike[str] | None = None, *, reading: int = 0, **drawing: Any
    ) -> Figure:
        """Draw how a code was read, or what there was where nothing was read, as `draw_reading` does.

        Parameters
        ----------
        source : path, EventArray, Recording or arrays, optional
            The events; default: the file that was read.  The name of a picture alone is taken for ``to``.
        to : path, optional
            Picture file to write, .png, .svg or .pdf.
        reading : int
            Which one.
        **drawing : as for `draw_reading`
            Such as ``truth``, and what `open_recording` takes.

        Returns
        -------
        Figure
            Of matplotlib; its ``savefig`` writes it to a file.

        Raises
        ------
        ValueError
            There is no such reading, or no source.
        MissingExtra, RecordingError
            Matplotlib is not installed; the source cannot be read.
        UsageError
            The file cannot be written.
        """
        import evqr

        source, to = _source_and_file(source, to)
        if self.readings and not -len(self.readings) <= reading < len(self.readings):
            raise ValueError(f"reading must be one of {len(self.readings)}, got {reading}")
        if source is None:
            if not self.source:
                raise ValueError("source must be given: this is a result of events in memory")
            source = self.source
        shown = self.readings[reading] if self.readings else self
        return evqr.draw_reading(source, shown, to=to, **drawing)

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values.

        Returns
        -------
        record : dict
            Plain values by field; ``readings`` are as `CodeReading.to_dict` has them.
        """
        record = {**super().to_dict(), "compute_ms": plain(self.compute_ms, 3)}
        return {**record, "messages": plain(self.messages)}


PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps", ".gif", ".bmp")
"""Endings of names that are never those of recordings."""


def _source_and_file(source: Any, to: Any) -> tuple[Any, Any]:
    """Tell what holds the events from the file to write: who names a picture alone means that."""
    if to is None and isinstance(source, (str, PathLike)) and fsdecode(source).lower().endswith(PICTURES):
        return None, source
    return source, to


def _beside_text(payload: Payload | None) -> dict[str, Any]:
    """Return what a symbol says beside its characters, by key of records; None throughout without one."""
    keys = ("symbology_identifier", "content_type", "eci", "charset", "charset_source", "structured_append")
    record: dict[str, Any] = {key: plain(getattr(payload, key, None)) for key in keys}
    if payload is None or payload.content_type is not ContentType.GS1:
        return {**record, "gs1": None}
    return {**record, "gs1": plain(payload.gs1)}


def module_rows(modules: NDArray[np.floating] | NDArray[np.integer]) -> list[str]:
    """Write a grid as text.

    Parameters
    ----------
    modules : (V, U) float or int
        Negative where dark.

    Returns
    -------
    rows : list of str
        One a row, "1" where dark, "0" where light.
    """
    return ["".join("1" if dark else "0" for dark in row) for row in modules < 0]
