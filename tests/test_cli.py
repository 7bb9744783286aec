"""The command line: what goes to stdout and to stderr, exit status, options."""

from __future__ import annotations

import base64
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import sample_results

from evqr import main as cli
from evqr.cli import options
from evqr.reason import Reason
from evqr.recording import open_recording
from evqr.results import ReadResult, ReadStatus
from evqr.symbol.gs1 import elements_of
from evqr.symbol.payload import ContentType, StructuredAppend
from evqr_kernels.extras import install_command

READING_KEYS = (
    "recording "
    "status text bytes_base64 symbology version ec_level mask rows columns t_first_us t_last_us t_read_us "
    "windows corners_px motion_px_per_s confidence log10_chance errors_corrected unused_correction grade "
    "compute_ms warnings "
    "symbology_identifier content_type eci charset charset_source structured_append gs1 message"
).split()
WINDOW_KEYS = (
    "recording "
    "status reason reason_code window t_start_us t_end_us n_events text version modules motion_px_per_s "
    "affine stage_one_iterations stage_two_iterations codes compute_ms warnings"
).split()


@pytest.fixture(autouse=True)
def compiled_kernels(monkeypatch):
    """No test here depends on whether this machine has run kernels before."""
    monkeypatch.setattr("evqr.cli.options.prepare", lambda backend, device: None)


@pytest.fixture
def recording(tmp_path):
    return str(sample_results.recording(tmp_path / "line3.h5"))


@pytest.fixture
def reads(monkeypatch):
    """Make the reader give a result; returns the options that it was called with."""

    def give(result):
        given = {}

        def read_codes(source, **options):
            given.update(options, source=source)
            if isinstance(result, BaseException):
                raise result
            return result

        monkeypatch.setattr("evqr.offline.read_codes", read_codes)
        return given

    return give


def run(capsys, *arguments):
    """Exit status, lines on stdout, lines on stderr."""
    status = cli.run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out.splitlines(), captured.err.splitlines()


def test_json_of_a_reading(capsys, reads, recording):
    reads(sample_results.read_result())
    status, out, err = run(capsys, "read", recording, "--json")
    assert (status, len(out), err) == (0, 1, [])
    record = json.loads(out[0])
    assert list(record) == READING_KEYS
    assert record["status"] == "read"
    assert base64.b64decode(record["bytes_base64"]) == b"LOT 42"
    assert record["corners_px"] == sample_results.READING.corners_px.tolist()
    assert record["motion_px_per_s"] == [4000.0, -500.0]
    assert record["compute_ms"] == {"motion": 1.25, "total": 31.0}


def test_json_is_one_line_a_reading_whatever_the_text(capsys, reads, recording):
    nasty = 'two\nlines, "quotes", \N{SNOWMAN}, \ud800'
    reads(sample_results.read_result(sample_results.reading(text=nasty), sample_results.reading(text="b")))
    status, out, _ = run(capsys, "read", recording, "--json")
    assert status == 0
    assert [json.loads(line)["text"] for line in out] == [nasty, "b"]


def test_what_a_code_says_beside_its_text(capsys, reads, recording, monkeypatch):
    monkeypatch.setitem(sys.modules, "biip", None)
    elements_of.cache_clear()
    gs1 = sample_results.reading(
        text="10A\x1d21B", data=b"10A\x1d21B", symbology_identifier="]Q3", content_type=ContentType.GS1
    )
    parts = [
        sample_results.reading(
            text=text,
            data=text.encode(),
            symbology_identifier="]Q1",
            structured_append=StructuredAppend(**part),
        )
        for text, part in (
            ("two", {"index": 1, "count": 2, "parity": 22}),
            ("one", {"index": 0, "count": 2, "parity": 22}),
            ("three", {"index": 2, "count": 3, "parity": 7}),
        )
    ]
    reads(sample_results.read_result(gs1, gs1, *parts))
    status, out, err = run(capsys, "read", recording)
    assert (status, *out[:2]) == (0, f"{recording}:", "10A<GS>21B")
    assert "  content     gs1, ]Q3, several character sets (guessed)" in out
    assert "  message     part 2 of 2, parity 22" in out
    assert out[-2].startswith("message of 2 parts, parity 22: 'onetwo'")
    assert out[-1] == "message of 3 parts, parity 7: 1 passed, missing: 1, 2"
    assert len(err) == 1 and install_command("gs1") in err[0]  # once, for two codes

    _, out, _ = run(capsys, "read", recording, "--json")
    records = [json.loads(line) for line in out]
    assert records[0]["gs1"] == [] and "[gs1]" in records[0]["warnings"][0]
    assert records[2]["structured_append"] == {"index": 1, "count": 2, "parity": 22}
    assert records[2]["message"] == records[3]["message"] and records[2]["message"]["text"] == "onetwo"
    assert (records[4]["message"]["text"], records[4]["message"]["missing"]) == (None, [0, 1])
    elements_of.cache_clear()


