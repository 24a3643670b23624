"""Scenes of arrays and files: what comes back, and what is refused in which words."""

import base64
import copy
import errno
import importlib.metadata
import json
import pathlib
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dgs


def test_the_version_is_that_of_the_package() -> None:
    assert dgs.__version__ == importlib.metadata.version("dgs-splats")


def arrays(count: int = 50, frames: int = 3) -> dict[str, Any]:
    """Arrays of `count` Gaussians, means over `frames`."""
    rng = np.random.default_rng(1)
    return {
        "means": rng.normal(size=(frames, count, 3)).astype(np.float32),
        "scales": rng.uniform(-5, -2, size=(count, 3)).astype(np.float32),
        "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        "opacities": rng.uniform(-3, 3, size=count).astype(np.float32),
        "sh0": rng.normal(size=(count, 1, 3)).astype(np.float32),
        "shN": rng.normal(size=(count, 8, 3)).astype(np.float32),
    }


def test_arrays_come_back_as_they_went_in() -> None:
    given = arrays()
    scene = dgs.Scene.from_arrays(**given, fps=24.0)
    assert (len(scene), scene.frames, scene.gaussians, scene.fps, scene.up) == (3, 3, 50, 24.0, "minus-y")
    for frame in range(3):
        back = scene.at(frame)
        assert np.array_equal(back.means, given["means"][frame])
        for name in ("scales", "quats", "opacities", "sh0", "shN"):
            assert np.array_equal(getattr(back, name), given[name]), name
            assert getattr(back, name).dtype == np.float32
    flat = given["means"].reshape(-1, 3)
    assert np.array_equal(scene.bounds, np.stack([flat.min(0), flat.max(0)]))


def test_linear_is_the_exponential_of_log() -> None:
    scene = dgs.Scene.from_arrays(**arrays())
    log, linear = scene.at(0), scene.at(0, activation="linear")
    assert np.allclose(linear.scales, np.exp(log.scales), rtol=1e-6)
    assert np.allclose(linear.opacities, 1 / (1 + np.exp(-log.opacities)), rtol=1e-6)
    again = dgs.Scene.from_arrays(linear, activation="linear").at(0)
    assert np.allclose(again.scales, log.scales, atol=1e-5)
    assert np.allclose(again.opacities, log.opacities, atol=1e-5)


def test_strides_and_widths_do_not_matter() -> None:
    given = arrays()
    plain = dgs.Scene.from_arrays(**given)
    wide = np.asfortranarray(given["means"].astype(np.float64))
    strided = np.repeat(given["scales"], 2, axis=0)[::2]
    assert not wide.flags.c_contiguous and not strided.flags.c_contiguous
    given.update(means=wide, scales=strided, sh0=given["sh0"][:, 0].tolist())
    other = dgs.Scene.from_arrays(**given)
    for name in dgs.Gaussians._fields:
        assert np.array_equal(getattr(plain.at(1), name), getattr(other.at(1), name)), name
    # The comparison notices a difference.
    given["means"] = wide[:, ::-1]
    assert not np.array_equal(plain.at(1).means, dgs.Scene.from_arrays(**given).at(1).means)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("means", np.zeros((50, 2), np.float32), ["means", "[50, 2]", "[N, 3]"]),
        ("scales", np.zeros((49, 3), np.float32), ["scales", "[49, 3]", "[50, 3]"]),
        ("scales", np.zeros((4, 50, 3), np.float32), ["scales", "[4, 50, 3]", "means"]),
        ("quats", np.ones((50, 4), np.int64), ["quats", "int64", "float32"]),
        ("quats", np.ones((50, 4), ">i2"), ["quats", "i2", "float32"]),
        ("opacities", np.full(50, np.nan), ["opacities", "nan", "[0]"]),
        ("sh0", np.zeros((50, 2, 3)), ["sh0", "[50, 2, 3]"]),
        ("shN", np.zeros((50, 4, 3)), ["shN", "[50, 4, 3]", "15"]),
        ("means", np.float32("inf") * np.ones((50, 3)), ["means", "inf", "finite"]),
    ],
)
def test_what_is_wrong_is_named(name: str, value: Any, words: list[str]) -> None:
    given = arrays() | {name: value}
    with pytest.raises(ValueError) as caught:
        dgs.Scene.from_arrays(**given)
    assert all(word in str(caught.value) for word in words), caught.value


