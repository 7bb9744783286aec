"""Codes that turn and tilt as they pass: what single windows read, the whole reads, and each once."""

import math

import numpy as np
import pytest
from any_motion import moving_code, similarity, tilted

from evqr import ReadConfig, ReadStatus, read_codes, read_windows
from evqr.config import DecodeConfig
from evqr.solver import Solver
from evqr.stream import track as tracks
from evqr.stream.scheduler import StreamScheduler
from evqr.symbol.decoded import DecodeFailure

SIZE = 25


def tilting(t_us):
    """Tilts by 8.5 degrees a millisecond; in the first window it is taken for turned by a right angle."""
    t = t_us - 4_000
    x, y = 160 + 4.886e-3 * t * math.cos(1.313), 120 + 4.886e-3 * t * math.sin(1.313)
    return tilted(similarity((x, y), SIZE, 4.1133, 1.7925), SIZE, math.radians(8.458e-3 * t), 0.1842)


def turning(t_us):
    """Turns by 2.9 degrees a millisecond about a point 80 px away; a corner's pose is off in most windows."""
    start = 1.23195
    at = math.radians(2.9147e-3) * (t_us - 4_500) + start
    x, y = (160 + 80.36 * (math.cos(at) - math.cos(start)), 120 + 80.36 * (math.sin(at) - math.sin(start)))
    return similarity((x, y), SIZE, 4.47368, at + 3.71815)


@pytest.fixture(scope="module")
def recordings():
    wide = {"width": 320, "height": 240}
    return {
        tilting: moving_code(tilting, 4_500, text="T15", ec="L", seed=15, **wide),
        turning: moving_code(turning, 9_000, text="T8", ec="Q", seed=8, **wide),
    }


@pytest.mark.parametrize(("pose", "text"), [(tilting, "T15"), (turning, "T8")])
def test_what_single_windows_read_the_whole_reads_once(pose, text, recordings):
    windows = list(read_windows(recordings[pose], config=ReadConfig(max_windows=10)))
    alone = [window.text for window in windows if window.status is ReadStatus.READ]
    assert alone
    assert set(alone) == {text}
    assert [reading.text for reading in read_codes(recordings[pose]).readings] == [text]


def test_more_grids_a_window_do_not_make_chance_likelier(recordings, monkeypatch):
    """Nothing decodes: of each window at most so many grids are tried, and asked for so much less chance."""
    asked, window = [], []

    def refused(q, space, *, config, effort):
        window[-1].append(config.wrong_grids)
        return DecodeFailure(reason="no_content", detail="", space=space)

    class Counted(tracks.Track):
        def begin(self):
            window.append([])
            return super().begin()

        def follow(self, part):
            window.append([])
            return super().follow(part)

    monkeypatch.setattr("evqr.work.decode_grid", refused)
    monkeypatch.setattr("evqr.stream.scheduler.Track", Counted)
    events = recordings[turning]
    scheduler = StreamScheduler([Solver()], events.width, events.height)
    scheduler.push(events)
    scheduler.close()
    asked = [grids for grids in window if grids]
    one = DecodeConfig().wrong_grids
    assert len(asked) > 5
    assert max(map(len, asked)) > 2
    for grids in asked:
        assert sum(one / grid for grid in grids) <= 1.0
    assert asked[0] == [one]


def test_settings_for_one_of_several_grids():
    config = DecodeConfig(charset="utf-8")
    assert config.among(1) is config
    several = config.among(4)
    assert several.charset == "utf-8"
    np.testing.assert_allclose(several.log_chance_limit, config.log_chance_limit - math.log(4.0))
