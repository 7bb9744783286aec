"""Times of single operations: a backend's, its rivals', and their ratios; growth; threads.

No operation is timed before it, and each rival of it, agree with the NumPy specification on a small problem.
"""

from __future__ import annotations

import contextlib
import importlib.util
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cases
import limits
import numpy as np
import ops
import timing
from contestant import contestant, first_launches
from peers import PEERS, Peer
from problems import TOLERANCE, Prepared, Size, distance
from table import Row, row

SIZES = {name: Size(**size) for name, size in cases.SIZES.items()}
JUDGED = ("warp", "cpu", "float32")
"""Backend, device and precision that the requirements are for."""


@dataclass(frozen=True)
class Target:
    """What is timed."""

    backend: str
    device: str
    dtype: str

    def prepare(self, op: str, size: Size) -> Prepared:
        """Give the recorded operation, launched once."""
        prepared = Prepared(ops.build(op, size, self.dtype), self.backend, self.device)
        prepared.launch()
        prepared.wait()
        prepared.record()
        return prepared

    @property
    def judged(self) -> bool:
        """Whether the requirements are for it."""
        return (self.backend, self.device, self.dtype) == JUDGED


def baselines(op: str, target: Target) -> list[Peer]:
    """Give the rivals that can run; they are for one thread of a CPU, in float32."""
    if (target.device, target.dtype) != ("cpu", "float32"):
        return []
    return [peer for peer in PEERS if peer.op == op and not peer.missing]


def skipped(names: list[str]) -> str:
    """Say which rivals are not there."""
    found = dict.fromkeys(f"{p.name}: {p.missing}" for p in PEERS if p.op in names and p.missing)
    return "; ".join(found) or "none"


def check(op: str, target: Target) -> None:
    """Refuse to go on unless the backend and the rivals compute what the specification does."""
    problem = ops.build(op, SIZES["small"], target.dtype)
    expected = Prepared(problem, "numpy", "cpu").results()
    apart = distance(Prepared(problem, target.backend, target.device).results(), expected)
    if apart > TOLERANCE[np.dtype(target.dtype)]:
        sys.exit(f"gate: {op} of backend {target.backend} is {apart:.1e} from the specification")
    for peer in baselines(op, target):
        apart = distance([np.asarray(array) for array in peer.prepare(problem)()], expected)
        if apart > peer.tolerance:
            sys.exit(f"gate: {op} of {peer.name} is {apart:.1e} from the specification")


def time_op(op: str, case: str, target: Target, rounds: int) -> list[Row]:
    """Time an operation beside its rivals and, for an adjoint, beside what it is the adjoint of."""
    size = SIZES[case]
    prepared = target.prepare(op, size)
    problem = prepared.problem
    contestants = {target.backend: timing.measured(prepared, prepared.wait)}
    for peer in baselines(op, target):
        contestants[peer.name] = timing.measured(peer.prepare(problem))
    required = {peer: ratio for (name, peer), ratio in cases.PEER_RATIOS.items() if name == op}
    forward = op.removesuffix("_adjoint")
    if forward != op:
        before = target.prepare(forward, size)
        contestants["forward"] = timing.measured(before, before.wait)
        required["forward"] = cases.ADJOINT_RATIO
    times = timing.interleaved(contestants, rounds)

    rows = []
    for name, values in times.items():
        median = float(np.median(values))
        more: dict[str, str | float] = {"compile s": "", "first ms": "", "share": "", "bound": ""}
        if name == target.backend:
            more |= _beside_steady(op, size, target, median, prepared)
        more |= {"rate": round(problem.items / median / 1e6, 3), "unit": problem.unit}
        if name != "forward":
            rows.append(row("op ms", case, op, name, [1e3 * value for value in values], **more))
    own = times[target.backend]
    for name, values in times.items():
        if name != target.backend:
            pairs = [other / mine for other, mine in zip(values, own, strict=True)]
            judged = required.get(name, "") if target.judged and case == "production" else ""
            rows.append(row("ratio", case, op, f"{name} / {target.backend}", pairs, required=judged))
    return rows