def test_text_of_a_reading(capsys, reads, recording):
    reads(sample_results.read_result())
    status, out, err = run(capsys, "read", recording)
    assert (status, *out[:2], err) == (0, f"{recording}:", "LOT 42", [])
    assert "QRCode 1-M" in out[2]
    assert any("4031 px/s" in line for line in out)  # hypot(4000, 500)


def test_a_code_cannot_drive_the_terminal(capsys, reads, recording):
    reads(sample_results.read_result(sample_results.reading(text="a\x1b[2Jb\nc\u202ed")))
    _, out, _ = run(capsys, "read", recording)
    assert out[1] == r"a\x1b[2Jb\nc\u202ed"


def test_a_symbol_without_level_and_mask(capsys, reads, recording):
    reading = sample_results.reading(symbology="DataMatrix", version="22x22", ec_level=None, mask=None)
    reads(sample_results.read_result(reading))
    _, out, _ = run(capsys, "read", recording)
    assert out[2] == "  symbol      DataMatrix 22x22, codewords corrected: 2"
    _, out, _ = run(capsys, "read", recording, "--json")
    record = json.loads(out[0])
    assert (record["version"], record["ec_level"], record["mask"]) == ("22x22", None, None)


def test_nothing_read(capsys, reads, recording):
    reads(sample_results.no_read_result())
    status, out, _ = run(capsys, "read", recording, "--json")
    assert status == 1
    (record,) = map(json.loads, out)
    assert record["status"] == "no_read"
    assert record["reason"] == "no finder pattern was seen"
    assert record["reason_code"] == "no_finder_patterns"
    assert record["seen"] == {
        "events": 1000, "duration_us": 0, "windows": 12, "searches": 0, "codes_not_decoded": 0,
    }  # fmt: skip

    status, out, _ = run(capsys, "read", recording)
    assert status == 1
    assert out[1] == "nothing read: no finder pattern was seen"


def test_options_reach_the_reader(capsys, reads, recording):
    given = reads(sample_results.read_result())
    options = "--window-us 250 --max-windows 9 --lag-us 300,650.5 --vote soft --backend numpy --threads 2"
    options += " --symbologies QR,rmqr"
    assert run(capsys, "read", recording, *options.split())[0] == 0
    config = given["config"]
    assert (config.window_us, config.max_windows, config.lag_us) == (250, 9, (300.0, 650.5))
    assert config.vote.value == "soft"
    assert config.symbologies == ("QRCode", "RMQRCode")
    assert (given["backend"], given["device"], given["threads"]) == ("numpy", "cpu", 2)
    assert given["source"] == Path(recording)


def test_sensor_and_time_unit_reach_the_recording(capsys, reads, tmp_path):
    events = sample_results.events()
    path = tmp_path / "flat.npz"
    np.savez(path, t=events.t / 1e3, x=events.x, y=events.y, p=events.p)
    given = reads(sample_results.read_result())
    assert run(capsys, "read", path, "--sensor", "200x150", "--time-unit", "ms")[0] == 0
    assert (given["sensor"], given["time_unit"]) == ((200, 150), "ms")


