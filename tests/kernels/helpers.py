"""Calling operations on NumPy arrays; comparing with the specification, by dot product, by differences."""

import numpy as np

TOLERANCE = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 1e-12}
"""Largest error relative to the largest value: some hundred roundings, in another order."""

STEP = 1e-6
"""Step of central differences in float64: truncation and rounding are both about 1e-10 of the value."""

DIFFERENCE_TOLERANCE = 1e-6


class Runner:
    """Operations of one backend on one device, on NumPy arrays."""

    def __init__(self, backend, device):
        self.backend, self.device = backend, device

    def __call__(self, op, inputs, outputs, *tail, **options):
        """Call with copies of the arrays; give copies of the outputs as the operation left them."""
        given = [self._put(argument) for argument in inputs]
        results = [self.backend.from_host(array.copy(), self.device) for array in outputs]
        getattr(self.backend, op)(*given, *results, *tail, **options)
        self.backend.synchronize(self.device)
        return [np.array(self.backend.to_host(array)) for array in results]

    def _put(self, argument):
        return (
            self.backend.from_host(argument.copy(), self.device)
            if isinstance(argument, np.ndarray)
            else argument
        )


def assert_close(got, expected, tolerance=None):
    """Equal up to rounding, relative to the largest value; integers exactly."""
    assert got.shape == expected.shape
    assert got.dtype == expected.dtype
    if got.dtype.kind == "i":
        np.testing.assert_array_equal(got, expected)
        return
    scale = np.abs(expected).max(initial=0.0)
    np.testing.assert_allclose(
        got, expected, rtol=0, atol=(tolerance or TOLERANCE[got.dtype]) * max(scale, 1e-30)
    )


def assert_adjoint(a_x, y, x, adjoint_y):
    """<A x, y> == <x, A^T y>, in double precision from here on, relative to the sizes of the vectors."""
    left, right = (
        np.vdot(a_x.astype(float), y.astype(float)),
        np.vdot(x.astype(float), adjoint_y.astype(float)),
    )
    size = np.linalg.norm(a_x.astype(float)) * np.linalg.norm(y.astype(float))
    assert size > 0
    assert abs(left - right) <= {4: 1e-5, 8: 1e-12}[a_x.dtype.itemsize] * size


def assert_differences(loss, x, gradient, directions):
    """The gradient along each direction against central differences of the loss."""
    scale = np.linalg.norm(gradient)
    assert scale > 0
    for direction in directions:
        slope = (loss(x + STEP * direction) - loss(x - STEP * direction)) / (2 * STEP)
        expected = np.vdot(gradient, direction)
        assert abs(slope - expected) <= DIFFERENCE_TOLERANCE * scale * np.linalg.norm(direction)


def filled(shape, dtype, value=np.nan):
    """An output that holds something else; NaN where it must be overwritten."""
    return np.full(shape, value, dtype)
