"""Options of the test suite."""


def pytest_addoption(parser):
    parser.addoption(
        "--device",
        action="append",
        help="run the kernels on this device only, 'cuda:0' say; may be repeated; by default on all there are",
    )