def test_each_window(capsys, monkeypatch, recording):
    read = sample_results.WINDOW
    blank = dataclasses.replace(
        read,
        status=ReadStatus.NO_CODE,
        reason="no finder pattern",
        window=1,
        codes=(),
    )
    monkeypatch.setattr("evqr.offline.read_windows", lambda source, **options: iter([read, blank]))
    status, out, _ = run(capsys, "read", recording, "--each-window", "--json")
    first, second = map(json.loads, out)
    assert status == 0
    assert list(first) == list(second) == WINDOW_KEYS
    dark = np.array([[module == "1" for module in row] for row in first["modules"]])
    np.testing.assert_array_equal(dark, sample_results.MODULES < 0)
    assert first["affine"] == [0.25, 0.0, -10.5, 0.0, 0.25, -8.0]
    assert second["status"] == "no_code" and second["modules"] is None and second["affine"] is None

    two = dataclasses.replace(
        read, codes=(*read.codes, dataclasses.replace(read.codes[0], payload=None, reason="too many wrong"))
    )
    monkeypatch.setattr("evqr.offline.read_windows", lambda source, **options: iter([two]))
    assert run(capsys, "read", recording, "--each-window")[1][1].endswith("LOT 42, too many wrong")

    monkeypatch.setattr("evqr.offline.read_windows", lambda source, **options: iter([blank]))
    status, out, _ = run(capsys, "read", recording, "--each-window")
    assert status == 1
    assert "no finder pattern" in out[1]


def test_windows_come_as_they_are_read_and_ctrl_c_ends_it(capsys, monkeypatch, recording):
    def read_windows(source, **options):
        yield sample_results.WINDOW
        raise KeyboardInterrupt

    monkeypatch.setattr("evqr.offline.read_windows", read_windows)
    status, out, err = run(capsys, "read", recording, "--each-window", "--json")
    assert (status, len(out)) == (130, 1)
    assert err[-1] == "evqr: interrupted"


def test_many_recordings(capsys, monkeypatch, tmp_path):
    good, blank = tmp_path / "a.h5", tmp_path / "b.h5"
    missing = tmp_path / "missing.h5"
    for path in (good, blank):
        sample_results.recording(path)
    results = {good: sample_results.read_result(), blank: sample_results.no_read_result()}

    def read_codes(source, **options):
        with open_recording(source):
            return results[Path(source)]

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    status, out, err = run(capsys, "read", good, missing, blank, "--json")
    records = [json.loads(line) for line in out]
    assert [record["recording"] for record in records] == [str(good), str(missing), str(blank)]
    assert [record["status"] for record in records] == ["read", "error", "no_read"]
    assert str(missing) in records[1]["reason"]
    assert (status, err) == (2, [])
    assert run(capsys, "read", good, blank, "--json")[0] == 0
    assert run(capsys, "read", blank, blank, "--json")[0] == 1

    status, out, err = run(capsys, "read", good, missing)
    assert (status, out[0], out[1]) == (2, f"{good}:", "LOT 42")
    assert [line.startswith(f"evqr: {missing}: no such file") for line in err] == [True]


