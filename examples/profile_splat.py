#!/usr/bin/env python3
"""Launch one kernel many times on buffers of its own: something for a profiler to look at.

usage: profile_splat.py [--device cpu] [--windows 64] [--events 10000] [--side 200] [--launches 20]
                        [--adjoint]

A backend's methods are the hot path: unchecked, no allocation, everything stays on the device.  Under
NVIDIA's profiler:  ncu --kernel-name regex:splat python examples/profile_splat.py --device cuda:0
"""

import argparse
import statistics
import sys
import time

import numpy as np

from evqr_kernels import SplatConfig, get_backend, make_scratch


def main() -> int:
    """Time launches."""
    parser = argparse.ArgumentParser(description="Launch the splat kernel many times.")
    parser.add_argument("--device", default="cpu")
    for name, default in (("windows", 64), ("events", 10000), ("side", 200), ("launches", 20)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--adjoint", action="store_true", help="the adjoint in weights and motion")
    arguments = parser.parse_args()
    batch, events, side, device = arguments.windows, arguments.events, arguments.side, arguments.device

    rng, total = np.random.default_rng(0), batch * events
    columns = [rng.uniform(0, side, total), rng.uniform(0, side, total), rng.uniform(-1e-3, 1e-3, total)]
    columns.append(rng.choice([-1.0, 1.0], total))
    per_window = [
        rng.uniform(-2000, 2000, (batch, 2)),
        np.zeros((batch, 2)),
        np.tile([0.0, 0, 1], (batch, 1)),
    ]

    backend = get_backend("warp")
    x, y, t, weight, motion, lag, frame = (
        backend.from_host(array.astype(np.float32), device) for array in (*columns, *per_window)
    )
    window_ptr = backend.from_host(np.arange(batch + 1, dtype=np.int32) * events, device)
    image = backend.from_host(rng.normal(size=(batch, side, side)).astype(np.float32), device)
    inputs = (x, y, t, weight, window_ptr, motion, lag, frame)
    adjoints = make_scratch(backend, device, "splat_events_adjoint", B=batch, E=total, P=2)
    adjoints += [
        backend.empty(shape, np.float32, device) for shape in ((total,), (batch, 2), (total,), (total,))
    ]
    cfg, times = SplatConfig(), []
    for _ in range(arguments.launches + 1):
        backend.synchronize(device)
        begin = time.perf_counter()
        if arguments.adjoint:
            backend.splat_events_adjoint(*inputs, image, *adjoints, cfg)
        else:
            backend.splat_events(*inputs, image, cfg)
        backend.synchronize(device)
        times.append(time.perf_counter() - begin)

    first, *steady = times
    median = statistics.median(steady)
    name = "splat_events" + "_adjoint" * arguments.adjoint
    print(f"{name} on {device}: first launch {1e3 * first:.1f} ms (compiled if need be)")
    print(f"then {1e3 * median:.2f} ms")
    print(f"{total / median / 1e6:.1f} million events a second, {1e9 * median / total:.0f} ns an event")
    return 0


if __name__ == "__main__":
    sys.exit(main())
