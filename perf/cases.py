"""Named cases, plain data: what is simulated and how many windows of it are timed."""

#: Scenes for the pipeline: arguments of `evqr.simulate.simulate`, and windows spread over the recording.
PIPELINE = {
    "fast-2H-30": {
        "windows": 8,
        "scene": {
            "text": "PIPELINE",
            "version": 2,
            "ec": "H",
            "angle": 30.0,
            "direction": 10.0,
            "speed_px_ms": 5.0,
            "module_px": 6.0,
            "preset": "fast",
            "seed": 1,
        },
    },
    "fast-4Q-63": {
        "windows": 8,
        "scene": {
            "text": "PIPELINE 4-Q",
            "version": 4,
            "ec": "Q",
            "angle": 63.0,
            "direction": 200.0,
            "speed_px_ms": 8.0,
            "module_px": 4.5,
            "preset": "fast",
            "seed": 2,
        },
    },
    "slow-2H-0": {
        "windows": 8,
        "scene": {
            "text": "PIPELINE",
            "version": 2,
            "ec": "H",
            "angle": 0.0,
            "direction": 0.0,
            "speed_px_ms": 1.0,
            "module_px": 6.0,
            "preset": "slow",
            "seed": 3,
        },
    },
    "slow-6Q-17": {
        "windows": 8,
        "scene": {
            "text": "PIPELINE 6-Q",
            "version": 6,
            "ec": "Q",
            "angle": 17.0,
            "direction": 110.0,
            "speed_px_ms": 2.0,
            "module_px": 4.0,
            "preset": "slow",
            "seed": 4,
        },
    },
    "clean-2H-45": {
        "windows": 8,
        "scene": {
            "text": "PIPELINE",
            "version": 2,
            "ec": "H",
            "angle": 45.0,
            "direction": 320.0,
            "speed_px_ms": 2.0,
            "module_px": 6.0,
            "preset": "clean",
            "seed": 5,
        },
    },
}

#: What must be read, and alike on every backend, before a time is printed.
GATE = {
    "text": "GATE",
    "version": 1,
    "ec": "M",
    "angle": 25.0,
    "direction": 70.0,
    "speed_px_ms": 4.0,
    "module_px": 6.0,
    "preset": "slow",
    "width": 320,
    "height": 240,
    "duration_us": 4000,
    "seed": 6,
}

#: Windows for one thread against two.
THREADS = {"scene": "fast-2H-30", "windows": 48, "rounds": 5}
