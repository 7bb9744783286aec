"""Symbols with a single finder pattern in a stream: read, and not followed for long where they are none."""

import pytest
from scenes import scene
from stream_steps import records_of

from evqr import ReadConfig, read_codes
from evqr.config import AlignConfig, DecodeConfig
from evqr.reason import Reason
from evqr.simulate import CodePlacement
from evqr.solver import Solver
from evqr.stream.records import CodeUnread

TEXTS = {"M1": "40961", "M2": "DEV-55", "M3": "EVQR-07", "M4": "HELLO-EVQR-7"}


def micro(version, **options):
    code = CodePlacement(text=TEXTS[version], symbology="microqr", version=version, ec="L", module_px=5.0)
    return scene(codes=(code,), travel_px=20.0, **options).events


@pytest.mark.parametrize("version", TEXTS)
@pytest.mark.parametrize(
    "options",
    [
        {"direction": 35.0},
        {"direction": 215.0, "preset": "fast", "speed_px_ms": 8.0},
        {"direction": 300.0, "preset": "slow", "speed_px_ms": 1.0},
    ],
    ids=["there", "back-fast", "slow"],
)
def test_every_size_is_read(version, options):
    result = read_codes(micro(version, **options))
    assert [reading.text for reading in result.readings] == [TEXTS[version]], result.reason
    (reading,) = result.readings
    assert (reading.symbology, reading.version) == ("MicroQRCode", version)
    assert reading.ec_level == (None if version == "M1" else "L")


def test_what_stays_unread_is_given_up_soon_and_says_why():
    """M1 has no evidence to spare: asked for more, it is possibly chance, however many windows show it."""
    config = ReadConfig(decode=DecodeConfig(min_confidence=0.999999), align=AlignConfig(good_score=1.0))
    records, _ = records_of([micro("M1")], Solver(config))
    unread = [record for record in records if isinstance(record, CodeUnread)]
    assert unread
    assert all(record.windows <= config.track.single_patience < config.track.patience for record in unread)
    assert unread[0].windows == config.track.single_patience
    assert unread[0].failure.reason is Reason.POSSIBLY_CHANCE
