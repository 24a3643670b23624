"""Pictures and their gradients; the gradients against differences of pictures."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dgs

HEIGHT, WIDTH = 40, 48
ALLOWED = 0.002
"""Distance of a gradient along a direction from differences, relative to the gradient."""


def cameras() -> list[dgs.Camera]:
    """Two cameras that look at the origin."""
    up = [0.0, -1.0, 0.0]
    places = ([0.0, 0.0, -4.0], [2.0, 0.5, -3.0])
    return [dgs.Camera.look_at(eye, [0.0, 0.0, 0.0], up, 40.0, WIDTH, HEIGHT) for eye in places]


def gaussians(activation: str) -> dgs.Gaussians:
    """Wide Gaussians at different depths, whose pictures are smooth, with a first band."""
    rng = np.random.default_rng(3)
    count = 6
    scales = rng.uniform(-1.2, -0.5, size=(count, 3))
    logits = rng.uniform(-1.0, 1.0, size=count)
    if activation == "linear":
        scales, logits = np.exp(scales), 1.0 / (1.0 + np.exp(-logits))
    means = rng.uniform(-0.5, 0.5, size=(count, 3))
    means[:, 2] = np.linspace(-0.5, 0.5, count)
    values = (
        means,
        scales,
        rng.normal(size=(count, 4)),
        logits,
        rng.uniform(0.2, 1.0, size=(count, 1, 3)),
        rng.uniform(-0.1, 0.1, size=(count, 3, 3)),
    )
    return dgs.Gaussians(*(value.astype(np.float32) for value in values))


def test_a_ball_is_where_it_should_be() -> None:
    camera = dgs.Camera.look_at([0, 0, -4], [0, 0, 0], [0, -1, 0], 40.0, WIDTH, HEIGHT)
    ball: dict[str, Any] = {
        "means": [[0.0, 0.0, 0.0]],
        "scales": [[0.2, 0.2, 0.2]],
        "quats": [[1.0, 0.0, 0.0, 0.0]],
        "opacities": [0.95],
        "sh0": [[[1.5, -1.0, 0.0]]],
    }
    picture = dgs.render(ball, camera, activation="linear", alpha=True)
    assert picture.shape == (1, HEIGHT, WIDTH, 4) and picture.dtype == np.float32
    red, green, blue, alpha = picture[0, HEIGHT // 2, WIDTH // 2]
    assert alpha > 0.9 and red > blue > green
    assert not picture[0, 0, 0].any()
    white = dgs.render(ball, camera, activation="linear", background=(1, 1, 1))
    assert np.allclose(white[..., :3], picture[..., :3] + 1 - picture[..., 3:], atol=1e-5)


def test_matrices_and_places_are_the_same_camera() -> None:
    camera = cameras()[1]
    again = dgs.Camera(camera.viewmat, camera.K, camera.width, camera.height)
    many = dgs.Camera.many(camera.viewmat[None], camera.K[None], WIDTH, HEIGHT)
    source = gaussians("log")
    pictures = dgs.render(source, [camera, again, *many])
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
    assert not np.array_equal(pictures[0], dgs.render(source, cameras()[0])[0])


def test_cameras_are_compared_copied_and_pickled() -> None:
    a, b = cameras()
    for same in (copy.copy(a), copy.deepcopy(a), pickle.loads(pickle.dumps(a)), cameras()[0]):
        assert same == a and hash(same) == hash(a) and same.near == a.near
        assert np.array_equal(same.viewmat, a.viewmat) and np.array_equal(same.K, a.K)
    assert a != b and a != dgs.Camera(a.viewmat, a.K, WIDTH, HEIGHT, near=0.5) and a != 3
    assert len({a, b, *cameras()}) == 2


def test_arrays_of_numpy_are_places_and_colours() -> None:
    eye, target, up = np.array([0, 0, -4.0]), np.zeros(3), np.array([0, -1, 0])
    camera = dgs.Camera.look_at(eye, target, up, 40.0, WIDTH, HEIGHT)
    assert camera == cameras()[0]
    grey = dgs.render(gaussians("log"), camera, background=np.full(3, 0.5, np.float32))
    assert np.array_equal(grey, dgs.render(gaussians("log"), camera, background=[0.5, 0.5, 0.5]))


def test_objects_with_arrays_are_rendered() -> None:
    class Splats:
        def __init__(self) -> None:
            source = gaussians("log")
            self.means, self.scales, self.quats = source.means, source.scales, source.quats
            self.opacities, self.sh0, self.shN = source.opacities, source.sh0, source.shN
            self.footprint = "pixel"

    drawn = dgs.render(gaussians("log"), cameras(), footprint="pixel")
    assert np.array_equal(dgs.render(Splats(), cameras()), drawn)


def test_what_is_no_camera_is_named() -> None:
    for wrong, name in ((None, "NoneType"), (3, "int"), ([None], "NoneType")):
        with pytest.raises(ValueError, match=f"cameras: found a .*{name}.*dgs.Camera"):
            dgs.render(gaussians("log"), wrong)  # type: ignore[arg-type]


def test_a_scene_is_rendered_as_its_arrays() -> None:
    scene = dgs.Scene.synth("balls", gaussians=1000, frames=3)
    around = scene.ring(2, width=32, height=24)
    assert np.array_equal(dgs.render(scene, around, frame=2), dgs.render(scene.at(2), around))
    linear = dgs.render(scene.at(2, activation="linear"), around, activation="linear")
    assert np.allclose(dgs.render(scene, around, frame=2), linear, atol=1e-4)


def worst(
    source: dgs.Gaussians, activation: str, channels: int, backward: Callable[..., dict[str, Any]]
) -> float:
    """Largest distance of gradients from finite differences along random directions, relative."""
    rng = np.random.default_rng(5)
    weights = rng.normal(size=(2, HEIGHT, WIDTH, channels)).astype(np.float32)
    # Cut nothing: at a cut the picture jumps.
    options: dict[str, Any] = {"activation": activation, "background": (0.2, 0.4, 0.6), "alpha_cutoff": 0.0}
    found = backward(source, cameras(), weights, **options)
    apart = 0.0
    for name in dgs.Gaussians._fields:
        values = getattr(source, name)
        assert found[name].shape == values.shape and found[name].dtype == np.float32
        step = 2e-3

        def number(by: float, direction: NDArray[np.float64]) -> float:
            moved = source._replace(**{name: (values + by * direction).astype(np.float32)})
            picture = dgs.render(moved, cameras(), alpha=channels == 4, **options)
            return float(np.sum(picture.astype(np.float64) * weights))

        for _ in range(4):
            direction = rng.normal(size=values.shape)
            slope = (number(step, direction) - number(-step, direction)) / (2 * step)
            expected = float(np.sum(found[name].astype(np.float64) * direction))
            apart = max(apart, abs(slope - expected) / float(np.linalg.norm(found[name])))
    return apart


@pytest.mark.parametrize("activation", ["log", "linear"])
@pytest.mark.parametrize("channels", [3, 4])
def test_gradients_are_those_of_differences(activation: str, channels: int) -> None:
    assert worst(gaussians(activation), activation, channels, dgs.render_backward) < ALLOWED


@pytest.mark.parametrize("name", dgs.Gaussians._fields)
def test_a_gradient_that_is_off_is_noticed(name: str) -> None:
    def bent(*args: Any, **options: Any) -> dict[str, Any]:
        found = dgs.render_backward(*args, **options)
        bent = found[name].copy()
        bent.flat[0] += 0.05 * np.linalg.norm(bent)
        return found | {name: bent}

    assert worst(gaussians("log"), "log", 3, bent) > ALLOWED


def one_sided(field: str, ends: dict[int, float], step: float) -> float:
    """Largest distance of the gradients of values at the ends of their range from differences, relative."""
    source = gaussians("linear")
    values = getattr(source, field).copy()
    for index, value in ends.items():
        values.flat[index] = value
    weights = np.random.default_rng(5).uniform(0.5, 1.0, size=(2, HEIGHT, WIDTH, 4)).astype(np.float32)
    options: dict[str, Any] = {"activation": "linear", "alpha_cutoff": 0.0}

    def number(values: NDArray[np.float32]) -> float:
        picture = dgs.render(source._replace(**{field: values}), cameras(), alpha=True, **options)
        return float(np.sum(picture.astype(np.float64) * weights))

    found = dgs.render_backward(source._replace(**{field: values}), cameras(), weights, **options)[field]
    apart = 0.0
    for index, value in ends.items():
        inside = values.copy()
        inside.flat[index] = value + (step if value == 0.0 else -step)
        slope = (number(inside) - number(values)) / (inside.flat[index] - value)
        apart = max(apart, abs(slope - found.flat[index]) / float(np.linalg.norm(found)))
    return apart


def test_gradients_at_the_ends_of_a_range_are_one_sided() -> None:
    assert one_sided("opacities", {0: 0.0, 3: 0.0}, 1e-3) < 0.01
    # Where alpha is clamped at 0.99 the picture has a bend.
    assert one_sided("opacities", {1: 1.0, 4: 1.0}, 1e-3) < 0.05
    # A scale enters by its square: without others that are 0, it has no slope there.
    assert one_sided("scales", {0: 0.0, 7: 0.0}, 1e-3) < 0.01
    source = gaussians("linear")
    at_ends = source._replace(opacities=np.array([0, 1] * 3, np.float32))
    found = dgs.render_backward(at_ends, cameras(), np.ones((2, HEIGHT, WIDTH, 4)), activation="linear", alpha_cutoff=0.0)
    assert np.isfinite(found["opacities"]).all() and (found["opacities"] != 0).all()


def test_gradients_of_cameras_add_up() -> None:
    source, (a, b) = gaussians("log"), cameras()
    weights = np.random.default_rng(2).normal(size=(2, HEIGHT, WIDTH, 4)).astype(np.float32)
    both = dgs.render_backward(source, [a, b], weights)
    parts = [dgs.render_backward(source, c, weights[i : i + 1]) for i, c in enumerate((a, b))]
    for name in dgs.Gaussians._fields:
        assert np.allclose(both[name], parts[0][name] + parts[1][name], rtol=1e-5, atol=1e-5), name
    assert both["background"].shape == (3,)


def test_shapes_that_came_in_come_out() -> None:
    source: dict[str, Any] = gaussians("log")._asdict()
    source["sh0"] = source["sh0"][:, 0]
    del source["shN"]
    found = dgs.render_backward(source, cameras(), np.ones((2, HEIGHT, WIDTH, 3)))
    assert found["sh0"].shape == (6, 3) and found["shN"].shape == (6, 0, 3)


def test_what_is_wrong_is_named() -> None:
    source = gaussians("log")
    with pytest.raises(ValueError, match=r"grad_images: found shape \[2, 2\]; \[2, 40, 48, 3 or 4\]"):
        dgs.render_backward(source, cameras(), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="cameras: found none"):
        dgs.render(source, [])
    with pytest.raises(ValueError, match="cameras: found sizes"):
        dgs.render(source, [*cameras(), dgs.Camera.look_at([0, 0, -4], [0, 0, 0], [0, 1, 0], 40, 8, 8)])
    with pytest.raises(ValueError, match="dgs.Camera is wanted"):
        dgs.render(source, [1])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="has no quats"):
        dgs.render({"means": np.zeros((1, 3)), "scales": np.zeros((1, 3))}, cameras())
    with pytest.raises(ValueError, match="setting background"):
        dgs.render(source, cameras(), background=(float("nan"), 0, 0))
    with pytest.raises(ValueError, match="max_sh_degree"):
        dgs.render(source, cameras(), sh_degree=9)
    with pytest.raises(ValueError, match=r"viewmat: found shape \[3, 3\]"):
        dgs.Camera(np.eye(3), np.eye(3), 8, 8)
    with pytest.raises(ValueError, match=r"viewmat\[3\].*may be transposed"):
        dgs.Camera(cameras()[1].viewmat.T, np.eye(3), 8, 8)
    with pytest.raises(ValueError, match="fov_y is 200.* degrees; 0.0001 to 179.9999"):
        dgs.Camera.look_at([0, 0, -4], [0, 0, 0], [0, 1, 0], 200, 8, 8)
    with pytest.raises(ValueError, match="height is -8"):
        dgs.Camera.look_at([0, 0, -4], [0, 0, 0], [0, 1, 0], 40, 8, -8)
    with pytest.raises(ValueError, match="sh_degree is -1"):
        dgs.render(source, cameras(), sh_degree=-1)
    with pytest.raises(ValueError, match="fx"):
        dgs.Camera(np.eye(4), np.zeros((3, 3)) + np.diag([0, 0, 1]), 8, 8)


def test_a_footprint_goes_with_its_scene() -> None:
    made = dgs.Scene.synth("balls", gaussians=1000, frames=1)
    cameras = made.ring(1, width=32, height=32)
    scene = dgs.Scene.from_arrays(made.at(0), footprint="pixel")
    arrays = scene.at(0)
    assert (made.footprint, scene.footprint) == ("dilated", "pixel")
    drawn = dgs.render(scene, cameras)
    assert np.array_equal(drawn, dgs.render(arrays, cameras, footprint="pixel"))
    for same in (
        arrays,
        arrays._replace(sh0=arrays.sh0),
        copy.copy(arrays),
        pickle.loads(pickle.dumps(arrays)),
        dgs.Gaussians(*arrays, footprint=arrays.footprint),
        dgs.Gaussians(**arrays._asdict()),
    ):
        assert same.footprint == "pixel"
        assert np.array_equal(drawn, dgs.render(same, cameras))
    # A scene normalises quaternions, which may change their last digit.
    for same in (
        dgs.Scene.from_arrays(arrays).at(0),
        dgs.Scene.from_arrays(arrays._asdict()).at(0),
        dgs.Scene.from_arrays(**arrays._asdict()).at(0),
    ):
        assert same.footprint == "pixel"
        assert np.allclose(drawn, dgs.render(same, cameras), atol=1e-4)
    assert np.array_equal(drawn, dgs.render(arrays._asdict(), cameras))
    assert dgs.Scene.from_arrays(arrays, footprint="compensated").footprint == "compensated"
    assert arrays._replace(footprint="compensated").footprint == "compensated"
    bare = {name: getattr(arrays, name) for name in arrays._fields}
    assert not np.array_equal(drawn, dgs.render(bare, cameras))
    assert np.array_equal(drawn, dgs.render({**bare, "footprint": "pixel"}, cameras))
    with pytest.raises(ValueError, match="dilated, compensated, pixel are wanted"):
        dgs.render({**bare, "footprint": "wide"}, cameras)
    grad = np.ones((1, 32, 32, 3), np.float32)
    by_name = dgs.render_backward(arrays, cameras, grad, footprint="pixel")
    assert np.array_equal(dgs.render_backward(arrays, cameras, grad)["opacities"], by_name["opacities"])
    player = dgs.Player(dgs.encode(scene, pictures=0).stream)
    assert player.info["footprint"] == player.frame(0).footprint == "pixel"
    with pytest.raises(ValueError, match="dilated, compensated, pixel are wanted"):
        dgs.render(arrays, cameras, footprint="wide")  # type: ignore[arg-type]
