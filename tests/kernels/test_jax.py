"""Differentiable JAX functions: in place, and with the gradients that JAX finds for the definitions."""

import functools
import re

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="JAX is not installed")
jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import evqr_kernels.jax  # noqa: E402

from .framework_cases import (  # noqa: E402
    BAD_CALLS,
    CASES,
    NOT_DIFFERENTIABLE,
    assert_like,
    bad_arguments,
    brightness_residual,
    splat_events,
)

INDICES = ("window_ptr", "deposit_idx", "image_idx", "active")


def arrays_of(case):
    return {name: jnp.asarray(array) for name, array in case.arrays.items()}


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_output_and_gradients_are_those_of_the_definition(make, dtype, rng):
    """In one compiled function, and step by step."""
    case = make(rng, dtype)
    given = arrays_of(case)
    plain = {name: case.arrays[name] if name in INDICES else array for name, array in given.items()}
    options = {**case.options, **({"erf": jax.scipy.special.erf} if case.uses_erf else {})}
    options |= case.reference_options

    def ours(varied):
        return getattr(evqr_kernels.jax, case.op)(**{**given, **varied}, **case.options)

    def definition(varied):
        return case.reference(jnp, **{**plain, **varied}, **options)

    @jax.jit
    def expected_of(varied, adj):
        out, pull = jax.vjp(definition, varied)
        return out, pull(adj)[0]

    varied = {name: given[name] for name in case.varied}
    adj = jnp.asarray(rng.normal(size=ours(varied).shape).astype(dtype))
    expected, expected_adjoints = expected_of(varied, adj)
    for function in (ours, jax.jit(ours)):
        out, pull = jax.vjp(function, varied)
        assert_like(out, expected, dtype)
        for name, adjoint in pull(adj)[0].items():
            assert_like(adjoint, expected_adjoints[name], dtype)


@pytest.mark.parametrize("make", NOT_DIFFERENTIABLE, ids=lambda make: make.__name__)
def test_what_has_no_gradient_is_that_of_the_checked_function(make, dtype, rng):
    call = make(rng, dtype)
    arrays = {n: jnp.asarray(v) for n, v in call.checked.items() if isinstance(v, np.ndarray)}
    constants = {name: value for name, value in call.checked.items() if name not in arrays}
    expected = getattr(evqr_kernels, call.op)(**call.checked)
    function = functools.partial(getattr(evqr_kernels.jax, call.op), **constants)
    for got in (function(**arrays), jax.jit(function)(**arrays)):
        np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_no_copy_is_made(monkeypatch, rng):
    """The kernels get the memory of the arrays."""
    case = brightness_residual(rng, np.float32)
    given = arrays_of(case)
    evqr_kernels.jax.brightness_residual(**given)  # compiled
    backend = evqr_kernels.get_backend("warp")
    run, seen = backend.brightness_residual, []
    monkeypatch.setattr(backend, "brightness_residual", lambda *a: (seen.extend(x.ptr for x in a), run(*a)))
    out = evqr_kernels.jax.brightness_residual(**given)
    assert seen == [array.unsafe_buffer_pointer() for array in (*given.values(), out)]


def test_inputs_without_an_adjoint_get_zero(rng):
    case = splat_events(rng, np.float32)
    given = arrays_of(case)

    def loss(t):
        return evqr_kernels.jax.splat_events(**{**given, "t": t}, **case.options).var()

    np.testing.assert_array_equal(jax.grad(loss)(given["t"]), 0)


def test_one_after_the_other_under_vmap(rng):
    case = brightness_residual(rng, np.float32)
    luminance, events, motion = arrays_of(case).values()
    motions = jnp.stack([motion, -motion, 2 * motion])
    together = jax.vmap(lambda m: evqr_kernels.jax.brightness_residual(luminance, events, m))(motions)
    for one, m in zip(together, motions, strict=True):
        np.testing.assert_array_equal(one, evqr_kernels.jax.brightness_residual(luminance, events, m))


