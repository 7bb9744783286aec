"""Text recordings: names, units, orders, separators, comments and titles as people write them."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_files import HEIGHT, WIDTH, assert_same_events, make_events

from evqr.errors import RecordingError, UsageError
from evqr.events.array import EventArray
from evqr.recording import open_recording
from evqr.recording.columns import ORDERS, fitting_orders, parse_columns

SENSOR = (WIDTH, HEIGHT)
EVENTS = make_events(200)


def read(path, text, **options):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with open_recording(path, **{"sensor": SENSOR, **options}) as recording:
        return recording.read(), recording


def rows(events, line, on="1", off="0"):
    """A line an event, with {t} in us, {s} in s, {i} the index."""
    columns = zip(events.t.tolist(), events.x, events.y, events.p > 0, strict=True)
    return "".join(
        line.format(t=t, s=t / 1e6, ms=t / 1e3, x=x, y=y, p=on if p else off, i=i) + "\n"
        for i, (t, x, y, p) in enumerate(columns)
    )


@pytest.mark.parametrize("first", ["0", "5", "0.0", "00"])
@pytest.mark.parametrize("chunk_events", [3, 1 << 20])
def test_a_whole_first_time_is_no_type(tmp_path, first, chunk_events):
    events = EventArray(EVENTS.t - EVENTS.t[0], EVENTS.x, EVENTS.y, EVENTS.p, WIDTH, HEIGHT)
    offset = int(float(first))
    lines = [
        f"{offset + t / 1e6:.9g} {x} {y} {int(p > 0)}"
        for t, x, y, p in zip(events.t.tolist(), events.x, events.y, events.p, strict=True)
    ]
    lines[0] = first + lines[0][lines[0].index(" ") :]
    got, recording = read(tmp_path / "a", "\n".join(lines), chunk_events=chunk_events)
    assert recording.time_unit == "s"
    np.testing.assert_array_equal(got.t, events.t + offset * 1_000_000)


def test_types_widen_after_the_sample(tmp_path):
    text = "".join(f"{t} 1 2 1\n" for t in range(0, 10_000, 2)) + "10000.5 1 2 1\n10002 3 4 0\n"
    for chunk_events in (100, 1 << 20):
        got, _ = read(tmp_path / "a", text, time_unit="us", chunk_events=chunk_events)
        assert len(got) == 5002
        assert got.t[-2:].tolist() == [10_000, 10_002]


@pytest.mark.parametrize(
    ("names", "line", "unit"),
    [
        ("x,y,on,t", "{x},{y},{p},{t}", "us"),
        ("t [us],x [px],y [px],p", "{t},{x},{y},{p}", "us"),
        ("t[us] x y p", "{t} {x} {y} {p}", "us"),
        ("t [us] x y p", "{t} {x} {y} {p}", "us"),
        ("Timestamp (ms); X; Y; Polarity", "{ms};{x};{y};{p}", "ms"),
        ("timestamp_us\tx\ty\tpolarity", "{t}\t{x}\t{y}\t{p}", "us"),
        ('"time (s)","x","y","pol"', "{s:.6f},{x},{y},{p}", "s"),
        ('"t" "x" "y" "p"', "{t} {x} {y} {p}", "us"),
        ("'t','x','y','p'", "{t},{x},{y},{p}", "us"),
        ("x;y;p;t_ns", "{x};{y};{p};{t}000", "ns"),
        ("Time in microseconds,col,row,is_on", "{t},{x},{y},{p}", "us"),
        ("ts|xs|ys|ps", "{t}|{x}|{y}|{p}", "us"),
        ("# t x y p", "{t} {x} {y} {p}", "us"),
        ("% timestamp,x,y,polarity", "{t},{x},{y},{p}", "us"),
        ("event_t,event_x,event_y,event_p", "{t},{x},{y},{p}", "us"),
        ("t,x,y,p,", "{t},{x},{y},{p},", "us"),
        (",t,x,y,p", "{i},{t},{x},{y},{p}", "us"),
        ("index,x,y,t,p", "{i},{x},{y},{t},{p}", "us"),
        ("t,x,y,p", "{i},{t},{x},{y},{p}", "us"),
        ("t,x,y,p,cluster", "{t},{x},{y},{p},7", "us"),
    ],
)
def test_names(tmp_path, names, line, unit):
    got, recording = read(tmp_path / "a", names + "\n" + rows(EVENTS, line))
    assert_same_events(got, EVENTS)
    assert recording.time_unit == unit
    assert all("not read" in note for note in recording.notes)


POLARITIES = [("True", "False"), ("true", "false"), ("ON", "OFF"), ("+1", "-1"), ("1.0", "0.0")]
UNITS = ["# unit: ns", "# time unit = ns", "# t in nanoseconds, x and y in px", "# t [ns]"]
XYPT = ["xypt", "x,y,p,t", "x y p t", "x; y; p; t", ["x", "y", "p", "t"], "x,y,pol,timestamp"]


@pytest.mark.parametrize(("on", "off"), POLARITIES)
@pytest.mark.parametrize("line", ["{t},{x},{y},{p}", "{x} {y} {p} {t}"])
def test_polarities(tmp_path, line, on, off):
    assert_same_events(read(tmp_path / "a", rows(EVENTS, line, on, off))[0], EVENTS)


def test_a_decimal_comma(tmp_path):
    text = "Zeit (s);x;y;p\n".replace("Zeit", "time") + rows(EVENTS, "{s:.6f};{x};{y};{p}").replace(".", ",")
    assert_same_events(read(tmp_path / "a", text)[0], EVENTS)


@pytest.mark.parametrize(
    "top",
    [
        "%geometry:64,48\n",
        "# geometry: 64x48\n",
        "% geometry 64 x 48\n",
        "# width: 64\n# height: 48\n",
        "# sensor size = (64, 48)\n",
        "# width=64, height=48\n",
        "64 48\n",
        "64,48\n",
        "64x48\n",
        "// resolution 64x48\n",
    ],
)
def test_the_sensor_from_comments(tmp_path, top):
    got, _ = read(tmp_path / "a", top + rows(EVENTS, "{x},{y},{p},{t}"), sensor=None)
    assert_same_events(got, EVENTS)


@pytest.mark.parametrize("comment", UNITS)
def test_the_unit_from_comments(tmp_path, comment):
    got, recording = read(tmp_path / "a", f"{comment}\n" + rows(EVENTS, "{t}000 {x} {y} {p}"))
    assert_same_events(got, EVENTS)
    assert (recording.time_unit, "comment" in recording.time_unit_reason) == ("ns", True)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings_and_line_ends(tmp_path, encoding):
    text = "t [µs];x;y;p\n" + rows(EVENTS, "{t};{x};{y};{p}")
    for end in ("\n", "\r\n", "\r"):
        got, recording = read(tmp_path / "a", text.replace("\n", end).encode(encoding))
        assert_same_events(got, EVENTS)
        assert recording.time_unit == "us"


def test_titles_are_passed_over_and_told(tmp_path):
    text = "Line 3, Monday\nrecorded by hand\n\nt x y p\n" + rows(EVENTS, "{t} {x} {y} {p}")
    got, recording = read(tmp_path / "a", text)
    assert_same_events(got, EVENTS)
    assert recording.notes == ("lines 1, 2: no event and no names of columns, passed over",)


@pytest.mark.parametrize("order", [order for order in ORDERS if order != ("t", "x", "y", "p")])
def test_orders_told_by_values(tmp_path, order):
    line = " ".join(f"{{{column}}}" for column in order)
    got, recording = read(tmp_path / "a", rows(EVENTS, line))
    assert_same_events(got, EVENTS)
    assert f"columns are taken as {', '.join(order)}" in recording.notes[0]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000), order=st.sampled_from(ORDERS), signed=st.booleans(), seconds=st.booleans()
)
def test_values_leave_one_order(seed, order, signed, seconds):
    """Whatever the events: of random ones a hundred are enough."""
    events = make_events(100, seed=seed)
    columns = {
        "t": events.t / 1e6 if seconds else events.t,
        "x": events.x,
        "y": events.y,
        "p": events.p if signed else events.p > 0,
    }
    assert fitting_orders([columns[c] for c in order], SENSOR) == [order]


def test_orders_that_values_leave_open(tmp_path):
    with pytest.raises(RecordingError, match=r"fits no order of t, x, y, p .*columns=.x,y,p,t."):
        read(
            tmp_path / "a", "".join(f"{i * 37 % 50} {i * 17 % 50} {i * 7 % 50} {i % 3}\n" for i in range(90))
        )
    text = rows(EVENTS, "{x} {y} {p} {t}")
    got, recording = read(tmp_path / "a", text, columns="x,y,p,t")
    assert_same_events(got, EVENTS)
    assert recording.notes == ()
    with pytest.raises(RecordingError, match=r"5 columns without names; say which .*columns=.t,x,y,p,-."):
        read(tmp_path / "a", rows(EVENTS, "9 {x} {y} {p} {t}"))
    assert_same_events(read(tmp_path / "a", rows(EVENTS, "9 {x} {y} {p} {t}"), columns="-xypt")[0], EVENTS)
    with pytest.raises(RecordingError, match=r"columns=.x,y,p,t. names 4 columns, and lines have 5"):
        read(tmp_path / "a", rows(EVENTS, "9 {x} {y} {p} {t}"), columns="xypt")


def test_an_index_without_a_name(tmp_path):
    got, recording = read(tmp_path / "a", rows(EVENTS, "{i},{x},{y},{p},{t}"))
    assert_same_events(got, EVENTS)
    assert "the first column is taken as an index" in recording.notes[0]


def test_the_order_asked_for_goes_before_names(tmp_path):
    text = "t,x,y,p\n" + rows(EVENTS, "{t},{y},{x},{p}")
    got, _ = read(tmp_path / "a", text, columns="t,y,x,p")
    assert_same_events(got, EVENTS)


@pytest.mark.parametrize("columns", ["t,x,y", "t,x,y,p,p", "a,b,c,d", "txy", "", "t,x,y,q"])
def test_columns_that_are_not_the_four(columns):
    with pytest.raises(UsageError, match="must name each of t, x, y and p once"):
        parse_columns(columns)


@pytest.mark.parametrize("columns", XYPT)
def test_columns_as_people_write_them(columns):
    assert parse_columns(columns) == ("x", "y", "p", "t")


cell = st.one_of(
    st.integers(-(10**20), 10**20).map(str),
    st.floats(allow_nan=True).map(str),
    st.sampled_from(
        ["t", "x", "y", "p", "True", "on", "", '"', "#", "%", ";", "µs", "[us]", "64x48", "1,5", "::"]
    ),
    st.text(max_size=6),
)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lines=st.lists(st.tuples(st.sampled_from([" ", ",", ";", "\t"]), st.lists(cell, max_size=6)), max_size=12)
)
def test_any_lines_are_read_or_explained(tmp_path, lines):
    text = "\n".join(separator.join(cells) for separator, cells in lines)
    try:
        got, _ = read(tmp_path / "a", text.encode("utf-8", "replace"), time_unit="us")
    except RecordingError as error:
        assert str(error).startswith(str(tmp_path / "a"))
        assert "\n" not in str(error)
    else:
        assert len(got) > 0
        assert np.all(np.diff(got.t) >= 0)


UNUSUAL = [
    "[{t}, {x}, {y}, {p}]",
    "({s:.6f}, {x}, {y}, {p})",
    "'{t}','{x}','{y}','{p}'",
    '"{t}" "{x}" "{y}" "{p}"',
]


@pytest.mark.parametrize("line", UNUSUAL)
def test_lines_that_numpy_does_not_parse(tmp_path, line):
    for on, off in (("1", "0"), ("pos", "neg"), ("Positive", "Negative")):
        assert_same_events(read(tmp_path / "a", rows(EVENTS, line, on, off))[0], EVENTS)
    start = 1_700_000_000_000_000_000
    text = "".join(f"[{start + i * 1000 + 1} {i % 8} 0 1]\n" for i in range(500))
    np.testing.assert_array_equal(read(tmp_path / "a", text)[0].t, start // 1000 + np.arange(500))


def test_a_column_of_words_that_is_not_read(tmp_path):
    for chunk_events in (7, 1 << 20):
        got, recording = read(
            tmp_path / "a",
            "x,y,t,p,label\n" + rows(EVENTS, "{x},{y},{t},{p},a dog"),
            chunk_events=chunk_events,
        )
        assert_same_events(got, EVENTS)
        assert recording.notes == ("columns that are not read: 'label'",)


@pytest.mark.parametrize("units", ["[ns],[px],[px],[-]", "ns,px,px,", "nanoseconds,pixel,pixel,polarity"])
def test_units_below_the_names(tmp_path, units):
    got, recording = read(tmp_path / "a", f"t,x,y,p\n{units}\n" + rows(EVENTS, "{t}000,{x},{y},{p}"))
    assert_same_events(got, EVENTS)
    assert (recording.time_unit, "below the names" in recording.time_unit_reason) == ("ns", True)


def test_rows_of_pixels_are_no_times(tmp_path):
    """Simulators write the events of a time row by row, so that coordinates seldom fall."""
    t = np.repeat(np.arange(50), 40)
    x, y = np.tile(np.arange(40), 50), np.tile(np.arange(40) // 10, 50)
    p = np.arange(2000) % 3 % 2
    events = EventArray(
        t, x.astype(np.uint16), y.astype(np.uint16), (2 * p - 1).astype(np.int8), WIDTH, HEIGHT
    )
    got, _ = read(tmp_path / "a", rows(events, "{x},{y},{p},{t}"), time_unit="us")
    assert_same_events(got, events)
