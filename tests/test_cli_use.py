"""The command line as its users meet it: sources, forms of results, files that are there, without extras."""

from __future__ import annotations

import dataclasses
import functools
import io
import json
import operator
import re
import sys
from pathlib import Path

import pytest
import sample_results
from test_cli import compiled_kernels, reads, recording, run

from evqr.recording import open_recording
from evqr.symbol.payload import StructuredAppend
from evqr_kernels.extras import install_command

__all__ = ["compiled_kernels", "reads", "recording"]  # fixtures


def test_folders_patterns_and_standard_input_are_sources(capsys, reads, tmp_path, monkeypatch):
    reads(sample_results.read_result())
    shift = tmp_path / "shift 1"
    shift.mkdir()
    for name in ("b.h5", "a.h5", ".hidden.h5", "notes.md"):
        sample_results.recording(tmp_path / "one.h5").rename(shift / name)

    def names(*sources):
        status, out, err = run(capsys, "read", *sources, "--json")
        assert (status, err) == (0, [])
        return [json.loads(line)["recording"] for line in out]

    assert names(shift) == names(shift / "*.h5") == [str(shift / "a.h5"), str(shift / "b.h5")]
    assert names(shift / "[b]*", shift / "notes.md") == [str(shift / "b.h5"), str(shift / "notes.md")]
    odd = sample_results.recording(tmp_path / "[1].h5")
    assert names(odd) == [str(odd)]  # a file of that name goes before the pattern

    given = reads(sample_results.read_result())
    content = (shift / "a.h5").read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    assert names("-") == ["-"]
    assert not given["source"].exists()  # it is kept as long as it is read


def test_standard_input_is_read_and_goes_by_its_name(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"no events")))
    status, out, _ = run(capsys, "read", "-", "--json")
    assert (status, json.loads(out[0])["reason"][:3]) == (2, "-: ")
    monkeypatch.setattr(sys, "stdin", None)
    status, out, err = run(capsys, "read", "-")
    assert (status, out, err) == (
        2,
        [],
        ["evqr: -: nothing comes by standard input; pipe a recording into evqr"],
    )


def test_text_alone_and_results_to_a_file(capsys, reads, recording, tmp_path):
    reads(sample_results.read_result(sample_results.reading(text="a\nb"), sample_results.reading(text="c")))
    assert run(capsys, "read", recording, recording, "--text")[1] == [r"a\nb", "c", r"a\nb", "c"]
    output = tmp_path / "results"
    assert run(capsys, "read", recording, "--text", "--output", output) == (0, [], [])
    assert output.read_text() == "a\\nb\nc\n"
    assert run(capsys, "read", recording, "--json", "--output", output) == (0, [], [])
    assert [json.loads(line)["text"] for line in output.read_text().splitlines()] == ["a\nb", "c"]
    reads(sample_results.no_read_result())
    assert run(capsys, "read", recording, "--text")[:2] == (1, [])


def test_messages_are_joined_over_recordings_in_any_order(capsys, reads, tmp_path, monkeypatch):
    reads(None)
    texts = ("one ", "two ", "three")
    parity = functools.reduce(operator.xor, "".join(texts).encode())
    given = {}
    for index, text in enumerate(texts):
        path = sample_results.recording(tmp_path / f"{index}.h5")
        append = StructuredAppend(index=index, count=3, parity=parity)
        part = dict(text=text, data=text.encode(), structured_append=append, symbology_identifier="]Q1")
        given[str(path)] = sample_results.read_result(sample_results.reading(**part))
    given["alone"] = sample_results.read_result()
    monkeypatch.setattr("evqr.offline.read_codes", lambda source, **_: given[str(source)])
    first, second, third, alone = given

    status, out, err = run(capsys, "read", third, first, alone, second, "--messages", "--text")
    assert (status, out, err) == (0, ["LOT 42", "one two three"], [])
    _, out, _ = run(capsys, "read", third, first, second, "--messages", "--json")
    assert len(out) == 4
    record = json.loads(out[-1])
    assert (record["recording"], record["status"], record["text"]) == (None, "message", "one two three")
    assert record["recordings"] == [first, second, third]
    _, out, _ = run(capsys, "read", third, first, second, "--messages")
    assert (
        out[-1] == f"message of 3 parts, parity {parity}: 'one two three' (from {first}, {second}, {third})"
    )
    status, out, err = run(capsys, "read", third, first, "--messages", "--text")
    assert (status, out) == (0, [])
    assert err == [f"evqr: message of 3 parts, parity {parity}: 2 passed, missing: 2"]
    assert run(capsys, "read", first, "--messages", "--each-window")[0] == 2


def test_quiet_leaves_results_and_errors(capsys, reads, recording, monkeypatch):
    reads(dataclasses.replace(sample_results.read_result(), warnings=("3 events out of order were sorted",)))
    assert len(run(capsys, "read", recording, "--text")[2]) == 1
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert run(capsys, "read", recording, "--text", "--quiet") == (0, ["LOT 42"], [])
    status, out, err = run(capsys, "read", "nowhere.h5", "--quiet", "--vote", "loudest")
    assert (status, out, len(err)) == (2, [], 1)


