"""Options of the test suite."""

from hypothesis import settings

# The same examples in every run: what fails is a change, not chance.  Machines differ in speed: no deadline.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


def pytest_addoption(parser):
    parser.addoption(
        "--device",
        action="append",
        help="run the kernels on this device only, 'cuda:0' say; may be repeated; default: on all there are",
    )
    parser.addoption(
        "--whole",
        action="store_true",
        help="tests/shared/test_streams.py: read all of each recording, not a part of it; takes minutes",
    )