def test_other_mistakes_are_named_too() -> None:
    scene = dgs.Scene.from_arrays(**arrays())
    with pytest.raises(IndexError, match="frame is 3; 0 to 2 are allowed"):
        scene.at(3)
    with pytest.raises(IndexError, match="frame is -1"):
        scene.at(-1)
    with pytest.raises(ValueError, match="activation"):
        scene.at(0, activation="square")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="opacities of 0 to 1"):
        dgs.Scene.from_arrays(**arrays() | {"scales": np.ones((50, 3))}, activation="linear")
    with pytest.raises(ValueError, match="up is"):
        dgs.Scene.from_arrays(**arrays(), up="sideways")  # type: ignore[call-overload]
    with pytest.raises(ValueError, match="frame rate"):
        dgs.Scene.from_arrays(**arrays(), fps=0.0)
    with pytest.raises(ValueError, match="kind"):
        dgs.Scene.synth("teapot")
    with pytest.raises(ValueError, match="has no quats"):
        dgs.Scene.from_arrays(arrays()["means"], arrays()["scales"])
    with pytest.raises(ValueError, match="has no means"):
        dgs.Scene.from_arrays(arrays()["means"])


def test_mistakes_of_a_caller_are_no_damage(tmp_path: pathlib.Path) -> None:
    scene = dgs.Scene.from_arrays(**arrays(frames=1))
    scene.save(tmp_path / "a.ply")
    mistakes: list[tuple[str, Callable[[], object]]] = [
        ("1000 to 1000000", lambda: dgs.Scene.synth(gaussians=0)),
        ("gaussians is -1", lambda: dgs.Scene.synth(gaussians=-1)),
        ("seed is -1", lambda: dgs.Scene.synth(gaussians=1000, seed=-1)),
        ("fps is 0", lambda: dgs.Scene.load(tmp_path / "a.ply", fps=0)),
        ("fps is NaN", lambda: dgs.convert(tmp_path / "a.ply", tmp_path / "b.ply", fps=float("nan"))),
        ("max_gaussians is -1", lambda: dgs.Scene.load(tmp_path / "a.ply", max_gaussians=-1)),
        ("count is 1099511627776; 1 to 100000", lambda: scene.ring(2**40, 8, 8)),
        ("count is 0", lambda: scene.ring(0, 8, 8)),
        ("width is -8", lambda: scene.ring(1, -8, 8)),
    ]
    for words, mistake in mistakes:
        with pytest.raises(ValueError, match=words) as caught:
            mistake()
        assert not isinstance(caught.value, dgs.DamagedError), words


def test_scenes_are_copied_and_not_pickled() -> None:
    scene = dgs.Scene.from_arrays(**arrays())
    assert copy.copy(scene) is scene and copy.deepcopy([scene])[0] is scene
    with pytest.raises(TypeError, match=r"pickle its arrays, scene.at\(frame\)"):
        pickle.dumps(scene)
    # As that says, nothing of how they are drawn is lost.
    pixel = dgs.Scene.from_arrays(**arrays(), footprint="pixel")
    back = pickle.loads(pickle.dumps(pixel.at(2)))
    assert back.footprint == "pixel" and np.array_equal(back.means, pixel.at(2).means)


# Unit vectors of what ``Scene.up`` may be.
AXES: dict[str, Any] = {
    sign + name: factor * axis
    for sign, factor in (("", 1.0), ("minus-", -1.0))
    for name, axis in zip("xyz", np.eye(3), strict=True)
}