def sharpness_of_motion(rng):
    given = arrays_of(splat_events(rng, np.float64))
    motion = given.pop("motion")
    options = splat_events(rng, np.float64).options
    return (lambda m: (evqr_kernels.jax.splat_events(motion=m, **given, **options) ** 2).sum()), motion


def test_gradients_of_a_batch_compiled(rng):
    """`jit`, `vmap` and `grad`, one inside the other."""
    sharpness, motion = sharpness_of_motion(rng)
    motions = jnp.stack([motion, 0.5 * motion])
    together = jax.jit(jax.vmap(jax.grad(sharpness)))(motions)
    for one, m in zip(together, motions, strict=True):
        np.testing.assert_allclose(one, jax.grad(sharpness)(m), rtol=1e-9)


def test_a_second_gradient_is_refused(rng):
    sharpness, motion = sharpness_of_motion(rng)
    with pytest.raises(TypeError, match="splat_events_adjoint has no adjoint of its own"):
        jax.grad(lambda m: jax.grad(sharpness)(m).sum())(motion)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"motion": np.zeros((3, 5), np.float32)},
            ValueError,
            r"motion must have shape .* or \(B, 6\)",
        ),
        ({"motion": np.zeros((2, 2), np.float32)}, ValueError, "motion must have shape .* with B = 3"),
        ({"weight": np.zeros(300)}, TypeError, "weight must be float32 like the arrays before it"),
        ({"window_ptr": np.zeros(4, np.float32)}, TypeError, "window_ptr must be int32, got float32"),
    ],
)
def test_bad_arguments(change, error, message, rng):
    case = splat_events(rng, np.float32)
    given = {**arrays_of(case), **{name: jnp.asarray(array) for name, array in change.items()}}
    with pytest.raises(error, match=message):
        evqr_kernels.jax.splat_events(**given, **case.options)
    with pytest.raises(TypeError, match=r"x must be a jax.Array, got ndarray"):
        evqr_kernels.jax.splat_events(**{**given, "x": case.arrays["x"]}, **case.options)


@pytest.mark.parametrize(("op", "changes", "error", "message"), BAD_CALLS)
def test_what_the_checked_functions_refuse(op, changes, error, message):
    arrays, options = bad_arguments(op, changes, jnp.asarray)
    message = message.replace("a NumPy array", "a jax.Array").replace("result", op)
    with pytest.raises(error, match=re.escape(message)):
        getattr(evqr_kernels.jax, op)(*arrays, **options)


def test_a_jax_array_is_no_out():
    out = jnp.zeros((1, 4, 4))
    given = np.ones((1, 4, 4)), np.ones((1, 4, 4)), np.ones((1, 2))
    with pytest.raises(ValueError, match="out must be writable"):
        evqr_kernels.brightness_residual(*given, out=out)
    np.testing.assert_array_equal(out, 0)


def test_checked_functions_take_jax_arrays(rng):
    case = splat_events(rng, np.float32)
    image = evqr_kernels.splat_events(**arrays_of(case), **case.options)
    np.testing.assert_array_equal(image, evqr_kernels.splat_events(**case.arrays, **case.options))


def test_what_a_traced_function_is_given_is_looked_at_when_it_runs(rng, capfd):
    case = splat_events(rng, np.float32)
    given = arrays_of(case)

    @jax.jit
    def image(window_ptr):
        return evqr_kernels.jax.splat_events(**{**given, "window_ptr": window_ptr}, **case.options)

    assert image(given["window_ptr"]).shape == (3, *case.options["shape"])
    with pytest.raises((ValueError, jax.errors.JaxRuntimeError), match="must not decrease, got 0 after 300"):
        image(jnp.array([0, 300, 0, 300], jnp.int32)).block_until_ready()
    assert "window_ptr must not decrease" in capfd.readouterr().out  # Warp prints it, too
