"""Rows of results: made, printed, saved, and compared with those of an earlier run."""

from __future__ import annotations

import csv
import datetime
import io
import json
import statistics
from pathlib import Path

Row = dict[str, str | float | int]
"""Columns: part, case, method, stage, median, lower and upper quartile, n, required, read; rows of operations
have more, and with an earlier run to compare with, ``base`` is that run's median over this one's."""

KEY = ("part", "case", "method", "stage")


def quartiles(values: list[float]) -> tuple[float, float, float]:
    low, middle, high = statistics.quantiles(values, n=4) if len(values) > 1 else 3 * values
    return low, middle, high


def row(part: str, case: str, method: str, stage: str, values: list[float], **more: str | float) -> Row:
    low, median, high = quartiles(values)
    return {
        "part": part,
        "case": case,
        "method": method,
        "stage": stage,
        "median": round(median, 4),
        "lower": round(low, 4),
        "upper": round(high, 4),
        "n": len(values),
        "required": "",
        "read": "",
        **more,
    }


def met(r: Row) -> bool:
    """Whether a row is as it is required to be: medians are at least that, where anything is."""
    return not r["required"] or float(r["median"]) >= float(r["required"])


def compare(rows: list[Row], base: Path) -> None:
    """Add to each row what the same row of a saved run has, as a ratio."""
    lines = (line for line in base.read_text().splitlines() if not line.startswith("#"))
    earlier = {tuple(r[k] for k in KEY): float(r["median"]) for r in csv.DictReader(lines)}
    for r in rows:
        before = earlier.get(tuple(str(r[k]) for k in KEY))
        r["base"] = round(before / float(r["median"]), 3) if before and r["median"] else ""


def as_csv(about: dict[str, str], rows: list[Row]) -> str:
    text = io.StringIO()
    for name, value in about.items():
        text.write(f"# {name}: {value}\n")
    columns = dict.fromkeys(column for r in rows for column in r)
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_json(about: dict[str, str], rows: list[Row]) -> str:
    return json.dumps({"about": about, "rows": rows}, indent=1) + "\n"


def as_human(about: dict[str, str], rows: list[Row]) -> str:
    wide = max((len(str(r["method"])) for r in rows), default=0) + 1
    lines = [f"{name:12s} {value}" for name, value in about.items()]
    part = None
    for r in rows:
        if r["part"] != part:
            part = r["part"]
            head = f"{part:18s} {'method':{wide}s} {'stage':22s} {'median':>8s}   {'quartiles':>17s}     n"
            lines.append("\n" + head + (_OP_HEAD if "rate" in r else ""))
        spread = f"{r['lower']:8.2f} {r['upper']:8.2f}"
        line = f"{r['case']:18s} {r['method']:{wide}s} {r['stage']:22s} {r['median']:8.2f}"
        line += f"   {spread} {r['n']:5d}"
        line += _of_operation(r) if "rate" in r else ""
        if r["read"]:
            line += f"   read {r['read']}"
        if r["required"]:
            line += f"   required {r['required']}: {'ok' if met(r) else 'MISSED'}"
        if r.get("expected"):
            line += f"   expected {r['expected']}"
        if r.get("base"):
            line += f"   base {r['base']:.2f} x"
        lines.append(line)
    return "\n".join(lines) + "\n"


_OP_HEAD = "  compile s  first ms      M/s  of limit"


def _of_operation(r: Row) -> str:
    """Compile time, first launch, throughput and share of what bounds it; rivals have the throughput only."""
    if r["share"] == "":
        return f"{'':19s}  {r['rate']:9.2f}"
    once = (r["compile s"], r["first ms"])
    first = "".join(f"{value:10.2f}" if value != "" else f"{'':10s}" for value in once)
    return f"{first} {r['rate']:9.2f} {r['share']:8.1%} of {r['bound']}, {r['unit']}s"


def save(device: str, about: dict[str, str], rows: list[Row], *labels: str) -> Path:
    """Write perf/results/DEVICE/DATE-COMMIT-LABELS.csv."""
    date = datetime.date.today().isoformat()
    folder = Path(__file__).parent / "results" / device.replace(":", "-")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{'-'.join((date, about['commit'], *labels))}.csv"
    path.write_text(as_csv(about, rows))
    return path
