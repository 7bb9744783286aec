"""What users have at hand: lists, dicts, tables, arrays, open files.  Each is read, or a TypeError."""

import numpy as np
import pytest
import sample_results

import evqr
from evqr.config import ReadConfig
from evqr.errors import RecordingError, UsageError
from evqr.recording import open_recording, save_recording, summarise

EVENTS = sample_results.events(400)
COLUMNS = {"t": EVENTS.t, "x": EVENTS.x, "y": EVENTS.y, "p": EVENTS.p}
SENSOR = (160, 120)


class Table:
    """What tables of pandas and Polars have in common."""

    def __init__(self, columns):
        self._columns = columns

    @property
    def columns(self):
        return list(self._columns)

    def __len__(self):
        return len(self._columns["t"])

    def __getitem__(self, name):
        return self._columns[name]


class Indexed(Table):
    """One of pandas, with the times as its index."""

    class index:
        name = "t"

    def reset_index(self):
        return Table(COLUMNS)


class Lazy:
    """One of Polars that is not computed yet."""

    columns = property(lambda self: list(COLUMNS))


def structured():
    array = np.empty(400, [("x", "u2"), ("y", "u2"), ("t", "i8"), ("p", "i1")])
    for name, values in COLUMNS.items():
        array[name] = values
    return array


def as_rows():
    return np.stack([EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.p], axis=1)


@pytest.mark.parametrize(
    "source",
    [
        tuple(COLUMNS.values()),
        list(COLUMNS.values()),
        tuple(values.tolist() for values in COLUMNS.values()),
        [values.tolist() for values in COLUMNS.values()],
        as_rows(),
        as_rows().tolist(),
        [tuple(row) for row in as_rows().tolist()],
        COLUMNS,
        {"timestamp_us": EVENTS.t, "x": EVENTS.x, "y": EVENTS.y, "polarity": EVENTS.p},
        Table(COLUMNS),
        Indexed({name: COLUMNS[name] for name in "xyp"}),
        Table({name: values.astype(object) for name, values in COLUMNS.items()}),
        structured(),
        EVENTS,
    ],
    ids=lambda source: type(source).__name__,
)
def test_events_in_memory_are_read_whatever_holds_them(source):
    with open_recording(source, sensor="160x120", time_unit="us") as recording:
        got = recording.read()
    for name in "txyp":
        np.testing.assert_array_equal(getattr(got, name), getattr(EVENTS, name))
    assert (got.width, got.height) == SENSOR


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
@pytest.mark.parametrize("kind", ["m8", "M8"])
def test_times_that_are_durations_or_dates_have_their_unit(kind, unit):
    per_us = {"ns": 1000, "us": 1, "ms": 1}[unit]
    times = (EVENTS.t * per_us).astype(f"{kind}[{unit}]")
    for source in (Table({**COLUMNS, "t": times}), (times, EVENTS.x, EVENTS.y, EVENTS.p)):
        with open_recording(source, sensor=SENSOR) as recording:
            np.testing.assert_array_equal(recording.read().t, EVENTS.t * (1000 if unit == "ms" else 1))
        assert recording.time_unit_reason.startswith("its times are ")


def test_a_table_that_is_not_computed_is_a_type_error():
    with pytest.raises(TypeError, match=r"got a Lazy that is not computed; pass \.collect\(\)$"):
        open_recording(Lazy())


@pytest.mark.parametrize("library", ["pandas", "polars", "pyarrow"])
def test_tables_of(library):
    """Where it is installed: they are larger than all that evqr needs, so the test extra leaves them out."""
    module = pytest.importorskip(library)
    made = module.table(COLUMNS) if library == "pyarrow" else module.DataFrame(COLUMNS)
    tables = [made, made.set_index("t")] if library == "pandas" else [made]
    for table in tables:
        with open_recording(table, sensor=SENSOR, time_unit="us") as recording:
            np.testing.assert_array_equal(recording.read().t, EVENTS.t)
        assert len(list(evqr.read_many(table, sensor=SENSOR, time_unit="us"))) == 1
    if library == "polars":
        with pytest.raises(TypeError, match="got a LazyFrame that is not computed"):
            open_recording(made.lazy())


def test_a_dict_may_hold_the_size_of_the_sensor():
    with open_recording({**COLUMNS, "width": 160, "height": np.array([120])}, time_unit="us") as recording:
        assert (recording.width, recording.height) == SENSOR


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        (None, "NoneType"),
        (7, "int"),
        ([], "list"),
        ([[1, 2], [3]], "list"),
        (object(), "object"),
        ({1, 2}, "set"),
    ],
)
def test_what_holds_no_events_is_a_type_error(source, kind):
    with pytest.raises((TypeError, RecordingError), match=rf"got {kind}$|shape|source must"):
        open_recording(source)


def test_an_open_file_is_a_type_error(tmp_path):
    path = sample_results.recording(tmp_path / "a.h5")
    with path.open("rb") as file, pytest.raises(TypeError, match=r"got an open file; pass its path$"):
        open_recording(file)


