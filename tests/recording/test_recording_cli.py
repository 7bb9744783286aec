"""The options that say what a recording is, on the command line."""

import json

import h5py
import numpy as np
import pytest
from recording_files import HEIGHT, WIDTH, make_events

from evqr.main import run

EVENTS = make_events(400)


@pytest.fixture
def stereo(tmp_path):
    path = tmp_path / "stereo.h5"
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = "64x48"
        for side, count in (("left", 400), ("right", 100)):
            for column in "txyp":
                file[f"{side}/{column}"] = getattr(EVENTS, column)[:count]
    return str(path)


def test_info_names_streams_and_tells_of_one(stereo, capsys):
    assert run(["info", stereo]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "stream      left",
        "stream      right",
        "tell of one: --stream NAME",
    ]
    assert run(["info", stereo, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"path": stereo, "streams": ["left", "right"]}
    assert run(["info", stereo, "--stream", "right", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["events"], told["stream"], told["streams"]) == (100, "right", ["left", "right"])
    assert run(["info", stereo, "--stream", "left"]) == 0
    assert "streams     left, right" in capsys.readouterr().out


def test_reading_asks_for_a_stream(stereo, capsys):
    assert run(["read", stereo]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "holds several event groups (left, right); choose one of them: --stream left" in error


def test_columns_sensor_cut_and_strictness(tmp_path, capsys):
    path = str(tmp_path / "a.csv")
    y = EVENTS.y.astype(int)
    y[200] = 99
    rows = zip(EVENTS.x, y, EVENTS.p > 0, EVENTS.t, strict=True)
    (tmp_path / "a.csv").write_text("".join(f"{x},{y},{int(p)},{t}\n" for x, y, p, t in rows))
    options = ["--sensor", "64 x 48", "--columns", "x,y,p,t"]
    start, end = EVENTS.t[100], EVENTS.t[300]
    assert run(["info", path, *options, "--start-us", str(start), "--end-us", str(end), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    inside = np.count_nonzero((EVENTS.t >= start) & (EVENTS.t < end))
    assert (told["events"], told["left_out"], told["width"]) == (inside - 1, 1, WIDTH)
    assert told["notes"] == [
        "1 event was wrong and left out, the first: y 99 of event 200 is outside the 64x48 sensor"
    ]
    assert run(["info", path, *options]) == 0
    assert f"note        {told['notes'][0]}" in capsys.readouterr().out
    assert run(["info", path, *options, "--strict"]) == 2
    assert "y 99 of event 200 is outside the 64x48 sensor" in capsys.readouterr().err
    assert run(["info", path, "--sensor", "64x48", "--columns", "x,y,t"]) == 2
    assert "must name each of t, x, y and p once" in capsys.readouterr().err
    assert HEIGHT == told["height"]
