"""Dynamic Gaussian splats as numpy arrays: load, encode, play what arrived, render, differentiate.

>>> import dgs
>>> scene = dgs.Scene.synth("figure", gaussians=1000, frames=2)
>>> stream = dgs.encode(scene, pictures=0).stream
>>> some = stream.without(range(1, len(stream), 4))
>>> arrived = dgs.Player(some).frame(1)
>>> pictures = dgs.render(arrived, scene.ring(2, width=64, height=64))
>>> pictures.shape
(2, 64, 64, 3)
"""

# The native half panics without numpy; this import says what is missing.
import numpy as _numpy  # noqa: F401

from ._gaussians import Gaussians
from ._native import (
    Camera,
    DamagedError,
    Encoded,
    Player,
    Scene,
    Stream,
    __version__,
    convert,
    encode,
    render,
    render_backward,
)

__all__ = [
    "Camera",
    "DamagedError",
    "Encoded",
    "Gaussians",
    "Player",
    "Scene",
    "Stream",
    "__version__",
    "convert",
    "encode",
    "render",
    "render_backward",
]
