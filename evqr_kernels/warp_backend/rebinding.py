"""A recorded sequence of launches whose arrays are others at each call.

For callers whose memory is new each time.  To launch, Warp looks every argument over and packs it: some
microseconds an array, and there are twenty of them.  Of arrays with the shapes and dtypes of an earlier call
only the addresses differ, so the launches are recorded once, on places that stand for arrays, and at each
call the addresses are written into them.
"""

from collections.abc import Callable, Sequence
from typing import Any

import warp as wp

from evqr_kernels.warp_backend.language import recorded
from evqr_kernels.warp_backend.replay import Recorded, Replay, replayer

_BITS = 40
"""A place has so many bits of an address to itself: what is added to its first address is an offset in it."""

_OFFSET = (1 << _BITS) - 1


def place(number: int, shape: tuple[int, ...], dtype: Any, device: wp.Device) -> wp.array:
    """Give what stands for the array of a number in a sequence: an array without memory."""
    return wp.array(ptr=(number + 1) << _BITS, dtype=dtype, shape=shape, device=device)


class Rebindable:
    """Launches that are recorded on places, to be made on arrays; by one thread at a time.

    Parameters
    ----------
    run : callable
        Launches, on places.
    """

    def __init__(self, run: Callable[[], None]) -> None:
        steps = recorded(run)
        self._replay = replayer(steps, looks=0)
        arrays = _arrays(self._replay, steps)
        self._arrays = [(array, *_place_of(array.data)) for array in arrays if array.data]
        self._zeros = [
            (k, step, *_place_of(step.ptr)) for k, step in enumerate(steps) if isinstance(step, wp.array)
        ]

    def __call__(self, addresses: Sequence[int]) -> None:
        """Launch on the arrays of these addresses, in the order of the places' numbers."""
        for array, number, offset in self._arrays:
            array.data = addresses[number] + offset
        replay = self._replay
        for k, step, number, offset in self._zeros:
            step.ptr = addresses[number] + offset
            if isinstance(replay, Replay):
                replay.table[3 * k + 1] = step.ptr
        replay()


def _place_of(address: int) -> tuple[int, int]:
    """Give the number of a place and an offset in it."""
    return (address >> _BITS) - 1, address & _OFFSET


def _arrays(replay: Any, steps: Sequence[Recorded]) -> list[Any]:
    """List the arrays among the arguments of launches, as kernels read them."""
    if isinstance(replay, Replay):
        launches = [
            [getattr(arguments, name) for name, _ in arguments._fields_]
            for arguments in replay.arguments[:-1]
        ]
    else:
        launches = [step.params[1:] for step in steps if isinstance(step, wp.Launch)]
    return [value for values in launches for value in values if hasattr(value, "strides")]
