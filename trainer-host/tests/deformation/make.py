"""Makes the files of this folder: small networks with random weights, and what the programs that train such
networks make of them.

    git clone https://github.com/hustvl/4DGaussians
    git clone https://github.com/ingra14m/Deformable-3D-Gaussians
    pip install torch numpy safetensors
    python make.py 4DGaussians Deformable-3D-Gaussians

The networks are those programs' own modules, imported from the clones; nothing of them is copied here. For
each case there is a file of weights (and Gaussians) and one of expected values, `NAME-expected.npz`: positions,
rotations, log-scales, opacity logits and harmonics, each frames x Gaussians x width.
"""

import sys
import types

import numpy
import torch
from safetensors.numpy import save_file

GAUSSIANS, FRAMES = 6, 5


def module(name, **members):
    """A module that stands for one that is not needed."""
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__dict__.update(members)
    return sys.modules[name]


def gaussians(seed):
    """Canonical Gaussians, some of them outside the box of the field."""
    generator = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=generator)
    return {
        "_xyz": normal(GAUSSIANS, 3),
        "_features_dc": 0.3 * normal(GAUSSIANS, 1, 3),
        "_features_rest": 0.1 * normal(GAUSSIANS, 15, 3),
        "_scaling": normal(GAUSSIANS, 3) - 3,
        "_rotation": 2 * normal(GAUSSIANS, 4),
        "_opacity": normal(GAUSSIANS, 1),
    }


def random_weights(network, seed):
    """Weights whose outputs are neither all small nor all cut off."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if "aabb" in name:
                continue
            spread = 0.5 if "grids" in name else parameter.shape[-1] ** -0.5
            offset = 0.7 if "grids" in name else 0.0
            parameter.copy_(offset + spread * torch.randn(parameter.shape, generator=generator))


def arrays(network):
    return {name: value.detach().numpy() for name, value in network.state_dict().items()}


def write(name, weights, canonical, frames, safetensors=False):
    canonical = {key: value.numpy() for key, value in canonical.items()}
    if safetensors:
        save_file({**weights, **canonical}, f"{name}.safetensors")
    else:
        numpy.savez_compressed(f"{name}.npz", **weights, **canonical)
    columns = ["positions", "rotations", "log_scales", "opacity_logits", "harmonics"]
    stacked = {key: torch.stack(values).numpy() for key, values in zip(columns, zip(*frames))}
    numpy.savez_compressed(f"{name}-expected.npz", **stacked)


def times():
    return [torch.full((GAUSSIANS, 1), frame / (FRAMES - 1)) for frame in range(FRAMES)]


def four_dimensional(name, seed, safetensors=False, **edits):
    """A field of 4DGaussians with these options, and the text of its cfg_args."""
    from arguments import ModelHiddenParams
    from argparse import ArgumentParser
    from scene.deformation import deform_network

    parser = ArgumentParser()
    hidden = ModelHiddenParams(parser)
    options = hidden.extract(parser.parse_args([]))
    options.kplanes_config = {
        "grid_dimensions": 2, "input_coordinate_dim": 4, "output_coordinate_dim": 4, "resolution": [5, 3, 4, 6],
    }
    options.multires, options.net_width, options.timenet_width, options.timenet_output = [1, 2], 12, 2, 2
    for key, value in edits.items():
        setattr(options, key, value)
    network = deform_network(options)
    network.deformation_net.set_aabb([1.5, 1.25, 2.0], [-1.0, -1.5, -1.75])
    random_weights(network, seed)
    canonical = gaussians(seed + 1)
    harmonics = torch.cat((canonical["_features_dc"], canonical["_features_rest"]), 1)
    frames = []
    for time in times():
        with torch.no_grad():
            moved = network(canonical["_xyz"], canonical["_scaling"], canonical["_rotation"],
                            canonical["_opacity"], harmonics, time)
        position, scale, rotation, opacity, moved_harmonics = moved
        rotation = torch.nn.functional.normalize(rotation)
        frames.append((position, rotation, scale, opacity, moved_harmonics.reshape(GAUSSIANS, -1)))
    write(name, arrays(network), canonical, frames, safetensors)
    if edits:
        from argparse import Namespace
        with open(f"{name}-cfg_args", "w") as text:
            text.write(str(Namespace(source_path="a, no_dx=True", **vars(options))))


def deformable(name, seed, **options):
    """A network of Deformable-3D-Gaussians; its sizes are those that the program has."""
    from utils.time_utils import DeformNetwork
    from utils.rigid_utils import from_homogenous, to_homogenous

    network = DeformNetwork(D=4, W=10, **options)
    random_weights(network, seed)
    canonical = gaussians(seed + 1)
    harmonics = torch.cat((canonical["_features_dc"], canonical["_features_rest"]), 1)
    positions = canonical["_xyz"]
    frames = []
    for time in times():
        with torch.no_grad():
            moved, turn, growth = network(positions, time)
        if options.get("is_6dof"):
            position = from_homogenous(torch.bmm(moved, to_homogenous(positions).unsqueeze(-1)).squeeze(-1))
        else:
            position = positions + moved
        rotation = torch.nn.functional.normalize(canonical["_rotation"]) + turn
        # The program's rasteriser squares sizes: their sign says nothing. Quaternions are compared as turns.
        scale = torch.log(torch.abs(torch.exp(canonical["_scaling"]) + growth))
        rotation = torch.nn.functional.normalize(rotation)
        frames.append((position, rotation, scale, canonical["_opacity"], harmonics.reshape(GAUSSIANS, -1)))
    write(name, arrays(network), canonical, frames)


def forget():
    """Both programs call their packages by the same names."""
    for name in [name for name in sys.modules if name.split(".")[0] in ("scene", "utils", "arguments")]:
        del sys.modules[name]


def package(name, folder):
    module(name).__path__ = [folder]


torch.manual_seed(0)
four_dimensional_clone, deformable_clone = sys.argv[1:3]
module("tkinter", W=None)
sys.path.insert(0, four_dimensional_clone)
package("scene", f"{four_dimensional_clone}/scene")
package("utils", f"{four_dimensional_clone}/utils")
four_dimensional("planes", 1)
four_dimensional("planes-all", 3, safetensors=True, defor_depth=3, no_do=False, no_dshs=False,
                 apply_rotation=True, static_mlp=True, grid_pe=2)
four_dimensional("planes-still", 5, no_dx=True, no_ds=True, no_dr=True, no_do=False, defor_depth=2)
sys.path.pop(0)
forget()
sys.path.insert(0, deformable_clone)
package("utils", f"{deformable_clone}/utils")
deformable("warp", 7, is_blender=True)
deformable("warp-screw", 9, is_6dof=True)
