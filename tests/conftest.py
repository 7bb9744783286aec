"""Options of the test suite, and how processes share it out."""

import pytest
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


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let processes share tests out by the file, and one of them have all of Taichi.

    Taichi compiles a hundred kernels anew in each process that uses them, which takes it 20 s; and scenes
    that a file makes once are made once.  Files with most tests go first, so that what is left at the end
    is small.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            if "taichi" in nodeid:
                return "taichi"
            return nodeid if nodeid.startswith("tests/docs/") else nodeid.partition("::")[0]

    return Scheduler(config, log)
