"""What fails around the program: streams, directories, kernels that are kept, Ctrl-C: one line, a status."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
import sample_results

from evqr import main as cli
from evqr.cli import options
from evqr.errors import BackendError, RecordingError
from evqr.recording import open_recording
from evqr.recording.options import RecordingOptions

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="devices, signals and permissions of POSIX")


@pytest.fixture
def recording(tmp_path):
    return str(sample_results.recording(tmp_path / "line3.h5"))


@pytest.fixture
def reads(monkeypatch):
    """Make the reader give a result, or raise."""
    monkeypatch.setattr("evqr.cli.options.prepare", lambda backend, device: None)

    def give(result):
        def read_codes(source, **options):
            if isinstance(result, BaseException):
                raise result
            return result

        monkeypatch.setattr("evqr.offline.read_codes", read_codes)

    return give


def run(capsys, *arguments):
    status = cli.run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out.splitlines(), captured.err.splitlines()


class Full(io.StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_one_line(capsys, monkeypatch, reads, recording):
    reads(sample_results.read_result())
    for arguments in (["read", recording], ["read", recording, "--json"], ["--help"], ["info", recording]):
        monkeypatch.setattr(sys, "stdout", Full())
        assert cli.run(arguments) == 2
        err = capsys.readouterr().err.splitlines()
        assert err == ["evqr: standard output cannot be written: No space left on device"]


def test_a_closed_standard_output_is_one_line_once_it_is_needed(
    capsys, monkeypatch, reads, recording, tmp_path
):
    reads(sample_results.read_result())
    monkeypatch.setattr(sys, "stdout", None)
    assert cli.run(["read", recording]) == 2
    assert capsys.readouterr().err.splitlines() == ["evqr: standard output cannot be written: it is closed"]
    assert cli.run(["read", recording, "--text", "--output", str(tmp_path / "texts")]) == 0
    assert (tmp_path / "texts").read_text() == "LOT 42\n"
    assert sys.stdout is None


def test_a_full_standard_error_takes_nothing_from_the_result(capsys, monkeypatch, reads, recording):
    reads(sample_results.read_result(sample_results.reading(warnings=("odd",))))
    monkeypatch.setattr(sys, "stderr", Full())
    assert cli.run(["read", recording, "--text"]) == 0
    assert cli.run(["info", "nowhere.h5"]) == 2
    assert capsys.readouterr().out == "LOT 42\n"


def test_a_fault_of_the_program_is_one_line_and_a_status_of_its_own(capsys, monkeypatch, reads, recording):
    reads(ZeroDivisionError("a\nbug"))
    status, out, err = run(capsys, "read", recording)
    assert (status, out, len(err)) == (3, [], 1)
    assert err[0] == f"evqr: {recording}: ZeroDivisionError: a bug; --debug shows where"
    status, out, err = run(capsys, "read", recording, "--debug")
    assert status == 3
    assert err[0].startswith("Traceback") and "raise result" in "\n".join(err)
    status, out, err = run(capsys, "read", recording, recording, "--json")
    assert (status, json.loads(out[0])["reason_code"], err) == (3, "failed", [])

    monkeypatch.setattr("evqr.recording.summarise", lambda *args, **options: [][0])
    assert run(capsys, "info", recording) == (
        3, [], ["evqr: unexpected IndexError: list index out of range; --debug shows where"],
    )  # fmt: skip
    status, _, err = run(capsys, "--debug", "info", recording)
    assert (status, err[0], err[-1]) == (
        3, "Traceback (most recent call last):", "evqr: unexpected IndexError: list index out of range",
    )  # fmt: skip


def test_debug_shows_where_a_worker_failed(monkeypatch, tmp_path):
    """The worker is another process: what it prints goes to its own standard error."""
    broken = "import evqr.offline\nevqr.offline.read_codes = lambda source, **options: [][0]\n"
    (tmp_path / "sitecustomize.py").write_text(broken)
    for name in ("a", "b"):
        (tmp_path / name).touch()
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    script = "from evqr.main import run; raise SystemExit(run())"
    for debug, shown in (((), 0), (("--debug",), 2)):
        done = subprocess.run(
            [sys.executable, "-c", script, "read", "a", "b", "--jobs", "2", "--backend", "numpy", *debug],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 3
        assert done.stderr.count("Traceback (most recent call last)") == shown, done.stderr
        assert done.stderr.count("IndexError: list index out of range") == 2 + shown


def test_ctrl_c_while_reading_is_one_line(capsys, reads, recording):
    reads(KeyboardInterrupt())
    assert run(capsys, "read", recording) == (130, [], ["evqr: interrupted"])


def python(code, **environment):
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, **environment},
    )  # fmt: skip


@POSIX
@pytest.mark.parametrize("where", ["Python", "a destructor", "compiled code", "a thread"])
def test_ctrl_c_ends_the_program_within_a_second(where):
    """Compiled code does not hear of it, nor does a thread that the program waits for at its end."""
    work = {
        "Python": "while True: time.sleep(0.01)",
        "a destructor": "type('Slow', (), {'__del__': lambda self: time.sleep(9)})(); time.sleep(9)",
        "compiled code": "hashlib.pbkdf2_hmac('sha256', b'a', b'b', 40_000_000)",
        "a thread": "threading.Thread(target=time.sleep, args=(9,)).start(); time.sleep(9)",
    }[where]
    code = f"""
