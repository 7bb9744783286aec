#!/usr/bin/env python3
"""Find the motion of a code by contrast maximisation, with JAX.

usage: contrast_jax.py RECORDING.h5

As contrast_torch.py; `evqr_kernels.jax.splat_events` works within `jax.jit` and `jax.grad`, the optimiser is
that of `jax.scipy`.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.optimize import minimize
from recording import report, window_of_arguments

import evqr_kernels.jax
from evqr_kernels import SplatConfig

COARSE_TO_FINE_PX = (4.0, 2.0, 1.0)


def main() -> int:
    """Maximise the contrast."""
    window = window_of_arguments("Contrast maximisation with JAX.")
    x, y, t, weight, window_ptr = map(jnp.asarray, (*window[:4], window.window_ptr))
    travel = jnp.zeros(2, jnp.float32)  # [px] over the window: of the size of one

    for epsilon_px in COARSE_TO_FINE_PX:
        cfg = SplatConfig(epsilon_px=epsilon_px)

        def contrast(travel: jax.Array, cfg: SplatConfig = cfg) -> jax.Array:
            motion = travel[None] / window.seconds
            image = evqr_kernels.jax.splat_events(
                x, y, t, weight, window_ptr, motion, shape=window.shape, cfg=cfg
            )
            return image.var()

        scale = -1.0 / contrast(travel)
        step = jax.jit(lambda travel, scale=scale, contrast=contrast: scale * contrast(travel))
        travel = minimize(step, travel, method="BFGS", options={"maxiter": 30}).x
    return report(np.asarray(travel) / window.seconds, window)


if __name__ == "__main__":
    sys.exit(main())
