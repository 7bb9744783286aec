"""Results as the reader gives them, made by hand: for tests of what is done with results."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from evqr.events.array import EventArray
from evqr.grade import Grade, GradedPart
from evqr.line.records import ClockRecord, GapRecord, OverloadRecord, PartRecord
from evqr.reason import Reason
from evqr.recording import save_recording
from evqr.results import CodeReading, ReadResult, ReadStatus, WindowCode, WindowReading
from evqr.seen import Statistics
from evqr.symbol.payload import Payload

RNG = np.random.default_rng(5)
MODULES = np.where(RNG.random((21, 21)) < 0.5, -1, 1).astype(np.int8)

GRADE = Grade((GradedPart("decode", 1.0, 4), GradedPart("modulation", 0.4567, 3)))

READING = CodeReading(
    text="LOT 42",
    data=b"LOT 42",
    symbology="QRCode",
    version=1,
    ec_level="M",
    mask=3,
    t_first_us=1000,
    t_last_us=21000,
    t_read_us=9000,
    windows=4,
    corners_px=np.array([[40.0, 30.0], [124.0, 30.0], [124.0, 114.0], [40.0, 114.0]]),
    motion_px_per_s=np.array([4000.0, -500.0]),
    confidence=0.987654,
    log10_chance=-12.34,
    errors_corrected=2,
    unused_correction=0.6,
    grade=GRADE,
    modules=MODULES,
    estimate=(0.8 * MODULES).astype(np.float32),
    dark=np.where(MODULES < 0, 0.99, 0.01).astype(np.float32),
    compute_ms={"motion": 1.25, "total": 31.0},
)

WINDOW = WindowReading(
    status=ReadStatus.READ,
    reason="",
    window=0,
    t_start_us=1000,
    t_end_us=1250,
    n_events=321,
    codes=(
        WindowCode(
            status=ReadStatus.READ,
            payload=Payload(text="LOT 42", data=b"LOT 42"),
            symbology="QRCode",
            version=1,
            ec_level="M",
            mask=3,
            confidence=0.987654,
            log10_chance=-12.34,
            unused_correction=0.6,
            grade=GRADE,
            modules=(0.8 * MODULES).astype(np.float32),
            motion_px_per_s=np.array([4000.0, -500.0]),
            affine=np.array([[0.25, 0.0, -10.5], [0.0, 0.25, -8.0]]),
            stage_one_iterations=12,
            stage_two_iterations=15,
        ),
    ),
    compute_ms={"motion": 1.25, "total": 31.0},
)

LINE = (
    PartRecord(sequence=1, part=0, trigger=7, texts=("LOT 42",), readings=(READING,)),
    GapRecord(sequence=2, t_from_us=5, t_to_us=9),
    ClockRecord(sequence=3, t_before_us=9, t_after_us=0),
    OverloadRecord(sequence=4, t_from_us=5, t_to_us=9, windows=3, behind_ms=50.0),
)


def reading(**changes: Any) -> CodeReading:
    return dataclasses.replace(READING, **changes)


def read_result(*readings: CodeReading) -> ReadResult:
    return ReadResult(ReadStatus.READ, "", readings or (READING,), Statistics(windows=4), {"total": 50.0})


def no_read_result() -> ReadResult:
    seen = Statistics(events=np.int64(1000), windows=12)  # pyright: ignore[reportArgumentType]
    return ReadResult(
        ReadStatus.NO_READ, "no finder pattern was seen", (), seen, {"total": 20.0},
        reason_code=Reason.NO_FINDER_PATTERNS,
    )  # fmt: skip


def events(n: int = 4000, seed: int = 1) -> EventArray:
    rng = np.random.default_rng(seed)
    return EventArray(
        np.sort(rng.integers(0, 20_000, n)).astype(np.int64),
        rng.integers(0, 160, n).astype(np.uint16),
        rng.integers(0, 120, n).astype(np.uint16),
        rng.choice(np.array([-1, 1], np.int8), n),
        160,
        120,
    )


def recording(path: Path, seed: int = 1) -> Path:
    save_recording(path, events(seed=seed))
    return path
