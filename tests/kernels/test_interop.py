"""Arrays of other libraries: read in place, or refused."""

import numpy as np
import pytest

import evqr_kernels
from evqr_kernels import get_backend
from evqr_kernels.interop import host_view, warp_view


class Foreign:
    """An array of another library, which speaks one protocol only."""

    def __init__(self, array, *protocols):
        self.array = array
        for protocol in protocols:
            setattr(self, protocol, getattr(array, protocol))


def foreign(array, protocol):
    names = {"dlpack": ("__dlpack__", "__dlpack_device__"), "interface": ("__array_interface__",)}
    return Foreign(array, *names[protocol])


every_protocol = pytest.mark.parametrize("protocol", ["dlpack", "interface"])


@every_protocol
def test_a_foreign_array_is_read_in_place(protocol):
    array = np.arange(6, dtype=np.float32).reshape(2, 3)
    view = host_view("x", foreign(array, protocol))
    assert isinstance(view, np.ndarray)
    assert np.shares_memory(view, array)
    array[1, 2] = 17
    assert view[1, 2] == 17


@every_protocol
def test_warp_sees_the_same_memory(protocol):
    array = np.arange(6, dtype=np.float64).reshape(2, 3)
    view = warp_view(foreign(array, protocol))
    assert np.shares_memory(view.numpy(), array)
    assert np.shares_memory(warp_view(array).numpy(), array)


@every_protocol
def test_checked_functions_take_foreign_arrays(protocol, rng):
    arrays = [rng.uniform(0, 8, 20).astype(np.float32) for _ in range(3)]
    arrays.append(np.array([0, 20], np.int32))
    expected = evqr_kernels.bin_events(*arrays, shape=(9, 9))
    out = np.zeros_like(expected)
    given = [foreign(array, protocol) for array in arrays]
    evqr_kernels.bin_events(*given, out=foreign(out, "interface"))
    np.testing.assert_array_equal(out, expected)


def test_a_backend_computes_on_foreign_memory(rng):
    first, second = rng.normal(size=(2, 1, 5, 6)).astype(np.float32)
    out = np.zeros_like(first)
    motion = np.array([[1, 2]], np.float32)
    views = [warp_view(foreign(array, "dlpack")) for array in (first, second, motion, out)]
    get_backend("warp").brightness_residual(*views)
    expected = evqr_kernels.brightness_residual(first, second, motion)
    np.testing.assert_array_equal(out, expected)


@every_protocol
def test_no_copy_is_made_of_what_is_not_contiguous(protocol):
    every_other = np.zeros((4, 6), np.float32)[:, ::2]
    with pytest.raises(ValueError, match="image must be contiguous"):
        evqr_kernels.reduce_image(foreign(every_other[None], protocol), ratio=2.0)
    with pytest.raises(ValueError, match="array must be contiguous"):
        warp_view(foreign(every_other, protocol))
    with pytest.raises(ValueError, match="array must be contiguous"):
        warp_view(every_other)
    with pytest.raises(ValueError, match=r"image must be contiguous, it is not copied: give np\.asc"):
        evqr_kernels.reduce_image(every_other[None], ratio=2.0)


def test_what_lies_on_a_gpu_is_refused_by_name():
    on_gpu = Foreign(np.zeros(3, np.float32))
    on_gpu.__cuda_array_interface__ = {}
    with pytest.raises(TypeError, match="weight is not in the host's memory"):
        evqr_kernels.bin_events(
            *[np.zeros(3, np.float32)] * 2, on_gpu, np.array([0, 3], np.int32), shape=(1, 1)
        )


def on_a_gpu(array):
    """As CuPy's and Numba's arrays are: they tell an address, shape, kind and strides, and nothing else."""
    made, told = Foreign(array), dict(array.__array_interface__, version=3)
    told["strides"] = None if array.flags.c_contiguous else array.strides
    made.__cuda_array_interface__ = told
    return made


def test_arrays_with_the_interface_of_gpus_are_views(monkeypatch):
    """Warp makes the view; here, where there is no GPU, of the same memory on the host."""
    import warp as wp

    real, array = wp.array, np.arange(6, dtype=np.float32).reshape(2, 3)

    def of_host(given, copy):
        told = given.__cuda_array_interface__
        assert copy is False
        dtype = wp.dtype_from_numpy(np.dtype(told["typestr"]))
        return real(
            ptr=told["data"][0], shape=told["shape"], strides=told["strides"], dtype=dtype, device="cpu"
        )

    monkeypatch.setattr(wp, "array", of_host)
    view = warp_view(on_a_gpu(array))
    assert view.ptr == array.ctypes.data and view.shape == (2, 3)
    with pytest.raises(ValueError, match="array must be contiguous, it is not copied"):
        warp_view(on_a_gpu(array[:, ::2]))
    with pytest.raises(TypeError, match="array must be float32, float64, int32"):
        warp_view(on_a_gpu(array.astype(np.int64)))


def test_what_does_not_give_its_memory_away_is_refused_by_name():
    class Closed:
        def __dlpack_device__(self):
            return (1, 0)

        def __dlpack__(self, **_):
            raise BufferError("it takes part in something")

    with pytest.raises(TypeError, match="image cannot be read without a copy: it takes part in something"):
        evqr_kernels.reduce_image(Closed(), ratio=2.0)


@pytest.mark.parametrize("dtype", [np.int64, np.float16, np.uint8, ">f4"])
@pytest.mark.parametrize("wrap", [lambda array: array, lambda array: foreign(array, "interface")])
def test_no_view_of_another_dtype(dtype, wrap):
    with pytest.raises(TypeError, match="array must be float32, float64, int32, uint16 or uint32, got"):
        warp_view(wrap(np.zeros(3, dtype)))
    if dtype != ">f4":  # DLPack has the machine's byte order only
        with pytest.raises(TypeError, match="array must be float32, float64, int32, uint16 or uint32, got"):
            warp_view(foreign(np.zeros(3, dtype), "dlpack"))


def test_a_read_only_array_is_an_input_and_no_output():
    array = np.ones((1, 4, 4), np.float32)
    array.flags.writeable = False
    read_only = foreign(array, "interface")
    np.testing.assert_array_equal(evqr_kernels.reduce_image(read_only, ratio=1.0), array)
    motion = np.zeros((1, 2), np.float32)
    with pytest.raises(ValueError, match="out must be writable"):
        evqr_kernels.brightness_residual(read_only, read_only, motion, out=read_only)


@pytest.mark.parametrize("no_array", [[1.0], "text", None, object()])
def test_what_is_no_array_is_refused(no_array):
    with pytest.raises(TypeError, match="image must be a NumPy array, got"):
        evqr_kernels.reduce_image(no_array, ratio=2.0)
    with pytest.raises(TypeError, match="array must speak __dlpack__ or"):
        warp_view(no_array)
