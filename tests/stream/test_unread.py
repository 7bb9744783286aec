"""How many codes were followed in vain."""

import numpy as np
import pytest

from evqr.config import AlignConfig, ReadConfig, SchedulerConfig
from evqr.fit.detection import Target
from evqr.motion import Motion
from evqr.reason import Reason
from evqr.stream.records import CodeUnread
from evqr.stream.unread import UnreadCodes
from evqr.symbol import qr
from evqr.symbol.decoded import DecodeFailure

SIDE = 21 * 4.0
GOOD = AlignConfig().good_score


def target(x, time_us, velocity=1000.0, version=1):
    pose = np.array([[4.0, 0.0, x], [0.0, 4.0, 100.0], [0.0, 0.0, 1.0]])
    return Target(qr.space(version), pose, Motion(np.array([velocity, 0.0]), time_us))


def followed(where, mean_score=0.9):
    failure = DecodeFailure(reason=Reason.TOO_MANY_ERRORS, detail="", space=where.space)
    return CodeUnread(0, 1, 2, 1.0, failure, where, mean_score=mean_score)


@pytest.fixture
def unread():
    return UnreadCodes(ReadConfig())


def test_what_hardly_agrees_with_a_code_is_a_guess(unread):
    unread.add(followed(target(100.0, 0), GOOD - 0.01))
    assert len(unread) == 0
    unread.add(followed(target(100.0, 0), GOOD))
    assert len(unread) == 1


def test_a_code_that_is_lost_and_found_again_is_one(unread):
    for number in range(10):
        unread.add(followed(target(100.0 + 10.0 * number, 10_000 * number)))
    assert len(unread) == 1
    unread.add(followed(target(400.0, 90_000)))
    unread.add(followed(target(100.0, 90_000)))
    assert len(unread) == 3


def test_what_is_where_a_code_was_read_is_that_code(unread):
    unread.add(followed(target(100.0, 0, version=3)))  # before, and taken for another size
    unread.read(target(110.0, 10_000))
    assert len(unread) == 0
    unread.add(followed(target(130.0, 30_000, velocity=1100.0)))
    assert len(unread) == 0
    unread.add(followed(target(130.0 + SIDE, 30_000)))  # the label beside it
    assert len(unread) == 1


def test_a_long_stream_takes_little_memory():
    unread = UnreadCodes(ReadConfig(scheduler=SchedulerConfig(remembered_codes=4)))
    for number in range(20):
        unread.add(followed(target(100.0, 1_000_000 * number)))
        unread.read(target(-400.0, 1_000_000 * number))
    assert len(unread) == 20
    assert max(len(unread._unread), len(unread._read)) == 4
