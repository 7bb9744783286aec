"""The model of a GPU: of canned counts and machine code, the times that can be worked out by hand."""

import sys
from collections import Counter, defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from evqr.solver import Solver
from evqr_kernels import register_backend, registry

pytest.importorskip("warp")
sys.path.insert(0, str(Path(__file__).parents[2] / "perf"))

import device_model as dm
import device_work
import machine_code
from counting import Counts, Launch

DUMP = """
\t\tFunction : make_one__locals__one_cuda_kernel_forward
        /*0000*/                   MOV R1, c[0x0][0x28] ;                     /* 0x00 */
                                                                              /* 0x01 */
        /*0010*/                   ISETP.GE.U32.AND P0, PT, R2, R3, PT ;
        /*0020*/                   MOV R4, RZ ;
        /*0030*/                   MOV R5, RZ ;
        /*0040*/                   LDG.E R6, desc[UR4][R8.64] ;
        /*0050*/                   LDG.E R7, desc[UR4][R8.64+0x4] ;
        /*0060*/                   FFMA R5, R6, R7, R5 ;
        /*0070*/              @P1  BRA 0x40 ;
        /*0080*/              @P2  BRA 0x30 ;
        /*0090*/                   REDG.E.ADD.F32.FTZ.RN.STRONG.GPU desc[UR4][R8.64], R5 ;
        /*00a0*/              @!P0 BRA 0x10 ;
        /*00b0*/                   EXIT ;
        /*00c0*/                   BRA 0xc0;
        /*00d0*/                   NOP;
"""


class Kernel:
    """What is asked of a kernel of Warp's: its name, and that of its module."""

    def __init__(self, name):
        self.func, self.module = SimpleNamespace(__name__=name), SimpleNamespace(name="module")


GPU = dm.Device("a GPU", 90, processors=10, clock=1e9, memory=1e12, cache=1e6, atomics=1e9)
CODE = machine_code.Code(once=100, around=0, inside=40, loads=4, atomics=0)


def modelled(*launches, bus=1e9, **counts):
    known = {machine_code.key_of(launch.kernel, 90): CODE for launch in launches if launch.kernel}
    made = Counts(made=Counter(launches), recorded=len(launches), **counts)
    observed = dm.Observed(1, 1000, made, {}, host=1e-3, copied=1e-4, decode=2e-3, right=True)
    return dm.model(observed, known, GPU, bus)


def clip_rows(threads, n_bytes=1000, width=300):
    return Launch("clip_outliers", Kernel("clip_rows"), threads, (("image", (1, 8, width)),), n_bytes)


def test_loops_are_read_from_machine_code():
    """Of Warp's loop over indices, a loop and one in it, which has the loads."""
    assert machine_code.read_code(DUMP) == {
        "one": machine_code.Code(once=7, around=2, inside=4, loads=2, atomics=1)
    }


def test_a_loop_that_was_unrolled_does_several_steps_a_turn():
    assert device_work.instructions(CODE, device_work.Work(0, 300, 1)) == 100 + 40 / 4 * 300
    assert device_work.instructions(CODE, device_work.Work(0, 300, 4)) == 100 + 40 * 300
    around = machine_code.Code(once=1, around=7, inside=0, loads=0, atomics=0)
    assert device_work.instructions(around, device_work.Work(5, 9, 3)) == 36


def test_few_threads_wait_for_themselves_and_many_for_schedulers():
    each = 100 + 40 * 300 / 16  # 16 pixels at a time
    (one,) = modelled(clip_rows(1)).parts
    assert one.bound == "chain" and one.seconds == pytest.approx(each * 2.5e-9 + dm.GAP)
    (many,) = modelled(clip_rows(256 * 10 * 4)).parts  # four blocks of two warps a scheduler
    assert many.bound == "issue" and many.seconds == pytest.approx(each * 8e-9 + dm.GAP)
    (small,) = modelled(clip_rows(1, width=0)).parts
    assert small.bound == "gap"
    (large,) = modelled(clip_rows(1, n_bytes=10_000_000)).parts
    assert large.bound == "memory" and large.seconds == pytest.approx(1e-5 + dm.GAP)


