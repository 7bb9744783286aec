"""What a GPU runs where a CPU has a variant of its own: the CPU runs it too, and finds the same."""

import pytest

from evqr_kernels import get_backend

from . import cases
from .helpers import Runner, assert_close

pytest.importorskip("warp")

from evqr_kernels.warp_backend import banded, motion, render, render_adjoint


@pytest.fixture
def warp_as_on_gpus(monkeypatch):
    """Warp on the CPU, with what suits GPUs."""
    for module, names in ((motion, ("BLOCK", "ROWS")), (banded, ("BLOCK",))):
        for name in names:
            monkeypatch.setattr(module, f"CPU_{name}", getattr(module, f"GPU_{name}"))
    make_render_code = render.make_render_code

    def make_as_on_gpus(*args, on_cpu):
        return make_render_code(*args, on_cpu=False)

    monkeypatch.setattr(render, "make_render_code", make_as_on_gpus)

    def launch_as_on_gpus(grid, to_grid, outside, sigma, adj_image, rows_out, adj_grid_out):
        render_adjoint.launch_rows(grid, to_grid, outside, sigma, adj_image, rows_out)
        render_adjoint.launch_nodes(to_grid, sigma, adj_image, adj_grid_out)

    monkeypatch.setattr(render_adjoint, "launch_rows_and_nodes", launch_as_on_gpus)
    return Runner(get_backend("warp"), "cpu")


@pytest.mark.parametrize(
    "case",
    [
        cases.motion_correlation,
        cases.solve_code_banded,
        cases.render_code,
        cases.render_code_tilted_smooth,
    ],
)
def test_gpu_variants(case, warp_as_on_gpus, spec, dtype, rng):
    assert_same(case(rng, dtype), warp_as_on_gpus, spec)


@pytest.mark.parametrize("parameters", [6, 8])
@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.25, 0.9])
def test_render_adjoint_as_on_gpus(parameters, sigma, warp_as_on_gpus, spec, dtype, rng):
    assert_same(cases.render_code_adjoint(rng, dtype, parameters, sigma), warp_as_on_gpus, spec)


def assert_same(call, warp_as_on_gpus, spec):
    for found, expected in zip(call.run(warp_as_on_gpus), call.run(spec), strict=True):
        assert_close(found, expected)