def _beside_steady(
    op: str, size: Size, target: Target, median: float, prepared: Prepared
) -> dict[str, str | float]:
    """Time what is paid once, in processes of their own, and give the share of the machine's limit."""
    found: dict[str, str | float] = {}
    if target.backend != "numpy":
        cold, warm = first_launches(target.backend, target.device, op, target.dtype, size)
        found |= {"compile s": round(cold - warm, 2), "first ms": round(1e3 * warm, 2)}
    if target.device == "cpu":
        least, bound = limits.least_seconds(prepared.problem, target.dtype)
        found |= {"share": round(least / median, 4), "bound": bound}
    return found


def time_growth(op: str, target: Target, rounds: int) -> list[Row]:
    """Time an operation at several sizes; rows of the exponent of time over items, which should be 1.

    Where the multiply-adds do not grow as the items do, their exponent is what is expected.
    """
    rows = []
    for axis, values in cases.SWEEP.items():
        sizes = [replace(SIZES["production"], **{axis: value}) for value in values]
        prepared = {str(k): target.prepare(op, size) for k, size in enumerate(sizes)}
        items = [p.problem.items for p in prepared.values()]
        if items[0] == items[-1]:
            continue
        madds = [p.problem.madds for p in prepared.values()]
        contestants = {name: timing.measured(p, p.wait) for name, p in prepared.items()}
        times = np.array(list(timing.interleaved(contestants, rounds).values()))
        exponents = [_exponent(items, of_round) for of_round in times.T]
        rows.append(
            row("growth", axis, op, target.backend, exponents, expected=round(_exponent(items, madds), 2))
        )
    return rows


def _exponent(items: list[int], values: list[float] | np.ndarray) -> float:
    return float(np.polyfit(np.log(items), np.log(values), 1)[0])


LEAST_CONTROL = 1.9
"""What threads that share nothing must give, two against one, before and after a round for it to count."""

MOST_ROUNDS = 4
"""Times as many rounds are tried, at most, as are asked for."""


def time_threads(op: str, target: Target, rounds: int) -> list[Row]:
    """Time one thread against two with data of their own, and against Taichi on two cores.

    Around each round runs what shares nothing, multiply-adds in registers: less than 2 there is what the
    machine had not to give, and a round beside which it was too little does not count.  Where none does, all
    do.  Taichi shares out one batch of twice the size among its own threads.
    """
    size = SIZES["production"]
    runs = [target.prepare(op, size).__call__ for _ in range(2)]
    control = [limits.control(target.dtype) for _ in range(2)]
    with ThreadPoolExecutor(2) as pool, contextlib.ExitStack() as stack:
        one, two = (timing.measured_together(control[:count], pool) for count in (1, 2))
        contestants = {
            "1": timing.measured_together(runs[:1], pool),
            "2": timing.measured_together(runs, pool),
        }
        if any(map(importlib.util.find_spec, ("taichi", "quadrants"))):
            twice, threads = replace(size, batch=2 * size.batch), {"TI_CPU_MAX_NUM_THREADS": "2"}
            process = contestant("taichi", target.device, op, target.dtype, twice, **threads)
            contestants["taichi"] = stack.enter_context(process).measure
        tried: list[dict[str, float]] = []
        before = 2 * one() / two()
        while len(tried) < MOST_ROUNDS * rounds and len(undisturbed(tried)) < rounds:
            values = timing.interleaved(contestants, 1, seed=len(tried))
            after = 2 * one() / two()
            tried.append({name: value for name, (value,) in values.items()} | {"control": min(before, after)})
            before = after
    counted = undisturbed(tried) or tried

    def of(name: str, ratio: Callable[[dict[str, float]], float], required: float | str = "") -> Row:
        return row("threads", "production", op, name, list(map(ratio, counted)), required=required)

    rows = [of("2 threads / 1", lambda r: 2 * r["1"] / r["2"], cases.TWO_THREADS_RATIO)]
    rows.append(of("multiply-adds, 2 / 1", lambda r: r["control"]))
    rows.append(
        row("threads", "production", op, "rounds undisturbed", [len(undisturbed(tried)) / len(tried)])
    )
    if "taichi" in contestants:
        required = round(cases.TAICHI_RATIO, 3)
        rows.append(of("warp / taichi, on 2", lambda r: r["2"] / r["taichi"], required))
    return rows


def undisturbed(rounds: list[dict[str, float]]) -> list[dict[str, float]]:
    """Give the rounds beside which the control had two cores."""
    return [r for r in rounds if r["control"] >= LEAST_CONTROL]