def test_events_are_shared_out_among_threads_and_added_one_by_one():
    given = (("window_ptr", (2, 2)),)
    name = "deposit_packed_events"
    (part,) = modelled(Launch(name, Kernel(name), 200, given, 0)).parts
    assert part.instructions == 100 + 40 * 10
    assert part.bound == "atomics" and part.seconds == pytest.approx(8 * 1000 / 1e9 + dm.GAP)


def test_conjugate_gradients_that_have_ended_do_no_more_work():
    given = {"rhs": (1, 20, 30), "stencil": (1, 5, 5), "max_iterations": 40}
    all_of_them = device_work.work_of("solve_code.solve_blocks", device_work.Sizes(given, 0, 256))
    some = device_work.work_of("solve_code.solve_blocks", device_work.Sizes(given, 0, 256, iterations=10.0))
    assert all_of_them.steps == 41 * 3 * 25 and some.steps == 11 * 3 * 25  # three modules a thread


def test_a_batch_takes_what_its_parts_take():
    launches = clip_rows(1, width=1600), Launch("clear", None, 100, (), 400)
    m = modelled(*launches, graphs=1, uploads=2, downloads=1, up_bytes=3_000_000, down_bytes=1_000_000)
    assert m.bus == pytest.approx(4e-3) and m.copies == pytest.approx(44e-6)
    assert m.launching == pytest.approx(10e-6) and m.device == pytest.approx(4100 * 2.5e-9 + 2 * dm.GAP)
    assert m.total == pytest.approx(1e-3 + 4e-3 + 44e-6 + m.device)
    assert {part.name: part.launches for part in m.parts} == {"clip_outliers.clip_rows": 1, "clear": 1}


def test_a_kernel_that_the_table_does_not_have_is_marked():
    launch = Launch("new", Kernel("new"), 10, (("image", (5, 20)), ("setting", 3)), 400)
    (part,) = modelled(launch).parts
    assert part.instructions == 100 + 40 * 20
    observed = dm.Observed(128, 36_000, Counts(made=Counter([launch])), {}, 1e-3, 1e-4, 2e-3, right=False)
    printed = dm.lines("tracked", observed, defaultdict(lambda: CODE), 3)
    assert "NOT READ" in printed[0] and "goal 10000" in printed[2]
    assert any("new.new? " in line for line in printed)


def test_idle_the_backend_gives_what_it_brought_before_and_computes_nothing():
    backend = dm.TracedBackend("numpy")
    there = backend.from_host(np.ones((1, 4, 5), np.float32), "cpu")
    replay = backend.record(lambda: backend.clear(there))
    before = backend.to_host(there)
    backend.idle = list(backend.downloads)
    backend.clear(there)
    replay()
    backend.assign(there, np.zeros((1, 4, 5), np.float32))
    np.testing.assert_array_equal(backend.to_host(there), before)
    backend.idle = None
    np.testing.assert_array_equal(backend.to_host(there), 1.0)
    assert backend.counts.recorded == backend.counts.launches == backend.counts.uploads - 1 == 0


def test_the_demo_is_counted_and_read(monkeypatch):
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_loaded", dict(registry._loaded))
    register_backend("traced", "device_model:load_traced")
    solver = Solver(backend="traced")
    scene = dm.make_scene(solver, 10_000)
    assert abs(len(scene.window) - 10_000) < 500
    tracked = dm.observe("tracked", scene, 3, 10_000, Solver(backend="traced"))
    assert tracked.right and tracked.counts.up_bytes > 3 * 8 * 9_500
    assert any(0 < iterations <= 8 and samples > 1000 for iterations, samples in tracked.turns.values())
    cold = dm.observe("cold", scene, 3, 10_000, solver)
    assert cold.right and cold.counts.up_bytes > 8 * 9_500
    for observed in (tracked, cold):
        m = dm.model(observed, defaultdict(lambda: CODE), GPU, 1e10)
        assert m.device > dm.GAP * observed.counts.recorded and 0 < m.python < m.total