import hashlib, sys, threading, time
from evqr import main
def work():
    print("at work", flush=True)
    {work}
main.run = lambda arguments=None: main.run_command(work)
main.main()
"""
    with python(code) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "at work\n"
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
        assert time.monotonic() - began < 1.5
        assert process.stderr.read() == "evqr: interrupted\n"


def test_ctrl_c_while_the_program_is_loaded_is_one_line():
    code = """
import sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "evqr.main":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
from evqr.__main__ import main
main()
"""
    with python(code) as process:
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "evqr: interrupted\n")


@pytest.fixture
def forbidden():
    """A folder in which nothing may be read or written, but listed, by whoever runs within `nobody`."""
    folder = Path(tempfile.mkdtemp(dir="/tmp"))
    (folder / "out").mkdir()
    for name in ("shut", "bag"):
        (folder / name).mkdir()
    (folder / "bag" / "metadata.yaml").write_text("version: 9")
    for name in ("a.h5", "shut/a.h5"):
        sample_results.recording(folder / name)
    (folder / "a.txt").write_text("0 1 1 1\n" * 9)
    for name, mode in (("a.h5", 0), ("a.txt", 0), ("shut", 0), ("bag", 0), ("out", 0o555), (".", 0o755)):
        (folder / name).chmod(mode)
    yield folder
    for name in ("shut", "bag", "out"):
        (folder / name).chmod(0o700)
    shutil.rmtree(folder)


@contextlib.contextmanager
def nobody():
    """As a user who is not root: root may read and write whatever the permissions."""
    as_root = os.geteuid() == 0
    if as_root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if as_root:
            os.seteuid(0)


@POSIX
def test_what_may_not_be_read_or_written_is_one_line(capsys, forbidden, recording, reads, tmp_path):
    reads(sample_results.read_result())
    pytest.importorskip("matplotlib.backends.backend_agg")
    readable = forbidden / "readable.h5"
    readable.write_bytes(Path(recording).read_bytes())
    # what is needed is imported by root: others may not be let into where Python is
    run(capsys, "info", readable, "--picture", tmp_path / "seen.png")
    run(capsys, "read", readable, "--picture", tmp_path / "read.png")
    run(capsys, "convert", readable, tmp_path / "converted.npz")
    run(capsys, "simulate", tmp_path / "nowhere" / "made.h5")
    commands = [
        ("info", "a.h5"), ("info", "a.txt"), ("info", "bag"), ("info", "shut/a.h5"),
        ("convert", "a.h5", "x.npz"),
        ("convert", "readable.h5", "out/x.npz"), ("convert", "readable.h5", "shut/x.npz"),
        ("info", "readable.h5", "--picture", "out/x.png"), ("info", "readable.h5", "--picture", "shut/x.png"),
        ("read", "readable.h5", "--output", "out/x"), ("read", "readable.h5", "--output", "shut/x"),
        ("read", "readable.h5", "--picture", "out/pictures"), ("simulate", "shut/x.h5"),
    ]  # fmt: skip
    places = {"a.h5", "a.txt", "bag", "shut", "out", "readable.h5", "x.npz"}
    for command in commands:
        words = [forbidden / word if word.split("/")[0] in places else word for word in command]
        with nobody():
            status, _, err = run(capsys, *words)
        assert (status, len(err)) == (2, 1), (command, err)
        assert "Permission denied" in err[0] and str(forbidden) in err[0], err
    for source in ("a.h5", "bag", "shut", "shut/a.h5", "shut/*.h5"):
        with (
            nobody(),
            pytest.raises(RecordingError, match=r"cannot be read \(Permission denied\); check its perm"),
        ):
            open_recording(forbidden / source)


@POSIX
def test_what_may_not_be_read_stops_no_other(capsys, forbidden, reads):
    with nobody():
        status, out, err = run(capsys, "read", forbidden / "shut" / "a.h5", forbidden / "shut", "--json")
    reasons = [json.loads(line)["reason"] for line in out]
    assert status == 2 and err == [] and len(reasons) == 2
    assert all("cannot be read (Permission denied); check its permissions" in reason for reason in reasons)


@POSIX
@pytest.mark.parametrize("loading", ["evqr", "evqr.errors", "click", "evqr.cli.running"])
def test_ctrl_c_is_one_line_from_the_first_import_of_the_program_on(loading):
    code = f"""
