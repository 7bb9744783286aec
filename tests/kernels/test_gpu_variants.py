"""What a GPU runs where a CPU has a variant of its own: the CPU runs it too, and finds the same."""

from functools import partial

import pytest

from evqr_kernels import get_backend

from . import cases
from .helpers import Runner, assert_close

pytest.importorskip("warp")

from evqr_kernels.warp_backend import banded, motion, render, splat_adjoint


def _as_on_gpus(make, *args, on_cpu):
    return make(*args, on_cpu=False)


@pytest.fixture
def warp_as_on_gpus(monkeypatch):
    """Warp on the CPU, with what suits GPUs."""
    for module, names in ((motion, ("BLOCK", "ROWS")), (banded, ("BLOCK",))):
        for name in names:
            monkeypatch.setattr(module, f"CPU_{name}", getattr(module, f"GPU_{name}"))
    for module, name in ((render, "make_render_code"), (splat_adjoint, "make_splat_events_adjoint")):
        monkeypatch.setattr(module, name, partial(_as_on_gpus, getattr(module, name)))
    return Runner(get_backend("warp"), "cpu")


@pytest.mark.parametrize(
    "case",
    [
        cases.motion_correlation,
        cases.solve_code_banded,
        cases.splat_events_adjoint,
        cases.splat_events_affine_adjoint,
        cases.render_code,
        cases.render_code_tilted_smooth,
    ],
)
def test_gpu_variants(case, warp_as_on_gpus, spec, dtype, rng):
    call = case(rng, dtype)
    for found, expected in zip(call.run(warp_as_on_gpus), call.run(spec), strict=True):
        assert_close(found, expected)
