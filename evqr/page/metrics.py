"""The same for Prometheus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from evqr.page.state import EDGES_MS, LineState

COUNTERS = {
    "parts_read": "Parts whose codes were read, and match.",
    "parts_not_read": "Parts without a reading, or with one that does not match.",
    "read": "Codes read.",
    "gap": "Times at which events were missing.",
    "clock": "Resets of the source's clock.",
    "overload": "Times in which searches were skipped.",
    "interruptions": "Times at which the source was lost.",
}


class LineCollector:
    """What prometheus_client asks for numbers.

    Parameters
    ----------
    state : LineState
        Of the line.
    """

    def __init__(self, state: LineState) -> None:
        self._state = state

    def collect(self) -> Iterator[Any]:
        """Give all metrics as they are now."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

        now = self._state.snapshot()
        for name, text in COUNTERS.items():
            yield CounterMetricFamily(f"evqr_{name}", text, value=now["counts"].get(name, 0))
        yield CounterMetricFamily("evqr_events", "Events that came.", value=now["events"])
        reasons = CounterMetricFamily("evqr_parts_by_reason", "Parts not read, by reason.", labels=["reason"])
        for reason, count in now["reasons"].items():
            reasons.add_metric([reason], count)
        yield reasons
        yield GaugeMetricFamily("evqr_up", "1 where source and sinks are there.", value=not now["problems"])
        yield GaugeMetricFamily("evqr_events_per_second", "Over ten seconds.", value=now["events_per_s"])
        yield GaugeMetricFamily("evqr_behind_seconds", "Behind the events.", value=now["behind_ms"] / 1e3)
        if now["read_rate"] is not None:
            yield GaugeMetricFamily("evqr_read_rate", "Of the last hundred parts.", value=now["read_rate"])
        yield GaugeMetricFamily("evqr_uptime_seconds", "Since the start.", value=now["uptime_s"])
        for name in ("latency_ms", "compute_ms"):
            total, buckets = 0, []
            for edge, count in zip((*EDGES_MS, float("inf")), now[name], strict=True):
                total += count
                buckets.append((f"{edge / 1e3:g}" if edge != float("inf") else "+Inf", total))
            text = "From the last event needed to the record." if name == "latency_ms" else "To read a code."
            sums = self._state.sums_s[name]
            yield HistogramMetricFamily(
                f"evqr_{name.removesuffix('_ms')}_seconds", text, buckets=buckets, sum_value=sums
            )
        for key, text in (("waiting", "Records that wait."), ("lost", "Records left out.")):
            family = GaugeMetricFamily(f"evqr_sink_{key}", text, labels=["sink"])
            for sink in now["sinks"]:
                family.add_metric([sink["name"]], sink[key])
            yield family