import os, signal, sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == {loading!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupted())
import evqr_command
evqr_command.main()
"""
    with python(code) as process:
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "evqr: interrupted\n")


def test_the_program_seldom_looks_for_garbage_and_not_at_its_end():
    code = """
import atexit, gc
from evqr import main
atexit.register(lambda: print(gc.get_freeze_count() > 10_000))  # what is registered last goes first
main.run = lambda arguments=None: print(gc.get_threshold()[0] > 10_000) or 0
main.main()
"""
    with python(code) as process:
        assert process.communicate(timeout=60) == ("True\nTrue\n", "")


def test_shells_complete_commands_and_options(capsys, monkeypatch):
    monkeypatch.setenv("_EVQR_COMPLETE", "bash_source")
    status, out, _ = run(capsys)
    assert status == 0 and any("complete -o nosort -F _evqr_completion evqr" in line for line in out)
    monkeypatch.setenv("_EVQR_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "evqr do")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert run(capsys)[:2] == (0, ["plain,doctor"])
    monkeypatch.setenv("COMP_WORDS", "evqr read --jo")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert run(capsys)[:2] == (0, ["plain,--jobs"])


def test_no_arguments_print_help(capsys):
    status, out, err = run(capsys)
    assert (
        (status, err) == (0, [])
        and out[0].startswith("Usage: evqr")
        and any("WARP_CACHE_PATH" in o for o in out)
    )


def test_messages_name_options_or_parameters(capsys, tmp_path):
    import numpy as np

    from evqr.recording import open_recording

    path = tmp_path / "a.npz"
    np.savez(path, **{name: np.arange(1, 5) for name in "txy"}, p=np.ones(4))
    with pytest.raises(ValueError, match=r'pass sensor="WxH"$'):
        open_recording(path)
    assert run(capsys, "info", path)[2] == [f"evqr: {path}: sensor size unknown: pass --sensor WxH"]
    _, out, _ = run(capsys, "read", path, "--json")
    assert json.loads(out[0])["reason"].endswith("pass --sensor WxH")
    said = options.in_options('choose: stream="/a b"; leave out stream=')
    assert said == "choose: --stream '/a b'; leave out --stream"
    assert {f"--{name.replace('_', '-')}" for name in RecordingOptions.__annotations__} == {
        options.in_options(f"{name}=") for name in RecordingOptions.__annotations__
    }


# ---- kernels


def warp_cache():
    from evqr_kernels import get_backend

    get_backend("warp")
    from evqr_kernels.warp_backend import cache

    return cache


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """Warp's cache, in a directory of the test's."""
    import warp as wp

    cache = warp_cache()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "kernels"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "kernels").mkdir()
    (tmp_path / "temporary").mkdir()
    return cache


def small_module(name):
    import warp as wp

    module = wp.get_module(f"evqr_test_{name}")

    @wp.kernel(module=module, enable_backward=False)
    def fill(values: wp.array(dtype=wp.float32)):  # pyright: ignore[reportInvalidTypeForm]
        values[wp.tid()] = 3.0

    return module, fill


@pytest.mark.parametrize("damage", [b"", b"\x7fELF cut short"])
def test_kernels_that_were_cut_short_are_compiled_again(cache, caplog, capfd, damage):
    import warp as wp

    module, kernel = small_module(f"cut_{len(damage)}")
    assert cache.load_module(module, "cpu") is False
    (compiled,) = Path(cache.directory()).rglob("*.o")
    compiled.write_bytes(damage)
    module.unload()
    assert cache.load_module(module, "cpu") is True
    assert f"compiled kernels in {compiled.parent} were damaged" in caplog.text
    values = wp.zeros(2, dtype=wp.float32, device="cpu")
    wp.launch(kernel, 2, outputs=[values], device="cpu")
    assert values.numpy().tolist() == [3.0, 3.0]
    assert capfd.readouterr().err == ""


def test_a_directory_that_cannot_be_written_is_replaced_by_another(cache, caplog, tmp_path):
    import warp as wp

    module, _ = small_module("unwritable")
    wp.config.kernel_cache_dir = str(tmp_path / "nowhere")
    assert not cache.is_compiled(module, "cpu")
    place = Path(cache.directory())
    assert place.parent.parent == tmp_path / "temporary"
    assert place.parent.stat().st_mode & 0o077 == 0  # what is there is run: nobody else may write it
    assert f"nowhere cannot be written (No such file or directory): compiled kernels are kept in {place}" in (
        caplog.text
    )
    assert cache.load_module(module, "cpu") is False
    assert cache.is_compiled(module, "cpu")


def test_what_a_directory_that_cannot_be_written_holds_is_used(cache, monkeypatch, tmp_path):
    module, _ = small_module("half")
    cache.load_module(module, "cpu")
    kept = cache.directory()
    monkeypatch.setattr(cache, "why_not_writable", lambda place: OSError(30, "Read-only file system"))
    assert cache.is_compiled(module, "cpu") and cache.directory() == kept
    other, _ = small_module("other_half")
    assert not cache.is_compiled(other, "cpu")
    assert cache.directory() != kept and cache.is_compiled(module, "cpu")


def test_nowhere_to_keep_kernels_is_one_line(cache, monkeypatch, tmp_path):
    import warp as wp

    from evqr.device import kernels_failing

    module, _ = small_module("nowhere")
    (tmp_path / "file").touch()
    wp.config.kernel_cache_dir = str(tmp_path / "file" / "nowhere")
    monkeypatch.setattr(cache, "own_directory", lambda: os.mkdir(tmp_path / "no" / "where"))
    with pytest.raises(BackendError, match="set WARP_CACHE_PATH") as raised, kernels_failing():
        cache.load_module(module, "cpu")
    assert str(raised.value).count("\n") == 0 and "nor among temporary files" in str(raised.value)
