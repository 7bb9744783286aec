"""Code spaces that are no square: nobody prints them, but rMQR and Data Matrix have such."""

import numpy as np

from evqr.symbol.space import CodeSpace, Symbology


def rectangle(rows, columns, seed):
    """A space whose edges and a few modules inside are known, with two modules of quiet zone."""
    rng = np.random.default_rng(seed)
    known = rng.random((rows, columns)) < 0.15
    known[[0, -1]] = known[:, [0, -1]] = True
    known[1:5, 1:5] = True
    values = np.where(known, rng.choice((-1, 1), (rows, columns)), 0).astype(np.int8)
    return CodeSpace(
        symbology=Symbology.RMQR_CODE, version=f"{rows}x{columns}", known=known, values=values, anchors=(),
        quiet_zone=2,
    )  # fmt: skip


WIDE, TALL = rectangle(9, 27, 1), rectangle(22, 12, 2)
