"""Call the checked functions with what nobody would give them, as long as is wanted; count what comes of it.

usage: python -m tests.kernels.fuzz [--minutes 60] [--seed 0] [--backends warp taichi]

A call is a case of `cases`, in one of both precisions, of other sizes, and with one or two things wrong:
NaN, infinities, numbers of any size, pointers and indices from anywhere, another dtype, strides, no elements.
It is made by the specification and by a backend, in a process of its own for some hundred calls.  They must
agree or refuse alike, with a line; a process that ends otherwise has crashed, and the seed of its call is
printed.
"""

import argparse
import json
import subprocess
import sys
import time
import warnings
from collections import Counter

import numpy as np

import evqr_kernels
from evqr_kernels.errors import OperationRefused

from . import cases

CALLS = 400
"""Calls of one process."""

TOLERANCE = {"f4": 2e-4, "f8": 1e-9}
"""Relative to the largest value."""

NASTY = {"NaN": np.nan, "inf": np.inf, "-inf": -np.inf, "huge": 1e30, "tiny": 1e-42, "-0": -0.0, "far": 3e9}
"""Values that floats are replaced with; sums with huge ones need not agree."""


def smaller(call, given, rng):
    """Cut all arrays with a letter to another size."""
    letters = [e for a in call.operation.inputs for e in a.shape if isinstance(e, str) and e.isidentifier()]
    letter = rng.choice(sorted(set(letters)))
    for array in call.operation.inputs:
        for axis, extent in enumerate(array.shape):
            if extent != letter or not isinstance(given.get(array.name), np.ndarray):
                continue
            size = given[array.name].shape[axis]
            keep = given.setdefault(letter, int(rng.choice([0, 1, 2, 3, size // 2, size - 1])))
            part = np.take(given[array.name], np.r_[: min(keep, size)], axis)
            given[array.name] = np.ascontiguousarray(part)
    kept = given.pop(letter, None)
    if letter == "E" and "window_ptr" in given:
        given["window_ptr"] = np.minimum(given["window_ptr"], kept).astype(np.int32)
    if letter == "B" and "window_ptr" in given and given["window_ptr"].ndim == 1:
        given["window_ptr"] = given["window_ptr"][: kept + 1]
    return f"fewer {letter}"


def other_values(call, given, rng):
    """Replace some floats by nasty ones."""
    names = [a.name for a in call.operation.inputs if not a.integer]
    names = [name for name in names if isinstance(given.get(name), np.ndarray)]
    if not names:
        return "nothing"
    kind = str(rng.choice(list(NASTY)))
    array = given[rng.choice(names)].reshape(-1)
    if array.size:
        array[rng.integers(0, array.size, rng.integers(1, 4))] = NASTY[kind]
    return kind


def other_indices(call, given, rng):
    """Replace some integers by any."""
    names = [a.name for a in call.operation.inputs if a.integer and isinstance(given.get(a.name), np.ndarray)]
    if not names:
        return "nothing"
    array = given[rng.choice(names)].reshape(-1)
    if array.size:
        most = np.iinfo(array.dtype)
        low = max(most.min, -5) if rng.random() < 0.7 else most.min
        high = 400 if rng.random() < 0.7 else most.max
        array[rng.integers(0, array.size, rng.integers(1, 4))] = rng.integers(low, high, dtype=array.dtype)
    return "indices"


def other_kinds(call, given, rng):
    """Give an array of another dtype, order or number of axes."""
    name = rng.choice([a.name for a in call.operation.inputs if isinstance(given.get(a.name), np.ndarray)])
    array = given[name]
    change = rng.choice(["dtype", "strides", "axis", "list"])
    if change == "dtype":
        with np.errstate(all="ignore"):
            given[name] = array.astype(rng.choice(["f2", "f4", "f8", "i1", "i4", "i8", "u2", "?", "c8"]))
    elif change == "strides":
        given[name] = np.repeat(array, 2, axis=-1)[..., ::2]
    elif change == "axis":
        given[name] = array[None] if rng.random() < 0.5 else array.reshape(-1)
    else:
        given[name] = array.tolist()
    return str(change)


def other_settings(call, given, rng):
    """Give another number for a setting."""
    names = [s.name for s in call.operation.settings if isinstance(given.get(s.name), (int, float))]
    if not names:
        return "nothing"
    given[rng.choice(names)] = rng.choice([-1, 0, 1e-12, 1, 2.5, 1e9, np.nan, np.inf]).item()
    return "setting"


def made(seed):
    """Make a call from its seed: operation, arguments, and what is wrong with it."""
    rng = np.random.default_rng(seed)
    call = cases.CALLS[rng.integers(len(cases.CALLS))](rng, (np.float32, np.float64)[rng.integers(2)])
    given = {n: v.copy() if isinstance(v, np.ndarray) else v for n, v in call.checked.items()}
    changes = [smaller, other_settings, other_values, other_values, other_indices, other_kinds]
    chosen = np.sort(rng.choice(len(changes), rng.integers(0, 3), replace=False))
    return call.op, given, {changes[k](call, given, rng) for k in chosen}


def outcome(op, given, backend):
    """Give the results of a call, or the line with which it was refused."""
    try:
        results = getattr(evqr_kernels, op)(**given, backend=backend)
    except (TypeError, ValueError, OperationRefused) as error:
        line = f"{type(error).__name__}: {error}"
        return line if "\n" not in line and len(line) < 400 else f"not a line: {line}"
    except Exception as error:  # any other is a fault
        return f"not a line: {type(error).__name__}: {error}"
    return results if isinstance(results, tuple) else (results,)


def agree(got, want, wrong):
    """Compare results where the specification is finite; elsewhere neither must be."""
    if isinstance(got, str) or isinstance(want, str):
        return isinstance(got, str) and isinstance(want, str) and not (got + want).count("not a line")
    if wrong & {"huge", "far", "tiny", "setting"}:
        return True  # sums in another order may overflow elsewhere: no crash is all that is asked
    for one, other in zip(got, want, strict=True):
        finite = np.isfinite(other)
        if one.shape != other.shape or not np.array_equal(np.isfinite(one), finite):
            return False
        scale = np.abs(other[finite]).max(initial=0)
        slack = TOLERANCE[other.dtype.str[1:]] * scale if other.dtype.kind == "f" else 0
        if np.abs(one[finite].astype(float) - other[finite]).max(initial=0) > slack:
            return False
    return True


def some_calls(first, count, backends):
    """Make calls; print a line before each, and counts at the end."""
    counts = Counter()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    for seed in range(first, first + count):
        op, given, wrong = made(seed)
        print(seed, op, *sorted(wrong), flush=True)
        want = outcome(op, given, "numpy")
        for backend in backends:
            got = outcome(op, given, backend)
            if not agree(got, want, wrong):
                counts[f"differs: {backend} {op} {'+'.join(sorted(wrong)) or 'nothing wrong'}"] += 1
                counts["differ"] += 1
            else:
                counts["refused" if isinstance(got, str) else "agree"] += 1
            counts["calls"] += 1
    print(json.dumps(counts))


def main():
    """Start one process after the other until the time is over; print counts."""
    parser = argparse.ArgumentParser(
        description="Call the checked functions with what nobody would give them."
    )
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--backends", nargs="+", default=["warp", "taichi"])
    parser.add_argument("--once", type=int, help="make so many calls from the seed, in this process")
    arguments = parser.parse_args()
    if arguments.once:
        some_calls(arguments.seed, arguments.once, arguments.backends)
        return 0
    end, seed, counts = time.monotonic() + 60 * arguments.minutes, arguments.seed, Counter()
    while time.monotonic() < end:
        command = [sys.executable, "-m", "tests.kernels.fuzz", "--once", str(CALLS), "--seed", str(seed)]
        process = subprocess.run(
            [*command, "--backends", *arguments.backends], check=False, capture_output=True, text=True
        )
        lines = process.stdout.splitlines() or ["0"]
        seed += CALLS
        if process.returncode:
            counts["crashed"] += 1
            last = process.stderr.strip().splitlines()[-1:]
            print("ended with", process.returncode, "in", lines[-1], *last, flush=True)
            seed = int(lines[-1].split()[0]) + 1
        else:
            counts.update(json.loads(lines[-1]))
        print({k: v for k, v in counts.items() if not k.startswith("differs")}, flush=True)
    print(json.dumps(dict(sorted(counts.items())), indent=1))
    return int(counts["crashed"] > 0 or counts["differ"] > 0)


if __name__ == "__main__":
    sys.exit(main())
