"""Results are values: they compare, hash, travel and print by what they hold, and nobody can change them."""

import copy
import dataclasses
import json
import pickle

import numpy as np
import pytest
import sample_results
from hypothesis import given
from hypothesis import strategies as st
from scenes import find

from evqr import EventBatch, EventBuffer, Solver, errors, open_recording
from evqr.demo import demo_recording
from evqr.reason import Reason
from evqr.results import ReadResult, ReadStatus, WindowReading
from evqr.seen import Statistics
from evqr.values import FrozenDict, Value, plain, read_only

VALUES = [
    sample_results.READING,
    sample_results.WINDOW,
    sample_results.WINDOW.codes[0],
    sample_results.read_result(),
    sample_results.no_read_result(),
    Statistics(events=3),
]


def arrays(value):
    return [each for each in vars(value).values() if isinstance(each, np.ndarray)]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_copies_are_equal(value):
    for other in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value), dataclasses.replace(value)):
        assert other == value and hash(other) == hash(value)
        assert not any(array.flags.writeable for array in arrays(other))
    assert len({value, copy.deepcopy(value)}) == 1


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_what_is_said_of_a_value(value):
    assert len(str(value)) < 200 and "\n" not in str(value)
    record = value.to_dict()
    assert json.loads(value.to_json()) == record
    assert value.to_json().isascii()


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_nothing_can_be_changed(value):
    for field in dataclasses.fields(value):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, field.name, None)
    for array in arrays(value):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    if hasattr(value, "compute_ms"):
        with pytest.raises(TypeError, match="cannot be changed"):
            value.compute_ms["total"] = 0.0


def test_arrays_are_no_longer_the_callers():
    corners = np.zeros((4, 2))
    reading = sample_results.reading(corners_px=corners)
    corners[:] = 1.0
    assert not reading.corners_px.any()


def test_each_field_counts_but_the_time_it_took():
    reading = sample_results.READING
    for name, value in {
        "text": "LOT 43", "version": 2, "corners_px": reading.corners_px + 1e-9, "modules": -reading.modules,
        "estimate": reading.estimate.astype(np.float64), "warnings": ("odd",),
    }.items():  # fmt: skip
        assert sample_results.reading(**{name: value}) != reading, name
    assert sample_results.reading(compute_ms={"total": 99.0}) == reading
    assert sample_results.WINDOW != reading


@dataclasses.dataclass(frozen=True, eq=False)
class Sample(Value):
    array: np.ndarray
    number: float = 0.0
    parts: dict = dataclasses.field(default_factory=dict)
    hidden: int = dataclasses.field(default=0, compare=False, repr=False)


# no subnormal numbers: compiled kernels let the process take them for 0
FLOATS = st.floats(allow_subnormal=False) | st.sampled_from([0.0, -0.0])
ARRAYS = st.lists(FLOATS, max_size=4).map(np.array)


@given(ARRAYS, ARRAYS)
def test_equal_values_have_one_hash(first, second):
    one, other = Sample(first), Sample(second)
    assert one == Sample(first.copy())
    if one == other:
        assert hash(one) == hash(other)
    assert (one == other) == np.array_equal(first, second, equal_nan=True)


@given(ARRAYS)
def test_every_value_has_a_place_in_json(array):
    sample = Sample(array, float("nan"), {"a": 1.0, "b": (1, 2)})
    record = json.loads(sample.to_json())
    assert record == sample.to_dict()
    assert record["number"] is None and record["parts"] == {"a": 1.0, "b": [1, 2]}
    assert "hidden" not in record and "hidden" not in str(sample)
    finite = [each for each in record["array"] if each is not None]
    assert finite == array[np.isfinite(array)].tolist()


def test_a_long_array_is_short_in_words():
    assert str(Sample(np.zeros((30, 2)))) == "Sample(array=float64 (30, 2), number=0.0, parts={})"
    assert len(str(Sample(np.zeros(1), parts={"a": "x" * 1000}))) < 200


def test_read_only_copies_once():
    mine = np.zeros(3)
    kept = read_only(mine)
    assert kept is not mine and read_only(kept) is kept
    assert read_only(kept, np.float32) is not kept
    view = kept[:2]
    assert read_only(view) is not view  # what it is a part of would be kept alive


def test_a_frozen_dict_is_a_dict_that_stays():
    frozen = FrozenDict(a=1)
    assert frozen == {"a": 1} and pickle.loads(pickle.dumps(frozen)) == frozen == copy.deepcopy(frozen)
    for change in (
        lambda: frozen.update(b=2), lambda: frozen.pop("a"), lambda: frozen.clear(),
        lambda: frozen.setdefault("b", 2), lambda: frozen.__delitem__("a"), lambda: frozen.popitem(),
    ):  # fmt: skip
        with pytest.raises(TypeError, match="cannot be changed"):
            change()
    with pytest.raises(TypeError, match="cannot be changed"):
        frozen |= {"b": 2}
    assert hash(frozen) == hash(FrozenDict(a=1))


def test_what_has_no_place_in_json_is_refused():
    with pytest.raises(TypeError):
        Sample(np.zeros(1), object()).to_json()  # pyright: ignore[reportArgumentType]


