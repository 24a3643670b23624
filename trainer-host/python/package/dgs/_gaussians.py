"""Names the arrays of one frame as gsplat does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray


if TYPE_CHECKING:
    from typing_extensions import disjoint_base

    _Footprint = Literal["dilated", "compensated", "pixel"]
else:

    def disjoint_base(cls):
        return cls


_G = TypeVar("_G", bound="Gaussians")


class _Arrays(NamedTuple):
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


@disjoint_base
class Gaussians(_Arrays):
    """The arrays of N Gaussians at one frame, float32, under the names that gsplat gives them.

    In the domain "log", which is what files and optimisers hold, ``scales`` are natural logarithms and
    ``opacities`` are logits; in the domain "linear" they are standard deviations in scene units and numbers
    from 0 to 1. Every function that takes or gives them has the argument ``activation``, "log" by default.
    """

    footprint: _Footprint = "dilated"
    """How they are widened where they are drawn, as the scene or stream says that they come from. It is no member
    of the tuple: ``dgs.Gaussians(*arrays, footprint=arrays.footprint)`` passes it on."""

    def __new__(
        cls: type[_G],
        means: NDArray[np.float32],
        scales: NDArray[np.float32],
        quats: NDArray[np.float32],
        opacities: NDArray[np.float32],
        sh0: NDArray[np.float32],
        shN: NDArray[np.float32],
        *,
        footprint: _Footprint = "dilated",
    ) -> _G:
        made = super().__new__(cls, means, scales, quats, opacities, sh0, shN)
        made.footprint = footprint
        return made

    def _asdict(self) -> dict[str, Any]:
        return {**super()._asdict(), "footprint": self.footprint}

    def _replace(self: _G, **changes: Any) -> _G:
        footprint = changes.pop("footprint", self.footprint)
        replaced = super()._replace(**changes)
        replaced.footprint = footprint
        return replaced

    __replace__ = _replace
