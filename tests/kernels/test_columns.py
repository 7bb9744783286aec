"""Events as others keep them: whatever the form, the same columns; and no copy without need."""

import numpy as np
import pytest

import evqr_kernels
from evqr_kernels import columns

T0 = 1_700_000_000_000_000  # [us] of a clock of 1970
X, Y = np.array([3, 4, 639], np.uint16), np.array([5, 6, 479], np.uint16)
T, P = T0 + np.array([0, 250, 1000]), np.array([1, 0, 1], np.uint8)
SECONDS, SIGNS = np.array([-2.5e-4, 0.0, 7.5e-4]), np.array([1, -1, 1])


def structured(x="x", y="y", t="t", p="p"):
    kinds = [(t, np.int64), (x, np.uint16), (y, np.uint16), (p, np.uint8)]
    return np.array(list(zip(T, X, Y, P, strict=True)), kinds)


class Frame:
    """What pandas, Polars and Arrow have in common: names, columns by them, and ``__array__`` of those."""

    def __init__(self, attribute, **columns):
        self.made = columns
        setattr(self, attribute, list(columns))

    def __getitem__(self, name):
        return Series(self.made[name])


class Series:
    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return self.values


@pytest.mark.parametrize(
    "events",
    [
        structured(),
        structured("x", "y", "timestamp", "polarity"),
        (X, Y, T, P),
        [X, Y, T.astype(np.uint64), P.astype(bool)],
        (X.astype(np.int16), Y.astype(np.int32), T, np.array([1, -1, 1], np.int8)),
        {"p": P, "t": T, "y": Y, "x": X},
        Frame("columns", x=X, y=Y, t=T, p=P),
        Frame("column_names", x=X, y=Y, ts=T, pol=P),
        (X, Y, T.astype("datetime64[us]"), P),
        (list(X), list(Y), list(T), list(map(int, P))),
    ],
    ids=lambda events: type(events).__name__,
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_form_gives_the_same(events, dtype):
    named = isinstance(events, (tuple, list)) and getattr(events[2], "dtype", None) == "datetime64[us]"
    made = columns(events, np.datetime64(T0 + 250, "us") if named else T0 + 250, dtype=dtype)
    assert all(column.dtype == dtype and column.flags.c_contiguous for column in made)
    for column, expected in zip(made, (X, Y, SECONDS, SIGNS), strict=True):
        np.testing.assert_allclose(column, expected, rtol=1e-6, atol=1e-10)


def test_real_tables():
    pandas = pytest.importorskip("pandas")
    made = columns(pandas.DataFrame({"x": X, "y": Y, "t": T, "p": P}), T0 + 250)
    np.testing.assert_allclose(made.t, SECONDS, atol=1e-10)


def test_the_first_event_is_the_reference_unless_another_is_given():
    np.testing.assert_allclose(columns((X, Y, T, P)).t, SECONDS + 2.5e-4, atol=1e-10)
    np.testing.assert_allclose(columns((X, Y, T, P), tick=1e-9).t, (SECONDS + 2.5e-4) / 1e3, atol=1e-12)
    assert [len(column) for column in columns((X[:0], Y[:0], T[:0], P[:0]))] == [0] * 4


def test_columns_that_are_right_are_not_copied():
    x, y, t, weight = (np.arange(3, dtype=np.float32) for _ in range(4))
    for made, given in zip(columns((x, y, t, weight), 0), (x, y, t, weight), strict=True):
        assert np.shares_memory(made, given)


def test_operations_take_them():
    made = columns(structured())
    image = evqr_kernels.bin_events(made.x, made.y, made.weight, np.array([0, 3], np.int32), shape=(480, 640))
    assert [image[0, y, x] for x, y in zip(X, Y, strict=True)] == [1, -1, 1]
    moved = evqr_kernels.splat_events(
        *made, np.array([0, 3], np.int32), np.zeros((1, 2), np.float32), shape=(480, 640)
    )
    np.testing.assert_allclose(moved.sum(), 1.0, atol=0.6)


@pytest.mark.parametrize(
    ("events", "error", "message"),
    [
        ((X, Y, T), ValueError, "events must be four columns x, y, t and polarity, got 3"),
        (7, TypeError, "events must be a structured array, columns by name or a tuple of four, got int"),
        (np.zeros((3, 4)), TypeError, "columns by name or a tuple of four, got ndarray"),
        ({"x": X, "y": Y, "t": T}, ValueError, "events must have a column weight (p, ps, pol, "),
        ((X, Y[:2], T, P), ValueError, "y must have 3 events like x, got 2"),
        ((X, Y, T, P[None]), ValueError, "weight must have shape (E,), got (1, 3)"),
        ((X, Y, T, np.array([0, 2, 1])), ValueError, "polarities must be 0 and 1, or -1 and 1, got 0 to 2"),
        ((X, Y, T, np.array([0, -1, 1])), ValueError, "polarities must be 0 and 1, or -1 and 1, got -1 to 1"),
        ((X.astype(str), Y, T, P), TypeError, "x must be numbers, got <U5"),
    ],
)
def test_what_is_refused(events, error, message):
    with pytest.raises(error) as info:
        columns(events)
    assert message in str(info.value)


def test_dtype_is_one_of_the_operations():
    with pytest.raises(TypeError, match="dtype must be float32 or float64, got float16"):
        columns((X, Y, T, P), dtype=np.float16)
