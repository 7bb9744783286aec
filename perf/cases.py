"""Named cases, plain data: what is simulated, how many windows of it are timed, how large operations are."""

#: Sizes for operations: windows in a batch, events of a window, sides of image [px] and code [modules].
SIZES = {
    "small": {"batch": 2, "events": 300, "side": 40, "modules": 21},
    "production": {"batch": 8, "events": 20_000, "side": 256, "modules": 33},
}

#: What the sweep sets instead, one at a time, for operations whose number of items it changes.
SWEEP = {
    "events": (5_000, 10_000, 20_000, 40_000, 80_000),
    "side": (128, 180, 256, 362, 512),
    "modules": (17, 25, 33, 49, 65),
    "batch": (2, 4, 8, 16, 32),
}

#: What operations must reach against others in the same run, on one thread in float32: times as fast.
PEER_RATIOS = {
    ("splat_events", "numba"): 1.0,
    ("render_code", "numba"): 1.0,
    ("cost", "torch autograd"): 4.0,
}

#: An adjoint takes at most 2.5 times as long as its operation.
ADJOINT_RATIO = 1 / 2.5

#: Two threads with data of their own against one; Taichi within 1.5 times of Warp, both on two threads.
THREADED = ("splat_events", "splat_events_adjoint", "render_code", "render_code_adjoint", "cost")
TWO_THREADS_RATIO = 1.8
TAICHI_RATIO = 1 / 1.5

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

_FAST = {"direction": 10.0, "speed_px_ms": 5.0, "preset": "fast"}
_SLOW = {"direction": 110.0, "speed_px_ms": 2.0, "preset": "slow"}

#: Scenes without a code, for the pipeline against another commit; named after what they show, up to the dash:
#: several things that look a little like a code, or a label with a print of a kind of `without_code.py`.
WITHOUT_CODE = {
    "decoys-fast": {"windows": 4, "scene": {"code": False, **_FAST, "seed": 11}},
    "decoys-slow": {"windows": 4, "scene": {"code": False, **_SLOW, "seed": 12}},
    "boxes-fast": {"windows": 4, "print": "box", "scene": {"angle": 20.0, **_FAST, "seed": 13}},
    "boxes-slow": {"windows": 4, "print": "box", "scene": {"angle": 50.0, **_SLOW, "seed": 14}},
    "textures-fast": {"windows": 4, "print": "texture", "scene": {"angle": 35.0, **_FAST, "seed": 15}},
    "textures-slow": {"windows": 4, "print": "texture", "scene": {"angle": 65.0, **_SLOW, "seed": 16}},
    "symbols-data-matrix": {
        "windows": 4,
        "print": "DataMatrix",
        "scene": {"angle": 25.0, **_FAST, "seed": 17},
    },
    "symbols-aztec": {"windows": 4, "print": "Aztec", "scene": {"angle": 75.0, **_SLOW, "seed": 18}},
    "noise-fast": {"windows": 4, "print": "noise", "scene": {**_FAST, "duration_us": 100_000, "seed": 19}},
    "noise-slow": {"windows": 4, "print": "noise", "scene": {**_SLOW, "duration_us": 100_000, "seed": 20}},
}

#: The time of another commit's window with a code over that of this tree's window without one, at least: a
#: window of noise in half the time, others in twice of it.
WITH_OVER_WITHOUT = {"noise": 2.0, "boxes": 0.5, "decoys": 0.5, "textures": 0.5, "symbols": 0.5}

_LARGE = {
    "text": "NINTH",
    "version": 4,
    "ec": "Q",
    "angle": 15.0,
    "direction": 10.0,
    "speed_px_ms": 5.0,
    "module_px": 7.8,  # with its quiet zone the code is 320 px wide, a ninth of 1280 x 720
    "preset": "fast",
    "seed": 21,
}

#: The same code in two sizes of view, the second with the code in a ninth of it.
VIEWS = {
    "view-640x480": {"windows": 6, "scene": {**_LARGE, "width": 640, "height": 480}},
    "view-1280x720": {"windows": 6, "scene": {**_LARGE, "width": 1280, "height": 720}},
}

#: The first one's time over the second one's, at least.
VIEWS_RATIO = 1 / 1.3

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

#: Windows of each scene for one thread against two, and how often.
THREADS = {"windows": 400, "rounds": 3}
