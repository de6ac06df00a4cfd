"""The nearest triangle by Embree, where the package embreex is installed: single precision, on the CPU."""

import importlib.util

import torch

HINT = "backend 'embree' needs the package embreex: pip install odak[mesh]"


def is_installed() -> bool:
    """Say whether embreex can be imported."""
    return importlib.util.find_spec("embreex") is not None


def build_scene(vertices: torch.Tensor, faces: torch.Tensor):
    """Return Embree's scene of triangles; raise ImportError that says what to install when embreex is missing."""
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise ImportError(HINT) from error
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.detach().float().cpu().numpy(), faces.int().cpu().numpy())
    return scene


def nearest_faces(scene, start: torch.Tensor, direction: torch.Tensor, first: torch.Tensor) -> torch.Tensor:
    """Return the face that each ray meets first, int64 ``[m]``, −1 for none; arguments as in the search of the tree."""
    start = start + first[:, None] * direction
    found = scene.run(start.float().cpu().numpy(), direction.float().cpu().numpy())
    return torch.from_numpy(found).to(device=start.device, dtype=torch.int64)
