"""What is loaded before threads start is all that reading a code launches."""

import pytest
from scenes import find, middle_us, scene

from evqr.events.batch import EventBatch
from evqr.events.buffer import EventBuffer
from evqr.fit.detection import Detection
from evqr.launched import LAUNCHED
from evqr.motion import Motion
from evqr.search.motion_estimate import MotionEstimate
from evqr.solver import Solver

pytest.importorskip("warp")

from evqr_kernels.warp_backend import language, replay


def test_every_kernel_is_in_a_module_that_was_loaded(monkeypatch):
    solver, launched = Solver(backend="warp"), set()
    loaded = {module.name for module in solver.workspace.backend._modules("cpu", LAUNCHED)}
    launch = language.wp.launch

    def seen(kernel, *arguments, **options):
        launched.add(kernel.module.name)
        return launch(kernel, *arguments, **options)

    made = scene(preset="fast")
    buffer, start = EventBuffer.of(made.events), middle_us(made) - 250
    monkeypatch.setattr(language.wp, "launch", seen)
    moving = buffer.answer(solver.motion_at(start))
    assert isinstance(moving, MotionEstimate)
    motion = Motion(moving.motion.parameters, start + 250)
    detection = find(solver, buffer.window(start, start + 500), motion)
    assert isinstance(detection, Detection)
    (followed,) = solver.follow(EventBatch.of([buffer.window(start + 500, start + 1000)]), [detection])
    solver.solve([followed])
    assert len(launched) > 8
    assert launched <= loaded, launched - loaded
    assert replay.run_sequence.module.name in loaded
