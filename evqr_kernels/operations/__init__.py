"""The table of operations, in the groups of `evqr_kernels.ops`."""

from evqr_kernels.operation import Operation
from evqr_kernels.operations import codes, events, grids, images, render

OPERATIONS: dict[str, Operation] = {
    operation.name: operation
    for group in (events, grids, images, codes, render)
    for operation in group.OPERATIONS
}
"""Every operation by its name."""
