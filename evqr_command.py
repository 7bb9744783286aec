"""The program `evqr`, from its first line on: Ctrl-C while it is being loaded is one line and a status, too.

It is no part of the package: loading that is what takes the time.
"""

# signal itself makes enums of all signals first, and may be interrupted there
import _signal  # pyright: ignore[reportMissingImports] (it has no stubs)
import os
import sys


def _interrupted(number: int, frame: object) -> None:
    os.write(2, b"evqr: interrupted\n")
    os._exit(130)


# not where Ctrl-C is ignored, as behind "&", nor in processes that multiprocessing starts: they load this too
_ours = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler and "__mp_main__" not in sys.modules
if _ours:
    _signal.signal(_signal.SIGINT, _interrupted)


def main() -> None:
    """Run the command line and exit with its status."""
    import evqr.main  # noqa: F401  (it is what takes the time)
    from evqr.__main__ import main as run_and_exit

    if _ours:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)
    run_and_exit()
