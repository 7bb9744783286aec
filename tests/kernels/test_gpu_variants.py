"""What a GPU runs where a CPU has a variant of its own: the CPU runs it too, and finds the same."""

import importlib
import pkgutil

import numpy as np
import pytest

from evqr_kernels import SplatConfig, get_backend

from . import cases
from .helpers import Runner, assert_close
from .test_align import EXACT, SIDES, align
from .test_batches import ALL
from .test_solve import EXACT as EXACT_SOLUTION
from .test_solve import solve

pytest.importorskip("warp")

from evqr_kernels import warp_backend
from evqr_kernels.warp_backend import language, render, render_adjoint, splat, splat_adjoint

SPLATS = [
    cases.splat_events,
    cases.splat_events_affine,
    cases.splat_events_adjoint,
    cases.splat_events_affine_adjoint,
]


@pytest.fixture
def warp_as_on_gpus(monkeypatch):
    """Warp on the CPU, with what suits GPUs."""
    monkeypatch.setattr(language, "kind_of", lambda device: "cuda")
    monkeypatch.setattr(language, "architecture_of", lambda device: 90)

    def as_on_gpus(make, **variant):
        return lambda *args, **chosen: make(*args, **{**chosen, **variant})

    for module, make, variant in ((render, "make_render_code", {"on_cpu": False}),):
        monkeypatch.setattr(module, make, as_on_gpus(getattr(module, make), **variant))

    for module in (splat, splat_adjoint):
        monkeypatch.setattr(module, "holds_rows", lambda device: False)

    def launch_as_on_gpus(grid, to_grid, outside, sigma, adj_image, rows_out, adj_grid_out):
        render_adjoint.launch_rows(grid, to_grid, outside, sigma, adj_image, rows_out)
        render_adjoint.launch_nodes(to_grid, sigma, adj_image, adj_grid_out)

    monkeypatch.setattr(render_adjoint, "launch_rows_and_nodes", launch_as_on_gpus)
    return Runner(get_backend("warp"), "cpu")


def test_choices_by_device_are_declared_in_the_table():
    """Blocks by device that stand in a file of the backend would go untested."""
    for found in pkgutil.iter_modules(warp_backend.__path__):
        module = importlib.import_module(f"{warp_backend.__name__}.{found.name}")
        assert [name for name in vars(module) if name.startswith(("CPU_", "GPU_"))] in ([], ["CPU_FLAGS"])


@pytest.mark.parametrize("case", ALL, ids=lambda case: case.__name__)
def test_gpu_variants(case, warp_as_on_gpus, spec, dtype, rng):
    assert_same(case(rng, dtype), warp_as_on_gpus, spec)


@pytest.mark.parametrize("parameters", [6, 8])
@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.25, 0.9])
def test_render_adjoint_as_on_gpus(parameters, sigma, warp_as_on_gpus, spec, dtype, rng):
    assert_same(cases.render_code_adjoint(rng, dtype, parameters, sigma), warp_as_on_gpus, spec)


@pytest.mark.usefixtures("warp_as_on_gpus")
@pytest.mark.parametrize("sides", SIDES, ids=str)
@pytest.mark.parametrize("tilt", [False, True])
def test_align_as_on_gpus(tilt, sides, dtype):
    options = {"max_iterations": 3, "tolerance": 0.0, "sides": sides}
    poses, values = align("warp", dtype, tilt, **options)
    expected, expected_values = align("numpy", dtype, tilt, **options)
    assert_close(poses, expected, EXACT[np.dtype(dtype)])
    assert_close(values[:, :3], expected_values[:, :3], EXACT[np.dtype(dtype)])


@pytest.mark.parametrize("shape", [(12, 12), (5, 14), (110, 108)], ids=str)
@pytest.mark.parametrize("tolerance", [0.0, 1e-2])
def test_solve_as_on_gpus(tolerance, shape, warp_as_on_gpus, spec, dtype, rng):
    """With room for the direction in memory that a block shares, and without."""
    system, limit = cases.systems(rng, dtype, shape), 5 if tolerance == 0.0 else 100
    found = solve(warp_as_on_gpus, system, max_iterations=limit, tolerance=tolerance)
    expected = solve(spec, system, max_iterations=limit, tolerance=tolerance)
    assert_close(found[0], expected[0], EXACT_SOLUTION[np.dtype(dtype)])
    np.testing.assert_array_equal(found[1], expected[1])


@pytest.mark.parametrize("epsilon_px", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("case", SPLATS, ids=lambda case: case.__name__)
def test_wide_splats_as_on_gpus(case, epsilon_px, warp_as_on_gpus, spec, dtype, rng):
    call = case(rng, dtype)
    call.tail = (SplatConfig(epsilon_px=epsilon_px),)
    assert_same(call, warp_as_on_gpus, spec)


@pytest.mark.parametrize("shape", [(1, 1), (9, 1), (1, 9), (4, 3), (5, 6)])
@pytest.mark.parametrize("case", [cases.splat_events, cases.splat_events_adjoint])
def test_splats_wider_than_the_image_as_on_gpus(case, shape, warp_as_on_gpus, spec, dtype, rng):
    call = case(rng, dtype)
    call.tail = (SplatConfig(epsilon_px=2.0),)
    call.inputs[:2] = rng.uniform(-3, np.add(shape[::-1], 2)[:, None], (2, len(call.inputs[0]))).astype(dtype)
    image = rng.normal(size=(cases.B, *shape)).astype(dtype)
    if case is cases.splat_events:
        call.outputs = [image]
    else:
        call.inputs[-1] = image
    assert_same(call, warp_as_on_gpus, spec)


@pytest.mark.parametrize("shape", [(0, 4), (4, 0)])
def test_splats_in_images_without_a_pixel_as_on_gpus(shape, warp_as_on_gpus, dtype, rng):
    call = cases.splat_events(rng, dtype)
    call.outputs = [np.zeros((cases.B, *shape), dtype)]
    (image,) = call.run(warp_as_on_gpus)
    assert image.shape == (cases.B, *shape)


def assert_same(call, warp_as_on_gpus, spec):
    for found, expected in zip(call.run(warp_as_on_gpus), call.run(spec), strict=True):
        assert_close(found, expected)