def height(scene: dgs.Scene) -> float:
    """Of the middle of the scene's centres, upwards."""
    return float(scene.bounds.mean(axis=0) @ AXES[scene.up])


@pytest.mark.parametrize("ending", ["ply", "compressed.ply", "spz", "splat", "sog", "glb", "4dgs", "dgs"])
@pytest.mark.parametrize("up", ["minus-y", "y", "z"])
def test_files_come_back(tmp_path: pathlib.Path, ending: str, up: Any) -> None:
    given = arrays(frames=1)
    # Away from the middle, so that a scene on its head is noticed.
    given["means"] += 10 * AXES[up].astype(np.float32)
    scene = dgs.Scene.from_arrays(**given, up=up)
    path = tmp_path / f"scene.{ending}"
    if ending == "splat":
        with pytest.warns(UserWarning, match="harmonics above band 0 are left out"):
            scene.save(path)
    else:
        scene.save(path)
    back = dgs.Scene.load(path)
    assert back.gaussians == 50 and len(back) == 1
    # Some formats turn the scene, all may change the order: what is the same is how high it lies and the span.
    assert height(back) == pytest.approx(height(scene), rel=2e-3) and height(back) > 9
    span = np.sort(scene.bounds[1] - scene.bounds[0])
    assert np.allclose(np.sort(back.bounds[1] - back.bounds[0]), span, rtol=2e-3)
    if ending == "dgs":
        assert back.up == up and dgs.Stream(path).info["up"] == up
        assert dgs.Scene.load(path, up="x").up == "x"
    if ending == "4dgs":
        assert back.up == "y"
        scene.save(path, keep_axes=True)
        assert np.allclose(dgs.Scene.load(path, up=up).bounds, scene.bounds, atol=0.02)


def test_a_folder_holds_every_frame_and_is_not_written_over(tmp_path: pathlib.Path) -> None:
    scene = dgs.Scene.from_arrays(**arrays(), fps=12.0)
    scene.save(tmp_path / "frames")
    back = dgs.Scene.load(tmp_path / "frames")
    # Rate and identity are in its index: each Gaussian lives through all frames.
    assert (len(back), back.fps, back.gaussians) == (3, 12.0, 50)
    assert not any("identity" in note for note in back.notes)
    assert np.array_equal(back.at(2).means, scene.at(2).means)
    with pytest.raises(ValueError, match="not empty"):
        scene.save(tmp_path / "frames")


@pytest.mark.parametrize(
    ("name", "footprint", "drawn"),
    [
        ("a.4dgs", "pixel", "dilated"),
        ("frames", "compensated", "dilated"),
        ("a.ply", "compensated", "dilated"),
        ("a.compressed.ply", "pixel", "dilated"),
        ("a.glb", "pixel", "dilated"),
        ("a.spz", "pixel", "compensated"),
        ("a.sog", "pixel", "compensated"),
        ("a.spz", "compensated", "compensated"),
        ("a.dgs", "pixel", "pixel"),
        ("a.dgs", "compensated", "compensated"),
        ("a.4dgs", "dilated", "dilated"),
    ],
)
def test_a_footprint_that_a_format_cannot_say_is_warned_of(
    tmp_path: pathlib.Path, name: str, footprint: Any, drawn: str
) -> None:
    scene = dgs.Scene.from_arrays(**arrays(), footprint=footprint)
    path = tmp_path / name
    if footprint == drawn:
        # A warning would be an error.
        scene.save(path)
    else:
        said = f"{name}: the format cannot say footprint {footprint}: viewers will draw as {drawn}"
        with pytest.warns(UserWarning, match=said):
            scene.save(path)
    assert dgs.Scene.load(path).footprint == drawn


