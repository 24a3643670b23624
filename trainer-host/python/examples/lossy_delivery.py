"""Sends a moving scene over a lossy link and measures what arrives. Run it as a whole or cell by cell."""

# %% A scene of arrays: a ball of Gaussians that turns, 12 frames.
import numpy as np

import dgs

rng = np.random.default_rng(7)
count, frames = 4000, 12
directions = rng.normal(size=(count, 3))
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
angles = np.linspace(0.0, 0.6, frames)
turn = np.stack(
    [
        np.stack([np.cos(angles), np.zeros(frames), np.sin(angles)], -1),
        np.stack([np.zeros(frames), np.ones(frames), np.zeros(frames)], -1),
        np.stack([-np.sin(angles), np.zeros(frames), np.cos(angles)], -1),
    ],
    axis=1,
)
means = np.einsum("tij,nj->tni", turn, directions)
scene = dgs.Scene.from_arrays(
    means=means,
    scales=np.full((count, 3), 0.035),
    quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    opacities=np.full(count, 0.9),
    sh0=directions * 1.5,
    activation="linear",
)
print(scene, "bounds", scene.bounds.tolist())

# %% Encode it: packets of at most 1150 bytes, each decodes alone.
encoded = dgs.encode(scene, progress=lambda stage, share: None)
stream = encoded.stream
print(stream, f"{encoded.report['bits_per_gaussian']:.0f} bits per Gaussian")

# %% Lose a fifth of the packets, and play what is left.
lost = [int(i) for i in np.flatnonzero(rng.random(len(stream)) < 0.2)]
player = dgs.Player.from_manifest(stream.manifest)
for number, packet in enumerate(stream.packets):
    if number not in lost:
        player.push(packet)
print(player, "lost", len(lost))

# %% Render both and compare.
cameras = scene.ring(3, width=128, height=128)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio of pictures of 0 to 1, dB."""
    return float(-10.0 * np.log10(np.mean(np.square(a - b)) + 1e-12))


last = frames - 1
reference = dgs.render(scene, cameras, frame=last)
whole = psnr(dgs.render(dgs.Player(stream).frame(last), cameras), reference)
lossy = psnr(dgs.render(player.frame(last), cameras), reference)
print(f"whole {whole:.1f} dB, with losses {lossy:.1f} dB")
assert whole > 35.0 and 15.0 < lossy < whole, (whole, lossy)

# %% Gradients: how the error of the lossy picture changes with every array.
arrays = player.frame(last)
pictures = dgs.render(arrays, cameras)
gradients = dgs.render_backward(arrays, cameras, 2.0 * (pictures - reference) / pictures.size)
for name, gradient in gradients.items():
    print(f"{name:10} {gradient.shape!s:14} largest {np.abs(gradient).max(initial=0.0):.2e}")

# %% One step down the gradient of colour lessens the error.
better = arrays._replace(sh0=arrays.sh0 - 50.0 * gradients["sh0"])
after = psnr(dgs.render(better, cameras), reference)
print(f"after one step {after:.2f} dB")
assert after > lossy, (after, lossy)