def test_plain_rounds_what_it_is_told_to():
    assert plain(np.array([1.23456]), 2) == [1.23]
    assert plain({"a": 1.23456, "b": 7}, 1) == {"a": 1.2, "b": 7}


def test_statistics_are_a_mapping_too():
    seen = sample_results.no_read_result().seen
    assert dict(seen) == seen.to_dict() == {
        "events": 1000, "duration_us": 0, "windows": 12, "searches": 0, "codes_not_decoded": 0,
    }  # fmt: skip
    assert seen["windows"] == seen.windows == 12 and len(seen) == 5 and "searches" in seen
    with pytest.raises(KeyError):
        seen["to_dict"]


def test_a_window_says_of_its_first_code_what_it_always_said():
    window, code = sample_results.WINDOW, sample_results.WINDOW.codes[0]
    for (
        name
    ) in "text version modules motion_px_per_s affine stage_one_iterations stage_two_iterations".split():
        assert getattr(window, name) is getattr(code, name)
    record = window.to_dict()
    (first,) = record["codes"]
    assert all(record[key] == first[key] for key in ("text", "version", "modules", "affine"))
    assert first["rows"] == first["columns"] == 21 and first["symbology"] == "QRCode"
    empty = WindowReading(
        status=ReadStatus.NO_CODE, reason="nothing moves", reason_code=Reason.NOTHING_MOVES, window=0,
        t_start_us=0, t_end_us=1, n_events=0,
    )  # fmt: skip
    record = empty.to_dict()
    assert record["codes"] == [] and record["text"] is record["modules"] is record["affine"] is None
    assert record["stage_one_iterations"] == 0 and record["reason_code"] == "nothing_moves"


def test_symbols_of_other_kinds():
    other = {
        "symbology": "RMQRCode",
        "version": "R11x27",
        "mask": None,
        "modules": np.ones((11, 27), np.int8),
    }
    reading = sample_results.reading(**other)
    record = reading.to_dict()
    assert (record["version"], record["mask"]) == ("R11x27", None)
    assert (record["rows"], record["columns"]) == (reading.rows, reading.columns) == (11, 27)
    assert "RMQRCode R11x27-M" in str(reading)
    assert "DataMatrix 22x22" in str(
        sample_results.reading(symbology="DataMatrix", version="22x22", ec_level=None)
    )


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_text(reason):
    assert reason.text and reason.text[0].islower() and not reason.text.endswith(".")
    assert reason.value == reason.name.lower()
    assert Reason(reason.value) is reason and pickle.loads(pickle.dumps(reason)) is reason


def test_every_error_says_what_it_means():
    listed = [
        value
        for value in vars(errors).values()
        if isinstance(value, type) and value.__module__ == errors.__name__
    ]
    assert len(listed) >= 5
    for error in listed:
        assert issubclass(error, errors.EvqrError) and isinstance(error.reason, Reason)
        assert f"| `{error.__name__}` |" in errors.__doc__


def test_a_result_in_short():
    assert str(sample_results.READING) == "'LOT 42' (QRCode 1-M) at 9000 us"
    assert str(sample_results.no_read_result()) == "no_read: no finder pattern was seen"
    assert str(ReadResult(ReadStatus.ERROR, "it is empty", source="x.h5")) == "x.h5: error: it is empty"
    assert str(sample_results.WINDOW) == "window 0, 1000 to 1250 us: 'LOT 42' (QRCode 1-M)"


@pytest.fixture(scope="module")
def steps():
    """What each step of the solver gives, on the recording that comes with evqr."""
    with demo_recording() as path, open_recording(path) as recording:
        events = EventBuffer.of(recording.read())
    solver = Solver()
    at = (events.first_us + events.last_us) // 2
    moving = events.answer(solver.motion_at(at))
    window = events.window(at, at + solver.window_us(moving.motion))
    found = find(solver, window, moving.motion)
    nothing = find(solver, window.keep(np.arange(len(window)) % 50 == 0), moving.motion)
    (estimate,) = solver.solve([found])
    (again,) = solver.follow(EventBatch.of([window]), [found], [found.weighted])
    return {
        type(each).__name__: each
        for each in (
            moving,
            moving.motion,
            found,
            found.target,
            nothing,
            estimate,
            found.equations,
            again.fused,
            found.space,
        )
    }


@pytest.mark.parametrize(
    "name",
    "MotionEstimate Motion Detection Target NotFound CodeEstimate Fused NormalEquations CodeSpace".split(),
)
def test_what_the_solver_gives_are_values_too(name, steps):
    value = steps[name]
    for other in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value)):
        assert other == value and hash(other) == hash(value)
        assert not any(array.flags.writeable for array in arrays(other))
    assert not any(array.flags.writeable for array in arrays(value))
    assert len(str(value)) < 400 and "\n" not in str(value)
    if name != "CodeSpace":
        assert json.loads(value.to_json()) == value.to_dict()


def test_a_detection_is_told_in_short(steps):
    record = steps["Detection"].to_dict()
    assert record["target"]["space"] == {"symbology": "QRCode", "version": 3}
    assert "equations" not in record and record["timings_ms"]