def test_jobs_read_in_workers(capsys, tmp_path):
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for path in paths:
        path.write_bytes(b"not events at all")
    status, out, _ = run(capsys, "read", *paths, "--json", "--jobs", 2)
    records = [json.loads(line) for line in out]
    assert status == 2
    assert [(record["recording"], record["status"]) for record in records] == [
        (str(p), "error") for p in paths
    ]
    assert all(str(path) in record["reason"] for path, record in zip(paths, records, strict=True))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("raed FILE", "raed"),
        ("read", "Missing argument"),
        ("read FILE --sensr 10x10", "--sensr"),
        ("read FILE --sensor 640", "'640' is no sensor size"),
        ("read FILE --sensor 0x480", "'0x480' is no sensor size"),
        ("read FILE --time-unit h", "'h'"),
        ("read FILE --window-us 0", "0 is not in the range"),
        ("read FILE --max-windows few", "'few'"),
        ("read FILE --lag-us 300", "'300' is no pair of lags"),
        ("read FILE --vote loudest", "'loudest'"),
        ("read FILE --symbologies qr,code39", "symbology must be one of QRCode, MicroQRCode"),
        (
            "read FILE --charset klingon",
            "charset must be a name, as utf-8 or shift_jis, or None, got 'klingon'",
        ),
        ("read FILE --backend cobol", "'cobol'"),
        ("read FILE --each-window --jobs 2", "leave out --each-window"),
        ("read FILE --json --text", "leave out one"),
        ("read FILE nowhere.h5 --picture p.png", "name a folder for the pictures"),
        ("read nowhere*.h5", "nowhere*.h5: no file matches this pattern"),
        ("read empty", "empty: no recordings in this folder"),
        ("read FILE --output nowhere/texts", "nowhere/texts: cannot be written (No such file or directory)"),
        ("read FILE --output FILE", "is a recording to be read"),
        ("read FILE --each-window --picture p.png", "leave out --each-window"),
        ("read FILE --picture p.xyz", "unknown picture format 'xyz'"),
        ("read FILE --picture nowhere/p.png", "no such folder"),
        ("read nowhere/a.h5", "nowhere/a.h5"),
        ("info nowhere/a.h5", "nowhere/a.h5"),
        ("simulate out.h5 --preset luxury", "'luxury'"),
        ("simulate out.csv", "out.csv: recordings are written with their truth as .h5"),
        ("simulate out.h5 --module-px -3", "module_px"),
        ("simulate nowhere/out.h5 --sensor 160x120 --module-px 3 --duration-us 500", "nowhere/out.h5"),
    ],
)
def test_bad_use_is_one_line(capsys, recording, monkeypatch, tmp_path, arguments, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    status, out, err = run(capsys, *(recording if word == "FILE" else word for word in arguments.split()))
    assert (status, out, len(err)) == (2, [], 1)
    assert err[0].startswith("evqr: ")
    assert told in err[0]


def test_what_the_kernels_refuse_is_bad_use(capsys, monkeypatch, recording):
    monkeypatch.undo()  # the real _prepare
    status, out, err = run(capsys, "read", recording, "--device", "cuda:99")
    assert (status, out, len(err)) == (2, [], 1)
    assert "cuda:99" in err[0]


def test_the_first_run_says_that_it_compiles(capsys, monkeypatch):
    import evqr_kernels.registry

    monkeypatch.undo()

    class Fresh:
        name = "fresh"
        fresh = True

        def devices(self):
            return ("cpu",)

        def needs_compile(self, device, calls):
            return self.fresh

        def load(self, device, calls):
            self.fresh = False

    kernels = Fresh()
    monkeypatch.setattr(evqr_kernels.registry, "get_backend", lambda name: kernels)
    options.prepare("auto", "cpu")
    assert "compiling kernels" in capsys.readouterr().err
    options.prepare("auto", "cpu")
    assert capsys.readouterr().err == ""


def test_warnings_of_a_recording_go_to_stderr(capsys, reads, tmp_path):
    events = sample_results.events()
    t = events.t.copy()
    t[[100, 101]] = t[[101, 100]] + np.array([3, 0])  # a little out of order
    path = tmp_path / "shuffled.npz"
    np.savez(path, t=t, x=events.x, y=events.y, p=events.p, width=160, height=120)
    given = reads(sample_results.read_result())

    def read_codes(source, **options):
        with open_recording(source, time_unit=options["time_unit"]) as opened:
            given["n"] = sum(len(chunk) for chunk in opened.chunks())
            return dataclasses.replace(sample_results.read_result(), warnings=opened.notes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evqr.offline.read_codes", read_codes)
        status, out, err = run(capsys, "read", path, "--json", "--time-unit", "us")
    assert (status, given["n"]) == (0, len(events))
    assert [json.loads(line)["status"] for line in out] == ["read"]
    (told,) = [line for line in err if "out of order" in line]
    assert told.startswith(f"evqr: {path}: ")
    assert json.loads(out[0])["warnings"] == [told.removeprefix(f"evqr: {path}: ")]


def test_progress_on_a_terminal_only(capsys, monkeypatch, recording):
    def read_codes(source, *, progress, **options):
        if progress is not None:
            for done_us in (5_000, 10_000, 20_000):
                progress(done_us, 20_000)
        return sample_results.read_result()

    monkeypatch.setattr("evqr.offline.read_codes", read_codes)
    assert run(capsys, "read", recording)[2] == []
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    status, out, err = run(capsys, "read", recording)
    assert (status, out[1]) == (0, "LOT 42")
    assert any("line3.h5" in line for line in err)


def test_picture(capsys, reads, recording, tmp_path):
    pytest.importorskip("matplotlib", reason="extra 'plot' is not installed")
    reads(sample_results.read_result())
    picture = tmp_path / "line3.png"
    assert run(capsys, "read", recording, "--picture", picture)[0] == 0
    assert picture.read_bytes().startswith(b"\x89PNG")

    reads(sample_results.no_read_result())
    none = tmp_path / "none.png"
    status, _, err = run(capsys, "read", recording, "--picture", none)
    assert (status, none.exists(), err) == (1, True, [])
    assert run(capsys, "info", recording, "--picture", tmp_path / "seen.png")[0] == 0
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")

    reads(sample_results.read_result(sample_results.READING, sample_results.READING))
    folder = tmp_path / "pictures"
    other = sample_results.recording(tmp_path / "a.h5")
    assert run(capsys, "read", recording, other, "--picture", folder)[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == [
        "a-1.png", "a-2.png", "line3-1.png", "line3-2.png",
    ]  # fmt: skip


def test_simulate_and_info(capsys, tmp_path):
    path = tmp_path / "pass.h5"
    made = "--text LOT-7 --version 1 --module-px 4 --sensor 200x160 --duration-us 3000 --preset fast --seed 3"
    status, out, err = run(capsys, "simulate", path, *made.split())
    assert (status, len(out), err) == (0, 1, [])

    from evqr.demo import demo_truth

    assert demo_truth(path).shape == (21, 21)
    status, out, _ = run(capsys, "info", path, "--json")
    (found,) = map(json.loads, out)
    assert status == 0
    assert found["events"] > 1000
    assert (found["width"], found["height"], found["time_unit"]) == (200, 160, "us")
    assert 2000 < found["duration_us"] <= 3000
    status, out, _ = run(capsys, "info", path)
    assert status == 0
    assert "sensor      200x160" in out


def test_simulate_several_codes(capsys, tmp_path):
    path = tmp_path / "two.h5"
    made = "--text A --text B --module-px 2 --sensor 160x120 --duration-us 500 --preset fast"
    assert run(capsys, "simulate", path, *made.split())[0] == 0
    with h5py.File(path) as file:
        assert (file["truth"].attrs["payload"], file["truth2"].attrs["payload"]) == ("A", "B")


@pytest.mark.parametrize("command", ["read", "info", "convert", "simulate", "demo", "doctor"])
def test_help_shows_an_example(capsys, command):
    status, out, _ = run(capsys, command, "--help")
    assert status == 0
    example = out.index("  Examples:")
    assert out[example + 1].strip().startswith(f"evqr {command}")


def test_version(capsys):
    status, out, _ = run(capsys, "--version")
    assert status == 0
    assert out[0].startswith("evqr ")


def test_a_reader_that_leaves_is_no_traceback(recording):
    command = [sys.executable, "-m", "evqr", "info", recording]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 141


def test_result_of_an_error_has_no_seen():
    from evqr.output import records

    failed = ReadResult(
        ReadStatus.ERROR, "x.h5: the file is empty", source="x.h5", reason_code=Reason.SOURCE_ERROR
    )
    assert records.result_records(failed) == [
        {"status": "error", "reason": "x.h5: the file is empty", "reason_code": "source_error"}
    ]