@pytest.mark.parametrize("form", [[], ["--json"], ["--text"], ["--each-window"], ["--each-window", "--json"]])
def test_one_recording_and_many_answer_alike(capsys, reads, recording, monkeypatch, form):
    """What one gives is what it gives among others: results, errors and warnings."""
    warnings = ("3 events out of order were sorted",)
    reads(dataclasses.replace(sample_results.read_result(), warnings=warnings))

    def read_windows(source, **options):
        with open_recording(source):
            yield dataclasses.replace(sample_results.WINDOW, warnings=warnings)

    monkeypatch.setattr("evqr.offline.read_windows", read_windows)
    monkeypatch.setattr("evqr.offline.read_codes", read_codes_of(sample_results.read_result(), warnings))
    alone = [run(capsys, "read", source, *form) for source in (recording, "nowhere.h5")]
    _, out, err = run(capsys, "read", recording, "nowhere.h5", *form)
    assert out == alone[0][1] + alone[1][1]
    assert err == alone[0][2] + alone[1][2]
    assert [status for status, _, _ in alone] == [0, 2]
    assert any("out of order" in line for line in err)
    if "--json" in form:
        assert [json.loads(line)["status"] for line in out] == ["read", "error"]
        assert json.loads(out[0])["warnings"] == list(warnings)


def read_codes_of(result, warnings):
    def read_codes(source, **options):
        with open_recording(source):
            return dataclasses.replace(result, warnings=warnings)

    return read_codes


def test_what_stops_everything_is_a_json_line_too(capsys, recording, monkeypatch):
    monkeypatch.undo()  # the real prepare
    status, out, err = run(capsys, "read", recording, "--json", "--device", "cuda:99")
    (record,) = map(json.loads, out)
    assert (status, len(err)) == (2, 1)
    assert (record["recording"], record["status"], record["reason_code"]) == (
        None, "error", "backend_unavailable",
    )  # fmt: skip


def test_info_of_what_cannot_be_read_is_a_json_line_too(capsys):
    status, out, err = run(capsys, "info", "nowhere.h5", "--json")
    (record,) = map(json.loads, out)
    assert (status, len(err)) == (2, 1)
    assert (record["path"], record["status"], record["reason_code"]) == (
        "nowhere.h5", "error", "source_error",
    )  # fmt: skip
    assert record["reason"] == err[0].removeprefix("evqr: ")


def test_simulate_writes_over_nothing_unasked(capsys, tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("mine")
    made = "--module-px 2 --sensor 80x60 --version 1 --duration-us 200 --text A"
    status, out, err = run(capsys, "simulate", path, *made.split())
    assert (status, out, path.read_text()) == (2, [], "mine")
    assert err == [f"evqr: {path}: is there already; choose another name, or write over it with --force"]
    assert run(capsys, "simulate", path, *made.split(), "--force")[0] == 0
    assert run(capsys, "info", path)[0] == 0


def test_simulate_and_info_show_progress(capsys, tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    _, _, err = run(
        capsys, "simulate", path, *"--module-px 2 --sensor 80x60 --version 1 --duration-us 200".split()
    )
    assert any("a.h5: " in line for line in err)
    assert any("a.h5: " in line for line in run(capsys, "info", path)[2])


def test_the_demo_reads_without_matplotlib(capsys, reads, monkeypatch, tmp_path):
    reads(sample_results.read_result())
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    picture = tmp_path / "demo.png"
    status, out, err = run(capsys, "demo", "--picture", picture)
    assert (status, out[0], picture.exists()) == (0, "LOT 42", False)
    assert err == [
        f"evqr: no picture is drawn: drawing a picture needs matplotlib: {install_command('plot')}"
    ]


def test_doctor_tells_what_there_is(capsys, reads, monkeypatch):
    reads(sample_results.read_result())
    monkeypatch.setattr("evqr.cli.doctor.find_spec", lambda name: None if name == "biip" else name)
    status, out, err = run(capsys, "doctor")
    text = "\n".join(out)
    assert (status, err) == (0, [])
    for said in ("numpy ", "warp on cpu", "compiled ones are kept in", "cores", "plot: installed", "LOT 42"):
        assert said in text
    assert f"gs1: biip not installed: {install_command('gs1')}" in text
    status, out, _ = run(capsys, "doctor", "--json")
    found = json.loads("\n".join(out))
    assert (status, found["demo"]["texts"], found["backend"]["name"]) == (0, ["LOT 42"], "warp")
    assert found["extras"]["gs1"]["missing"] == ["biip"]

    reads(sample_results.no_read_result())
    assert run(capsys, "doctor")[0] == 2
    status, out, _ = run(capsys, "doctor", "--device", "cuda:99")
    assert (
        status == 2 and out[-1].lstrip().startswith("demo") and "NOT READ" in out[-1] and "cuda:99" in out[-1]
    )


def test_doctor_knows_the_extras():
    from evqr.cli.doctor import EXTRAS

    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    table = text.split("[project.optional-dependencies]\n")[1].split("\n[")[0]
    offered = set(re.findall(r"^(\w+) = \[", table, re.MULTILINE))
    assert set(EXTRAS) <= offered
    assert offered - set(EXTRAS) <= {"perf", "portability", "test", "dev", "docs"}


@pytest.mark.parametrize("arguments", [("info", "-"), ("convert", "-", "out.h5")])
def test_standard_input_is_refused_where_it_is_not_taken(capsys, arguments):
    said = f"evqr: -: standard input is taken by evqr read; save it to a file for evqr {arguments[0]}"
    assert run(capsys, *arguments) == (2, [], [said])
