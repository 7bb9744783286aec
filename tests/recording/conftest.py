"""Fixtures for the tests of recordings."""

import pytest
from recording_files import make_events

from evqr.events.array import EventArray


@pytest.fixture
def events() -> EventArray:
    """A thousand events."""
    return make_events(1000)
