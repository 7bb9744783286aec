"""The checked door: functions on arrays that check, choose a backend, allocate, and compute.

They take NumPy's arrays, and those in the host's memory of any library that speaks DLPack or
``__array_interface__``, which are read in place; they return NumPy's.  Nothing is copied unasked: an array
that is not C-contiguous is refused, and so is an ``out`` that is read-only, as those of JAX are.
`evqr_kernels.torch` and `evqr_kernels.jax` work on a GPU's memory as well.  Who owns device buffers calls the
methods of the backend, which have the same names and take the same arrays.

What holds for every operation is said here once; their own documentation says what each adds.

**Arrays.**  ``(B, Y, X) float [px]`` is an array of that shape, of that dtype, in that unit.  ``float`` is
float32 or float64, the same for all arrays of a call.  Shape letters: B windows, E events, Y and X rows and
columns of images; a letter is one size throughout a call.  Units: [px] of the sensor, [image px] of the image
at hand, [weight] that of the events' weights and so of the images made of them, [loss] that of what is
differentiated, [1] none, [any] what the caller likes, [of name] that of another argument.

**Parameters.**  ``backend`` is a name for `evqr_kernels.get_backend`; ``device`` is "cpu", "cuda:0",
..., by default the backend's first.

**Raises.**

- `TypeError`: what is no array or cannot be read in place, or is of the wrong dtype.
- `ValueError`: a wrong shape, layout or name, a setting or index out of range (NaN is out of every range that
  begins somewhere), a device that the backend does not have, an ``out`` that is read-only or shares memory
  with an input, more than 2^30 events, or more than 2^31 - 1 elements of an array, scratch included; times
  ``t`` that are a hundred times as far from the reference time as from each other, where that takes all
  events out of the image; images in float32 in which a window of 2^24 events or more counted up to 2^24.
- `BackendUnavailable`: a backend that cannot be loaded here.
- `OperationRefused`: an operation, dtype or device that the backend refuses, with its reason.

**What is not finite.**  An event with a position, time or velocity that is NaN or infinite is dropped, as one
beside the image is, by all operations and backends; what else is not finite shows in the results that
depend on it.  An image of no pixels is allowed.

**Cost** counts what Warp's and Taichi's kernels do, and the scratch that a call allocates beside its results,
of the call's float type unless said otherwise.  NumPy's code is the specification, written to be read, and
takes more of both.  On a GPU a call copies its inputs there and its results back.  The first call with a
device, dtype, `SplatConfig`, count of parameters, taps or columns of a table compiles kernels for it, which
takes seconds; they are kept on disk.

**Determinism** is of one call repeated on one device, with one backend.

- *bit for bit*: Each number is the work of one thread, in one order; where threads share a sum, each has a
  part, and one adds the parts up, in order.  A window, or pose, has the same result alone, in a batch and in
  any place of it.
- *atomics*: Threads add to one image.  On a GPU their order differs from run to run, and results by rounding.
  On a CPU one thread adds a window's events in order: bit for bit, and as in any batch.

Backends and devices agree with each other to rounding.
"""

# what is taken is what __all__ of each module lists
# ruff: noqa: F403
from evqr_kernels.ops import codes, events, grids, images, normal, render
from evqr_kernels.ops.codes import *
from evqr_kernels.ops.events import *
from evqr_kernels.ops.grids import *
from evqr_kernels.ops.images import *
from evqr_kernels.ops.normal import *
from evqr_kernels.ops.render import *

__all__: list[str] = []
__all__ += codes.__all__
__all__ += events.__all__
__all__ += grids.__all__
__all__ += images.__all__
__all__ += normal.__all__
__all__ += render.__all__