def test_paths_are_opened_where_recordings_are_taken(tmp_path):
    path = sample_results.recording(tmp_path / "a.h5")
    info = summarise(path)
    with open_recording(path) as recording:
        assert summarise(recording) == info
        with pytest.raises(TypeError, match="is open already: pass sensor to open_recording"):
            summarise(recording, sensor=SENSOR)
    told = []
    summarise(path, progress=lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1] == info.duration_us
    with pytest.raises(RecordingError, match="no such file"):
        summarise(tmp_path / "nowhere.h5")


def test_whatever_can_be_opened_can_be_saved(tmp_path):
    for source in (tuple(COLUMNS.values()), COLUMNS, as_rows()):
        save_recording(tmp_path / "b.h5", source, sensor=SENSOR, time_unit="us")
        with open_recording(tmp_path / "b.h5") as recording:
            np.testing.assert_array_equal(recording.read().t, EVENTS.t)
    save_recording(tmp_path / "c.npz", tmp_path / "b.h5")
    assert summarise(tmp_path / "c.npz").events == 400
    with pytest.raises(RecordingError, match=r'sensor size unknown: pass sensor="WxH"'):
        save_recording(tmp_path / "d.h5", tuple(COLUMNS.values()))
    with pytest.raises(TypeError, match="got int"):
        save_recording(tmp_path / "d.h5", 7)
    assert not (tmp_path / "d.h5").exists()


@pytest.mark.parametrize("name", ["start_us", "end_us"])
@pytest.mark.parametrize("value", [1.5, "5", True])
def test_times_that_are_no_whole_numbers_are_refused(name, value):
    with pytest.raises(TypeError, match=rf"^{name} must be a whole number or None, got "):
        open_recording(EVENTS, **{name: value})
    with open_recording(EVENTS, start_us=np.int64(EVENTS.t[0] + 1)) as recording:
        assert 0 < len(recording.read()) < len(EVENTS)


@pytest.mark.parametrize("name", ["read_codes", "read_windows", "read_many"])
def test_a_misspelt_keyword_is_refused_in_the_name_of_the_call(name):
    def call(**given):
        return [*(getattr(evqr, name)(EVENTS, **given) or ())]

    with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected keyword argument 'sensr'$"):
        call(sensr=SENSOR)
    with pytest.raises(TypeError, match=r"'vote'; pass config=ReadConfig\(vote=\.\.\.\)$"):
        call(vote="soft")


@pytest.mark.parametrize("config", [{}, {"window_us": 500}, evqr.DecodeConfig()], ids=repr)
def test_what_is_no_configuration_is_refused(config):
    for call in (evqr.read_codes, evqr.read_windows):
        with pytest.raises(
            TypeError, match=r"^config must be a ReadConfig or None, got (dict|DecodeConfig)$"
        ):
            list(call(EVENTS, config=config))
    with pytest.raises(TypeError, match="config must be a ReadConfig or None"):
        evqr.Solver(config)


def test_read_many_of_no_source_is_refused():
    with pytest.raises(TypeError, match=r"^sources must be what read_codes takes, or many of them, got int$"):
        list(evqr.read_many(3))


def test_read_many_takes_one_source(tmp_path, monkeypatch):
    monkeypatch.setattr("evqr.offline.read_codes", lambda source, **options: sample_results.read_result())
    path = sample_results.recording(tmp_path / "a.h5")
    for source in (str(path), path, EVENTS, structured(), COLUMNS, Table(COLUMNS)):
        assert len(list(evqr.read_many(source))) == 1
    assert len(list(evqr.read_many([path, path]))) == 2


@pytest.mark.parametrize(
    ("size", "meant"), [("640x480", (640, 480)), ((640, 480), (640, 480)), (["640", 480], (640, 480))]
)
def test_sizes_are_texts_or_pairs(size, meant):
    with open_recording(tuple(COLUMNS.values()), sensor=size, time_unit="us") as recording:
        assert (recording.width, recording.height) == meant


def test_options_that_make_no_sense_are_named_as_in_the_call():
    for given, message in (
        ({"sensor": "640"}, r"sensor '640' is no size; pass \(640, 480\) or '640x480'"),
        ({"sensor": 640}, "sensor 640 is no size"),
        ({"time_unit": "hours"}, "time_unit 'hours' is unknown; pass one of s, ms, us, ns"),
        ({"columns": "t,x"}, "columns 't,x' must name each of t, x, y and p once"),
    ):
        with pytest.raises(UsageError, match=message):
            open_recording(EVENTS, **given)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        (
            {"vote": "informtion"},
            ValueError,
            "vote must be one of 'mode', 'soft', 'information', got 'informtion'",
        ),
        ({"window_us": 500.5}, TypeError, "window_us must be a whole number, at least 1, or None, got 500.5"),
        ({"window_us": "500"}, TypeError, "window_us must be a whole number, at least 1, or None, got '500'"),
        ({"lag_us": 300.0}, TypeError, "lag_us must be"),
    ],
)
def test_settings_that_are_none_are_refused(settings, error, message):
    with pytest.raises(error, match=message):
        ReadConfig(**settings)
    with pytest.raises(TypeError, match="vot"):
        ReadConfig(vot="soft")  # pyright: ignore[reportCallIssue]