def test_each_loss_is_warned_of_and_by_convert_too(tmp_path: pathlib.Path) -> None:
    losses = ["harmonics above band 0 are left out", "cannot say footprint pixel: viewers will draw as dilated"]
    scene = dgs.Scene.from_arrays(**arrays(), footprint="pixel")
    scene.save(tmp_path / "a.dgs")
    ways: list[Callable[[], object]] = [
        lambda: scene.save(tmp_path / "a.splat"),
        lambda: dgs.convert(tmp_path / "a.dgs", tmp_path / "b.splat"),
    ]
    for way in ways:
        with pytest.warns(UserWarning) as heard:
            way()
        said = [str(warning.message) for warning in heard]
        assert len(said) == 2 and all(loss in found for loss, found in zip(losses, said, strict=True)), said
        # It names the line that saves.
        assert {pathlib.Path(warning.filename).name for warning in heard} == {"test_scene.py"}
    # Without harmonics, none are left out.
    plain = dgs.Scene.from_arrays(**arrays() | {"shN": None})
    plain.save(tmp_path / "c.splat")


def moving_triangle(path: pathlib.Path) -> None:
    """Writes a mesh with two clips, "rise" and one without a name."""
    values = {
        "corners": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32),
        "times": np.array([0, 1], np.float32),
        "rise": np.array([[0, 0, 0], [0, 2, 0]], np.float32),
        "slide": np.array([[0, 0, 0], [3, 0, 0]], np.float32),
    }
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    data = b""
    for number, array in enumerate(values.values()):
        is_scalar = array.ndim == 1
        bounds = {"min": array.min(axis=0).reshape(-1).tolist(), "max": array.max(axis=0).reshape(-1).tolist()}
        kind = {"componentType": 5126, "count": len(array), "type": "SCALAR" if is_scalar else "VEC3"}
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": number, **kind, **bounds})
        data += array.tobytes()
    clips: list[dict[str, Any]] = [
        {
            "samplers": [{"input": 1, "output": output}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
        }
        for output in (2, 3)
    ]
    clips[0]["name"] = "rise"
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"uri": uri, "byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
        "animations": clips,
    }
    path.write_text(json.dumps(document))


