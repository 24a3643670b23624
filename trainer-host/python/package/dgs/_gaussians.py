"""Names the arrays of one frame as gsplat does."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Gaussians(NamedTuple):
    """The arrays of N Gaussians at one frame, float32, under the names that gsplat gives them.

    In the domain "log", which is what files and optimisers hold, ``scales`` are natural logarithms and
    ``opacities`` are logits; in the domain "linear" they are standard deviations in scene units and numbers
    from 0 to 1. Every function that takes or gives them has the argument ``activation``, "log" by default.
    """

    means: NDArray[np.float32]
    """Centres, scene units, [N, 3]."""
    scales: NDArray[np.float32]
    """Sizes along the three axes, [N, 3]."""
    quats: NDArray[np.float32]
    """Rotations, quaternions wxyz, of any length above 0 where they are taken, [N, 4]."""
    opacities: NDArray[np.float32]
    """Opacities, [N]."""
    sh0: NDArray[np.float32]
    """Band 0 of the spherical harmonics, colour = 0.5 + 0.28209479 * sh0, [N, 1, 3]."""
    shN: NDArray[np.float32]
    """The higher bands, coefficient by coefficient, [N, K, 3] with K 0, 3, 8 or 15."""
