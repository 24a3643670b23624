"""What the native half of the package offers; see each docstring for shapes and units."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, Protocol, final, overload, type_check_only

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._gaussians import Gaussians

_Activation = Literal["log", "linear"]
_Footprint = Literal["dilated", "compensated", "pixel"]
_Axis = Literal["x", "y", "z", "minus-x", "minus-y", "minus-z"]
_Path = str | os.PathLike[str]
_Vector = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]
_Bytes = bytes | bytearray | memoryview

@type_check_only
class _HasArrays(Protocol):
    """An object with arrays for attributes; of ``shN`` and ``footprint`` it may have none."""

    @property
    def means(self) -> ArrayLike: ...
    @property
    def scales(self) -> ArrayLike: ...
    @property
    def quats(self) -> ArrayLike: ...
    @property
    def opacities(self) -> ArrayLike: ...
    @property
    def sh0(self) -> ArrayLike: ...

_Arrays = Gaussians | Mapping[str, Any] | _HasArrays

__all__ = [
    "Camera",
    "DamagedError",
    "Encoded",
    "Player",
    "Scene",
    "Stream",
    "__version__",
    "convert",
    "encode",
    "render",
    "render_backward",
]

__version__: str

class DamagedError(ValueError):
    """Bytes that are not what they should be: a damaged or truncated file, stream or packet."""

@final
class Camera:
    """A pinhole camera with OpenCV axes: x right, y down, z forward."""

    def __new__(
        cls, viewmat: ArrayLike, K: ArrayLike, width: int, height: int, near: float = 0.01
    ) -> Camera:
        """A camera of a world-to-camera matrix [4, 4] and intrinsics [3, 3] in pixels, as gsplat takes them.

        The first pixel has its centre at (0.5, 0.5). What is nearer than ``near`` (scene units) is not drawn.
        """
    @staticmethod
    def many(
        viewmats: ArrayLike, Ks: ArrayLike, width: int, height: int, near: float = 0.01
    ) -> list[Camera]:
        """Cameras of viewmats [C, 4, 4] and Ks [C, 3, 3]."""
    @staticmethod
    def look_at(
        eye: _Vector,
        target: _Vector,
        up: _Vector,
        fov_y: float,
        width: int,
        height: int,
        near: float = 0.01,
    ) -> Camera:
        """A camera at ``eye`` that looks at ``target``, ``fov_y`` degrees high, 0.0001 to 179.9999, ``up`` upwards in the picture."""
    @property
    def viewmat(self) -> NDArray[np.float64]:
        """World to camera, [4, 4]."""
    @property
    def K(self) -> NDArray[np.float64]:
        """Intrinsics in pixels, [3, 3]."""
    @property
    def width(self) -> int:
        """Width of the picture, pixels."""
    @property
    def height(self) -> int:
        """Height of the picture, pixels."""
    @property
    def near(self) -> float:
        """What is nearer than this is not drawn, scene units."""
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...

@final
class Scene:
    """Gaussians over frames, with cameras where the source has some.

    It does not change, so that its copies are itself. It is not pickled: pickle its arrays, ``scene.at(frame)``.
    """

    @staticmethod
    def load(
        path: _Path,
        *,
        fps: float | None = None,
        samples: int = 20000,
        clip: int | str | None = None,
        seed: int = 1,
        identity_stored: bool = False,
        keep_readable: bool = False,
        max_gaussians: int = 5000000,
        up: _Axis | None = None,
    ) -> Scene:
        """Reads the files and folders that ``dgs import`` reads, or a .dgs file; content decides before the ending.

        Checkpoints of trainings (.dgst) are refused: ``dgs convert`` makes scenes of them that are read.

        ``fps`` is for sources that do not say, by default 30. ``samples``, ``clip`` (name or number from 0, by default
        the first) and ``seed`` are for animated meshes.
        ``identity_stored``: rows of a numbered sequence are the same Gaussians at every frame.
        ``keep_readable`` keeps the readable part of a damaged source; of a .dgs file it is kept anyway, with a
        UserWarning. ``up`` is which axis points up, by default what the
        file says (.dgs, .4dgs), else the usual one of the format.

        Raises FileNotFoundError, DamagedError for what is damaged, ValueError for what is refused.
        """
    @overload
    @staticmethod
    def from_arrays(
        means: _Arrays,
        scales: None = None,
        quats: None = None,
        opacities: None = None,
        sh0: None = None,
        shN: None = None,
        *,
        fps: float = 30.0,
        activation: _Activation = "log",
        up: _Axis = "minus-y",
        footprint: _Footprint | None = None,
    ) -> Scene: ...
    @overload
    @staticmethod
    def from_arrays(
        means: ArrayLike,
        scales: ArrayLike,
        quats: ArrayLike,
        opacities: ArrayLike,
        sh0: ArrayLike,
        shN: ArrayLike | None = None,
        *,
        fps: float = 30.0,
        activation: _Activation = "log",
        up: _Axis = "minus-y",
        footprint: _Footprint | None = None,
    ) -> Scene:
        """A scene of arrays under gsplat's names: each [N, ...] for all frames or [T, N, ...].

        Instead of the first array all of them may be given as one :class:`Gaussians`, an object or a mapping.

        means [.., N, 3], scales [.., N, 3], quats wxyz [.., N, 4], opacities [.., N], sh0 [.., N, 3] or
        [.., N, 1, 3], shN [N, K, 3] with K 0, 3, 8 or 15. Values are copied, whatever the strides;
        floating-point numbers of other widths are converted to float32, other types are refused.
        Quaternions are normalised, logarithms of scales are clamped to -20..10, logits to -12..12.
        ``footprint`` is how the Gaussians were drawn when they were fitted, by default that of the
        :class:`Gaussians`, of other arrays "dilated"; gsplat's "antialiased" mode is "compensated".
        """
    @staticmethod
    def synth(kind: str = "figure", *, gaussians: int = 2000, frames: int = 8, seed: int = 1) -> Scene:
        """A scene of formulas, "balls", "figure", "cloth" or "births", of 1000 Gaussians or more."""
    def __copy__(self) -> Scene: ...
    def __deepcopy__(self, _memo: object, /) -> Scene: ...
    def at(self, frame: int, *, activation: _Activation = "log") -> Gaussians:
        """The arrays of a frame, 0 to frames - 1."""
    def save(self, path: _Path, *, frame: int = 0, keep_axes: bool = False) -> None:
        """Writes the scene as the ending says.

        .ply, .compressed.ply, .spz, .splat, .sog, .glb and .gltf hold the one ``frame`` (.gltf with a .bin of the
        same name beside it, which must not be there yet), a folder without an ending every frame as a PLY and a
        sequence.json with their rate, .4dgs every frame, .dgs every frame as :func:`encode` writes it by default.
        The scene is turned to the axes that are usual in the format unless ``keep_axes``; .dgs keeps them, and
        says which is up. A file needs a Gaussian, a frame of a folder does not.

        A UserWarning says what the format leaves out: harmonics (.splat), the footprint (.dgs alone holds each;
        .spz and .sog "dilated" and "compensated", all others "dilated"). Cameras are in none of them, and values
        beyond what a format holds are clamped.
        """
    def __len__(self) -> int: ...
    @property
    def footprint(self) -> _Footprint:
        """How its Gaussians are drawn."""
    @property
    def frames(self) -> int:
        """Number of frames, also ``len(scene)``."""
    @property
    def gaussians(self) -> int:
        """Gaussians of the frame that has most."""
    @property
    def fps(self) -> float:
        """Frames per second."""
    @property
    def up(self) -> str:
        """Which axis points up."""
    @property
    def notes(self) -> list[str]:
        """What a person should know of the source."""
    @property
    def cameras(self) -> list[Camera]:
        """Cameras that the source came with."""
    @property
    def bounds(self) -> NDArray[np.float32]:
        """The least and the greatest corner of all centres at all frames, scene units, [2, 3]."""
    def ring(self, count: int, width: int, height: int, *, held_out: bool = True) -> list[Camera]:
        """1 to 100000 cameras around the scene: held out, or those that the encoder measures from."""

@final
class Encoded:
    """An encoded scene."""

    @property
    def stream(self) -> Stream:
        """The manifest and the packets."""
    @property
    def report(self) -> dict[str, Any]:
        """What was chosen and where every byte went, as ``dgs encode --json`` says it."""
    def to_bytes(self) -> bytes:
        """The bytes of a .dgs file, also ``bytes(encoded)``."""
    def save(self, path: _Path) -> None:
        """Writes a .dgs file."""
    def __bytes__(self) -> bytes: ...

@final
class Stream:
    """The bytes of a stream: a manifest and packets, each of which decodes alone given the manifest."""

    def __new__(cls, source: _Bytes | _Path) -> Stream:
        """Bytes of a .dgs file, or its path. Raises DamagedError if the manifest is unreadable."""
    @property
    def manifest(self) -> bytes:
        """The message that makes every packet readable."""
    @property
    def packets(self) -> list[bytes]:
        """The packets, by id; one that is missing is empty."""
    @property
    def damage(self) -> str | None:
        """What is amiss with the bytes, if something is."""
    @property
    def info(self) -> dict[str, Any]:
        """frames, fps, packets, gaussians, sh_degree, footprint, up (``"y"``, ``"minus-z"`` and so on)."""
    @property
    def wire_bytes(self) -> int:
        """Bytes of the manifest and all packets."""
    def without(self, packets: Iterable[int]) -> Stream:
        """The same stream without the packets of these ids."""
    def to_bytes(self) -> bytes:
        """The bytes of a .dgs file, also ``bytes(stream)``."""
    def save(self, path: _Path) -> None:
        """Writes a .dgs file."""
    def __bytes__(self) -> bytes: ...
    def __len__(self) -> int: ...

@final
class Player:
    """What has arrived of a stream, decoded frame by frame. May be used from several threads."""

    def __new__(cls, source: Stream | _Bytes | _Path) -> Player:
        """A player all of whose packets have arrived. Raises DamagedError if the manifest is unreadable."""
    @staticmethod
    def from_manifest(manifest: _Bytes) -> Player:
        """A player of the stream of this manifest, none of whose packets have arrived."""
    def push(self, packet: _Bytes) -> list[int]:
        """Takes one packet, in any order; gives the ids of the packets that are known by it.

        More than one where parity repaired others, none if it has come before. Raises DamagedError if it is
        refused; the player is then as it was.
        """
    def push_all(self, packets: Sequence[_Bytes]) -> None:
        """Takes many packets, faster; those that are refused are counted, empty ones passed over."""
    def frame(self, frame: int, *, activation: _Activation = "log") -> Gaussians:
        """The arrays of a frame, 0 to frames - 1, as far as it has arrived.

        Rows are the same Gaussians whatever has arrived. Of a block of which nothing has, a coarse stand-in from
        the manifest is there and the other rows have opacity 0 (in "log" the logit -12): see :meth:`drawn`.
        """
    def drawn(self, frame: int) -> NDArray[np.bool_]:
        """Which Gaussians of a frame are drawn, [N]: what has arrived, and stand-ins for what has not."""
    def usable(self, frame: int) -> dict[str, Any]:
        """How many blocks of a frame there are, and can be shown by level: blocks, canonical, motion."""
    @property
    def info(self) -> dict[str, Any]:
        """frames, fps, packets, gaussians, sh_degree, footprint, up (``"y"``, ``"minus-z"`` and so on)."""
    @property
    def counters(self) -> dict[str, Any]:
        """Packets so far: media, parity, early (before the manifest), recovered, repair_failed (recovered, but not
        what was sent), refused (by kind)."""
    @property
    def damage(self) -> str | None:
        """What was amiss with the bytes, if something was."""

def encode(
    scene: Scene,
    *,
    profile: Literal["dgs1", "paper", "paper-context"] = "dgs1",
    coarseness: float = 1.0,
    target_bits_per_gaussian: float | None = None,
    target_bytes: int | None = None,
    target_psnr: float | None = None,
    pictures: int = 16,
    search: int = 0,
    cluster_size: int = 512,
    block_len: int = 64,
    window_frames: int | None = None,
    rank: int | None = None,
    packet_bytes: int = 1150,
    repair: str = "none",
    progress: Callable[[str, float], object] | None = None,
) -> Encoded:
    """Encodes a scene, with the options of ``dgs encode`` under their names there.

    Targets, of which one may be given: bits on the wire per Gaussian, bytes on the wire, or PSNR in dB from
    validation cameras, pictures weighed by the share that the scene covers; the coarseness is then chosen.
    ``repair``: parity, "none", "standard", "strong", "full" or a list of KIND=K+R. ``progress`` hears the stage,
    or which encoding of a search for a target it is, and the share of the whole that is done, 0 to 1, which
    never falls; an exception that it raises, and Ctrl-C, end the encoding there. Equal scenes and options give
    equal bytes.
    """

def render(
    gaussians: Scene | _Arrays,
    cameras: Camera | Iterable[Camera],
    *,
    frame: int = 0,
    activation: _Activation = "log",
    background: _Vector | None = None,
    alpha: bool = False,
    footprint: _Footprint | None = None,
    sh_degree: int = 3,
    alpha_cutoff: float | None = None,
) -> NDArray[np.float32]:
    """Renders Gaussians from every camera on the processor: [C, H, W, 3], red, green and blue of 0 to 1.

    ``gaussians`` are arrays in the domain ``activation``, or a scene, of which ``frame`` is drawn. Colours are
    those of a screen, over ``background``, black by default. With ``alpha`` a fourth channel is 1 minus the share of the
    background that shows. ``footprint`` is how Gaussians are widened, by default that of the scene or the
    :class:`Gaussians`, of other arrays "dilated": by 0.3 pixels²; "compensated" by as much and dimmed for it; "pixel" by 0.1 and dimmed (Mip-Splatting).
    Bands above ``sh_degree`` are left out. A Gaussian adds nothing to a pixel where its alpha is below ``alpha_cutoff``, 0 to
    0.5, 1/255 by default. The same input gives the same bits on any number of threads.
    """

def render_backward(
    gaussians: _Arrays,
    cameras: Camera | Iterable[Camera],
    grad_images: ArrayLike,
    *,
    activation: _Activation = "log",
    background: _Vector | None = None,
    footprint: _Footprint | None = None,
    sh_degree: int = 3,
    alpha_cutoff: float | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Gradients of a number with respect to every array, given its gradient of what :func:`render` gives.

    ``grad_images`` is [C, H, W, 3], or [C, H, W, 4] with that of alpha. The result has means, scales, quats,
    opacities, sh0 and shN, each in the shape that came in and in the domain ``activation``, summed over
    cameras, and background [3]. Options are those of :func:`render`. Where a value is clamped (a colour at 0,
    alpha at 0.99) and across the jumps of the picture (at ``alpha_cutoff``) the gradient is 0. In "linear"
    gradients are taken with opacities in 1e-6 to 1 - 1e-6 and scales of at least 1e-6, so that at the ends of
    their range they are the one-sided ones.
    """

def convert(
    source: _Path,
    target: _Path,
    *,
    fps: float | None = None,
    frame: int = 0,
    keep_axes: bool = False,
    up: _Axis | None = None,
) -> None:
    """Reads a scene and writes it as the ending of ``target`` says: ``Scene.load(source).save(target)``.

    It warns of what both warn of.
    """