def test_clips_are_chosen_by_name_and_number(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "triangle.gltf"
    moving_triangle(path)
    wanted: list[tuple[int | str | None, int]] = [(None, 3), (0, 3), ("0", 3), ("rise", 3), (1, 1), ("1", 1)]
    for clip, highest in wanted:
        scene = dgs.Scene.load(path, clip=clip, samples=1000)
        assert highest - 0.2 < scene.bounds[1, 1] <= highest, clip
    mistakes: list[Any] = ["fall", 2, -1]
    for clip in mistakes:
        with pytest.raises(ValueError, match="clip") as caught:
            dgs.Scene.load(path, clip=clip)
        assert not isinstance(caught.value, dgs.DamagedError), clip
    with pytest.raises(ValueError, match="samples is 0"):
        dgs.Scene.load(path, samples=0)


def test_convert_is_load_and_save(tmp_path: pathlib.Path) -> None:
    dgs.Scene.from_arrays(**arrays()).save(tmp_path / "a.ply", frame=2)
    dgs.convert(tmp_path / "a.ply", tmp_path / "b.spz")
    assert dgs.Scene.load(tmp_path / "b.spz").gaussians == 50


def test_files_that_are_not_there_or_not_whole(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere.ply") as caught:
        dgs.Scene.load(tmp_path / "nowhere.ply")
    assert caught.value.errno == errno.ENOENT
    assert pathlib.Path(caught.value.filename) == tmp_path / "nowhere.ply"
    with pytest.raises(FileNotFoundError) as caught:
        dgs.Stream(tmp_path / "nowhere.dgs")
    assert caught.value.errno == errno.ENOENT and "os error" not in str(caught.value)
    (tmp_path / "short.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    with pytest.raises(dgs.DamagedError, match="short.ply"):
        dgs.Scene.load(tmp_path / "short.ply")
    with pytest.raises(ValueError, match=r"\.obj|obj"):
        dgs.Scene.from_arrays(**arrays()).save(tmp_path / "a.obj")
    with pytest.raises(FileNotFoundError):
        dgs.Scene.from_arrays(**arrays()).save(tmp_path / "no" / "a.ply")


def test_a_checkpoint_of_a_training_is_refused_with_what_reads_it(tmp_path: pathlib.Path) -> None:
    for name in ("checkpoint.dgst", "renamed.dgs"):
        path = tmp_path / name
        path.write_bytes(b"DGSTRAIN" + bytes(100))
        mistakes: list[Callable[[], object]] = [
            lambda: dgs.Scene.load(path),
            lambda: dgs.convert(path, tmp_path / "a.ply"),
        ]
        for mistake in mistakes:
            with pytest.raises(ValueError, match=f"{name}: is a checkpoint of a training; dgs convert") as caught:
                mistake()
            assert not isinstance(caught.value, dgs.DamagedError)
    assert not (tmp_path / "a.ply").exists()
    # No more than its first bytes is damage.
    (tmp_path / "short.dgst").write_bytes(b"DGSTRA")
    with pytest.raises(dgs.DamagedError):
        dgs.Scene.load(tmp_path / "short.dgst")


def test_content_decides_before_the_ending(tmp_path: pathlib.Path) -> None:
    scene = dgs.Scene.from_arrays(**arrays(frames=1))
    scene.save(tmp_path / "a.dgs")
    scene.save(tmp_path / "a.ply")
    (tmp_path / "a.dgs").rename(tmp_path / "stream.ply")
    (tmp_path / "a.ply").rename(tmp_path / "points.dgs")
    assert dgs.Scene.load(tmp_path / "stream.ply").gaussians == 50
    assert np.array_equal(np.sort(dgs.Scene.load(tmp_path / "points.dgs").bounds), np.sort(scene.bounds))
    for junk in (b"", b"DGS", bytes(100)):
        (tmp_path / "junk.dgs").write_bytes(junk)
        with pytest.raises(dgs.DamagedError):
            dgs.Scene.load(tmp_path / "junk.dgs")


def test_a_damaged_stream_is_used_with_a_warning(tmp_path: pathlib.Path) -> None:
    encoded = dgs.encode(dgs.Scene.synth(gaussians=1000, frames=2), pictures=0)
    data = bytearray(bytes(encoded))
    data[len(data) // 2] ^= 255
    (tmp_path / "a.dgs").write_bytes(data)
    with pytest.warns(UserWarning, match="damaged"):
        scene = dgs.Scene.load(tmp_path / "a.dgs")
    assert len(scene) == 2


def test_what_has_not_arrived_of_a_stream_is_said(tmp_path: pathlib.Path) -> None:
    stream = dgs.encode(dgs.Scene.synth(gaussians=2000, frames=2), pictures=0, packet_bytes=400).stream
    count = len(stream)
    stream.save(tmp_path / "whole.dgs")
    assert not any("packets" in note for note in dgs.Scene.load(tmp_path / "whole.dgs").notes)
    stream.without([count - 1]).save(tmp_path / "part.dgs")
    with pytest.warns(UserWarning, match=f"1 of {count} packets are not in .*part.dgs"):
        scene = dgs.Scene.load(tmp_path / "part.dgs")
    assert scene.notes[0].startswith(f"1 of {count} packets are not in")
    # Of every two packets one, of bases too.
    lost = range(1, count, 2)
    stream.without(lost).save(tmp_path / "half.dgs")
    said = "Gaussians of which nothing has arrived are left out of "
    with pytest.warns(UserWarning, match=said):
        scene = dgs.Scene.load(tmp_path / "half.dgs")
    assert 0 < scene.gaussians < 2000
    assert [note.split(" ")[0] for note in scene.notes] == [str(len(lost)), "Gaussians"]
    with pytest.warns(UserWarning, match=said):
        dgs.convert(tmp_path / "half.dgs", tmp_path / "half.ply")
