"""What a command runs in: standard streams that may fail, Ctrl-C, what libraries log, and exit statuses."""

from __future__ import annotations

import atexit
import contextlib
import errno
import gc
import io
import logging
import os
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import click

from evqr.cli.options import BAD, FAILED, INTERRUPTED, PIPE_CLOSED, in_options, note
from evqr.errors import EvqrError

PATIENCE_S = 0.4
"""Time that Ctrl-C gives the program to end by itself [s]: compiled code does not hear of it."""

FEW_COLLECTIONS = 50_000
"""New objects after which Python looks for cycles of them that nothing refers to; its own number is 700."""


def collect_garbage_rarely() -> None:
    """See to it that Python seldom looks for garbage, and not at all at its end.

    Most objects of a command are classes and functions of what it imports, and none of them is garbage: to
    look through them all, twice on the way to the first record and once at the end, takes from a tenth to a
    third of a short command's processor time.
    """
    gc.set_threshold(FEW_COLLECTIONS)
    atexit.register(gc.freeze)


def run_command(command: Callable[[], int], *, debug: bool = False) -> int:
    """Run a command and return its exit status, with one line on stderr for whatever went wrong.

    Parameters
    ----------
    command : callable
        Returns an exit status.
    debug : bool
        Print the traceback of what is no fault of the user's, too.
    """
    try:
        with _standard_output() as output, logged_as_notes():
            try:
                status = command()
                output.flush()
                return status
            except OSError as error:
                if output.failed is not error:
                    raise
                _print_no_more()
                if isinstance(error, BrokenPipeError):  # who read our output has left
                    return PIPE_CLOSED
                return _refuse(f"standard output cannot be written: {error.strerror or error}")
    except click.exceptions.Exit as done:  # --help, --version
        return done.exit_code
    except click.UsageError as error:
        name = error.ctx.command_path if error.ctx else "evqr"
        return _refuse(f"{error.format_message()} (see '{name} --help')")
    except click.ClickException as error:
        return _refuse(error.format_message())
    except EvqrError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        _say("evqr: interrupted")
        return INTERRUPTED
    except PermissionError as error:
        what = os.fsdecode(error.filename) if error.filename else "a file or folder"
        return _refuse(f"{what}: cannot be used ({error.strerror or error}); check its permissions")
    except Exception as error:  # no fault of the user's
        return unexpected(error, debug=debug)


def unexpected(error: BaseException, *, debug: bool) -> int:
    """Say in one line that the program failed, and return the status for it."""
    if debug:
        _say("".join(traceback.format_exception(error)).rstrip())
    where = "" if debug else "; --debug shows where"
    _say(f"evqr: unexpected {type(error).__name__}: {_one_line(error)}{where}")
    return FAILED


def end_within_a_second_of_ctrl_c() -> None:
    """See to it that Ctrl-C ends the program, wherever it is from now on.

    Python raises KeyboardInterrupt in the main thread as soon as that runs Python again, which may be long
    after: while kernels are compiled, say, or while threads are waited for.  A thread of ours hears of the
    signal as well, and ends the program where the exception has not.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, as behind "&"
        return
    heard, written = socket.socketpair()
    written.setblocking(False)
    signal.set_wakeup_fd(written.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_end_soon, args=(heard, written), daemon=True).start()
    hook = sys.unraisablehook
    # an exception that a destructor swallows is of no interest: the thread ends the program all the same
    sys.unraisablehook = lambda seen: None if seen.exc_type is KeyboardInterrupt else hook(seen)


def leave_ctrl_c_to_the_thread() -> None:
    """Raise no KeyboardInterrupt any more: the work is done, and what is left is Python's own end."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda number, frame: None)


def end_at_once(status: int) -> NoReturn:
    """End without waiting for threads, and with this status whatever Python makes of an interrupt.

    Python kills itself by the signal where the interrupt came while it ran code from a text, handled or not.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(status)


_message_out = threading.Event()


def _end_soon(heard: socket.socket, _kept: socket.socket) -> None:
    while signal.SIGINT not in heard.recv(1):
        pass
    if not _message_out.wait(PATIENCE_S):
        os.write(2, b"evqr: interrupted\n")
    threading.Event().wait(0.1)  # time to end as programs do
    os._exit(INTERRUPTED)


@contextlib.contextmanager
def _standard_output() -> Iterator[_Output]:
    """Let a text that the terminal cannot show be no failure, and see when writing is one."""
    before = sys.stdout
    if isinstance(before, io.TextIOWrapper):
        before.reconfigure(errors="backslashreplace")
    # Files would get the number of a closed stream, and what libraries print would go into them.
    reserved = None if before is not None else os.open(os.devnull, os.O_RDWR)
    output = _Output(before)
    sys.stdout = output
    try:
        yield output
    finally:
        sys.stdout = before
        if reserved is not None:
            os.close(reserved)


class _Output:
    """Standard output, which may be closed or full.

    Attributes
    ----------
    failed : OSError or None
        Why something could not be written.
    """

    def __init__(self, stream: Any) -> None:
        self.failed: OSError | None = None
        self._stream = io.StringIO() if stream is None else stream
        self._closed = stream is None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or keep why not."""
        with self._kept():
            if self._closed:
                raise OSError(errno.EBADF, "it is closed")
            return self._stream.write(text)

    def flush(self) -> None:
        """Write what is not written yet, or keep why not."""
        with self._kept():
            self._stream.flush()

    @contextlib.contextmanager
    def _kept(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failed = error
            raise


def _print_no_more() -> None:
    """Keep Python from complaining once more when it flushes standard output at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def logged_as_notes() -> Iterator[None]:
    """Print what our packages log as notes, and nothing of what others have to say about the surroundings."""
    handler = _Notes(logging.WARNING)
    ours = [logging.getLogger(name) for name in ("evqr", "evqr_kernels")]
    others = logging.getLogger("matplotlib")  # where its own cache is, say
    level = others.level
    for logger in ours:
        logger.addHandler(handler)
    others.setLevel(logging.ERROR)
    try:
        yield
    finally:
        for logger in ours:
            logger.removeHandler(handler)
        others.setLevel(level)


class _Notes(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        note(record.getMessage())


def _refuse(message: str) -> int:
    _say(f"evqr: {in_options(_one_line(message))}")
    return BAD


def _say(text: str) -> None:
    with contextlib.suppress(OSError):  # standard error may be full or closed as well
        click.echo(text, err=True)
        _message_out.set()


def _one_line(error: Any) -> str:
    return " ".join(str(error).split())
