"""Intersections of many rays with meshes of triangles, without gaps, differentiable in rays and vertices."""

import itertools
from collections.abc import Iterable
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import reals_of, tensor
from odak.learn._threads import each
from odak.learn.raytracing import triangle_search
from odak.learn.raytracing.triangle_search import (
    Frame,
    MeshHit,
    advanced,
    components,
    evaluate,
    face_table,
    length,
    misses,
    nearest_approach,
)
from odak.raytracing import geometry
from odak.tools import asset

__all__ = ["MeshHit", "triangle_mesh"]

BACKENDS = ("auto", "torch", "embree")
# Rays that are not worth a thread of their own.
SMALL = 1024


class triangle_mesh:
    """Triangles over shared vertices, for rays to meet.

    Parameters
    ----------
    vertices : torch.Tensor
        ``[v, 3]``. May require a gradient.
    faces : torch.Tensor
        Integers ``[t, 3]``: three vertices each, counter-clockwise seen from where the normal points.
    normals : str or torch.Tensor
        "flat": the triangles' own; "smooth": interpolated from :meth:`vertex_normals`, for surfaces that refract;
        or normals at the vertices, ``[v, 3]``.
    backend : str
        "torch": the search of this library, any device and precision, without gaps. "embree": Embree's, in single
        precision on the CPU; needs the package embreex (``pip install odak[mesh]``). "auto": Embree for float32 on the
        CPU when it is installed, else torch.
    memory_budget : int
        Bytes that the search may hold beside its result, whatever the number of rays.

    Raises
    ------
    TypeError
        If faces are not integers.
    ValueError
        If a shape is wrong, a face names a vertex that does not exist, or a vertex is not finite.
    ImportError
        If `backend` is "embree" and embreex is not installed.

    Notes
    -----
    The search: a bounding volume hierarchy of eight branches, which all rays descend together, and the test of Woop,
    Benthin and Wald, J. Comput. Graph. Tech. 2(1), 65 (2013). It keeps the faces alone; distance, point and normal are
    computed again from them, so that gradients cost memory for one triangle per ray. They do not see that a ray may
    move to another face. Triangles without area are not hit. Embree rounds more coarsely and may miss at edges.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing import triangle_mesh
    >>> square = torch.tensor([[0.0, 0, 5], [1, 0, 5], [1, 1, 5], [0, 1, 5]])
    >>> mesh = triangle_mesh(square, torch.tensor([[0, 1, 2], [0, 2, 3]]))
    >>> hit = mesh.intersect(torch.tensor([[[0.5, 0.25, 0.0], [0.0, 0.0, 1.0]], [[2.0, 2.0, 0.0], [0.0, 0.0, 1.0]]]))
    >>> hit.distance, hit.face
    (tensor([5., nan]), tensor([ 0, -1]))
    """

    def __init__(
        self,
        vertices: torch.Tensor,
        faces: torch.Tensor,
        normals: str | torch.Tensor = "flat",
        backend: str = "auto",
        memory_budget: int = 2**28,
    ) -> None:
        (vertices,) = reals_of(vertices=vertices)
        self.vertices = _checked_vertices(vertices)
        self.faces = _checked_faces(faces, self.vertices)
        self.backend = _validate.one_of("backend", backend, BACKENDS)
        if self.backend == "embree" and not triangle_search.has_embree():
            raise ImportError(triangle_search.EMBREE_HINT)
        self.memory_budget = _validate.integer("memory_budget", memory_budget, minimum=2**16)
        self.normals = _checked_normals(normals, self.vertices)
        self._leaves: torch.Tensor | None = None
        self._trees: dict = {}
        self._tables: dict = {}
        self._scene: Any = None

    def moved(self, vertices: Any) -> "triangle_mesh":
        """Return the same mesh with its vertices elsewhere; the hierarchy is refitted, not built again.

        Meant for the steps of an optimization. Normals given at vertices are kept.
        """
        (vertices,) = reals_of(vertices=vertices)
        if len(_checked_vertices(vertices)) != len(self.vertices):
            raise ValueError(f"vertices must have as many rows as before, {len(self.vertices)}; got {len(vertices)}")
        mesh = triangle_mesh(vertices, self.faces, self.normals, self.backend, self.memory_budget)
        mesh._leaves = self._sorted()
        return mesh

    def triangles(self) -> torch.Tensor:
        """Return the corners of all faces, ``[t, 3, 3]``."""
        return self.vertices[self.faces]

    def vertex_normals(self) -> torch.Tensor:
        """Return unit normals at the vertices, ``[v, 3]``, differentiable; NaN at vertices without a face.

        The faces around a vertex count by Max's weights, which are exact on a sphere (J. Graphics Tools 4(2), 1, 1999).
        """
        corners = self.triangles()
        total = torch.zeros_like(self.vertices)
        for i in range(3):
            edge1, edge2 = corners[:, (i + 1) % 3] - corners[:, i], corners[:, (i + 2) % 3] - corners[:, i]
            weight = geometry.corner_weights(edge1, edge2)
            total = total.index_add(0, self.faces[:, i], weight[:, None] * geometry.cross(edge1, edge2))
        return geometry.unit(total)

    def intersect(
        self,
        rays: torch.Tensor,
        minimum_distance: float | torch.Tensor | None = None,
        leaving: torch.Tensor | None = None,
    ) -> MeshHit:
        """Return the nearest hit ahead of each ray.

        Parameters
        ----------
        rays : torch.Tensor
            ``[..., 2, 3]``. Directions need not be unit vectors. A ray that is not finite or has no direction misses.
        minimum_distance : float or torch.Tensor, optional
            Hits that are not farther than this, in lengths of the direction, do not count; a number or ``[...]``. By
            default a few roundings of the mesh's size, so that a ray does not meet again the face it starts on.
        leaving : torch.Tensor, optional
            Faces that the rays start on, integers ``[...]``, −1 for none: they are left out, wherever the start has
            been rounded to. Searched by torch whatever the backend.

        Returns
        -------
        MeshHit
            Named tuple of distance ``[...]``, point and normal ``[..., 3]``, face ``[...]``, barycentric ``[..., 3]``
            and status ``[...]``, in the wider precision of rays and mesh, on the mesh's device.

        Raises
        ------
        ValueError
            If a shape is wrong.
        """
        vertices, rays = reals_of(vertices=self.vertices, rays=rays)
        if rays.shape[-2:] != (2, 3):
            raise ValueError(f"rays must be [2, 3] or [..., 2, 3], got {tuple(rays.shape)}")
        batch, flat = rays.shape[:-2], rays.reshape(-1, 2, 3)
        if len(flat) and len(self.faces):
            limits = _per_ray("minimum_distance", minimum_distance, rays), _per_ray("leaving", leaving, rays)
            hit = self._nearest(vertices, flat, *limits)
        else:
            hit = misses(flat)
        return MeshHit(*(field.reshape(batch + field.shape[1:]) for field in hit))

    def write_PLY(self, filename: str, text: bool = False) -> None:
        """Write vertices and faces as a PLY file, atomically.

        Parameters
        ----------
        filename : str
            Path of the file.
        text : bool
            Whether to write numbers as text; by default False, binary.
        """
        text = _validate.flag("text", text)
        asset.write_mesh(filename, self.vertices.detach().cpu().numpy(), self.faces.cpu().numpy(), text)

    @classmethod
    def read_PLY(cls, filename: str, device: torch.device | str | None = None, **options: Any) -> "triangle_mesh":
        """Return the mesh of a PLY file, with polygons divided into triangles.

        Parameters
        ----------
        filename : str
            Path of the file.
        device : torch.device or str, optional
            Device of the mesh, by default the CPU.
        **options :
            Further arguments of the class.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not a PLY file of a mesh.
        """
        vertices, faces = (torch.from_numpy(v).to(device) for v in asset.read_mesh(filename))
        if not bool(torch.isfinite(vertices).all()):
            raise ValueError(f"{filename!r} has vertices that are not finite")
        return cls(vertices, faces, **options)

    def _nearest(self, vertices, rays, minimum, leaving) -> MeshHit:
        with torch.no_grad():
            tree = self._fitted(vertices)
        frame = Frame(tree.centre, tree.scale)
        normals = self.vertex_normals() if isinstance(self.normals, str) and self.normals == "smooth" else self.normals
        normals = normals.to(vertices) if torch.is_tensor(normals) else None
        table = self._table(frame, vertices)
        fits = vertices.dtype == torch.float32 and vertices.device.type == "cpu" and triangle_search.has_embree()
        by_embree = self.backend == "embree" or (self.backend == "auto" and fits)
        embree = self._embree_scene(tree) if leaving is None and by_embree else None
        # Pieces that stay in the cache, shared out among the threads of a CPU.
        threads = 1 if rays.is_cuda else torch.get_num_threads()
        budget = self.memory_budget // threads
        size = min(triangle_search.pairs_at_a_time(tree, budget), max(-(-len(rays) // threads), SMALL))
        size = -(-len(rays) // -(-len(rays) // size))
        pieces = rays.split(size)
        limits = (itertools.repeat(None) if v is None else v.split(size) for v in (minimum, leaving))

        def search(start, direction, solid, minimum, leaving):
            return self._search(tree, embree, budget, start, direction, solid, minimum, leaving)

        def hits(rays, minimum, leaving):
            start, direction, solid = components(rays)
            searched = search(start, direction, solid, minimum, leaving)
            return evaluate(frame, table, self.faces, normals, start, direction, *searched)

        found: Iterable[MeshHit]
        if torch.is_grad_enabled() and any(v is not None and v.requires_grad for v in (rays, table, normals)):
            parts = [components(piece) for piece in pieces]
            items = ((*(v.detach() for v in part), *limit) for part, *limit in zip(parts, *limits, strict=False))
            found = (
                evaluate(frame, table, self.faces, normals, start, direction, *searched)
                for (start, direction, _), searched in zip(parts, each(search, items, threads > 1), strict=True)
            )
        else:
            found = each(hits, zip(pieces, *limits, strict=False), threads > 1)
        return MeshHit(*map(torch.cat, zip(*found, strict=True)))

    def _search(self, tree, embree, budget, start, direction, solid, minimum, leaving):
        """Return the faces met and where along the rays their search started, ``[m]``."""
        frame = Frame(tree.centre, tree.scale)
        shift = nearest_approach(frame, start, direction)
        near = advanced(frame, start, direction, shift)
        if minimum is None:
            reach = 1 + length(start - frame.centre.to(start)[:, None]) * frame.scale.to(start)
            first = 16 * geometry.epsilon(start) * reach / length(direction)
        else:
            first = minimum.double() * frame.scale
        first = (first - shift * frame.scale).to(start.dtype)
        if embree is not None:
            face = triangle_search.nearest_faces_by_embree(embree, near, direction, first)
        else:
            face = triangle_search.nearest_faces(tree, near, direction, first, leaving, budget)
        return torch.where(solid, face, -1), shift

    def _sorted(self) -> torch.Tensor:
        if self._leaves is None:
            self._leaves = triangle_search.sort_faces(self.vertices, self.faces)
        return self._leaves

    def _fitted(self, vertices: torch.Tensor) -> triangle_search.Tree:
        if vertices.dtype not in self._trees:
            self._trees[vertices.dtype] = triangle_search.fit(vertices, self.faces, self._sorted())
        return self._trees[vertices.dtype]

    def _table(self, frame: Frame, vertices: torch.Tensor) -> torch.Tensor:
        """Return corners and normals of all faces, with their graph or kept."""
        if vertices.requires_grad and torch.is_grad_enabled():
            return face_table(frame, vertices, self.faces)
        if vertices.dtype not in self._tables:
            self._tables[vertices.dtype] = face_table(frame, vertices.detach(), self.faces)
        return self._tables[vertices.dtype]

    def _embree_scene(self, tree: triangle_search.Tree):
        if self._scene is None:
            placed = triangle_search.to_frame(self.vertices.detach(), tree.centre, tree.scale)
            self._scene = triangle_search.embree_scene(placed, self.faces)
        return self._scene


def _checked_vertices(vertices: torch.Tensor) -> torch.Tensor:
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"vertices must be [v, 3], got {tuple(vertices.shape)}")
    if not bool(vertices.detach().isfinite().all()):
        raise ValueError("vertices must be finite")
    return vertices


def _checked_faces(faces, vertices: torch.Tensor) -> torch.Tensor:
    faces = tensor("faces", faces, device=vertices.device)
    if faces.dtype.is_floating_point or faces.dtype.is_complex or faces.dtype == torch.bool:
        raise TypeError(f"faces must be integers, got {faces.dtype}")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces must be [t, 3], got {tuple(faces.shape)}")
    if faces.numel() and not (int(faces.min()) >= 0 and int(faces.max()) < len(vertices)):
        span = f"{int(faces.min())} … {int(faces.max())}"
        raise ValueError(f"faces must name vertices 0 … {len(vertices) - 1}, got {span}")
    return faces.long()


def _checked_normals(normals, vertices: torch.Tensor):
    if isinstance(normals, str):
        return _validate.one_of("normals", normals, ("flat", "smooth"))
    (normals,) = reals_of(normals=normals)
    if normals.shape != vertices.shape:
        raise ValueError(f"normals must be {tuple(vertices.shape)} as the vertices, got {tuple(normals.shape)}")
    return normals


def _per_ray(name: str, value, rays: torch.Tensor) -> torch.Tensor | None:
    """Return a value for each ray ``[m]``, without a graph."""
    if value is None:
        return None
    (value,) = reals_of(**{name: value}) if name == "minimum_distance" else (tensor(name, value),)
    try:
        return value.to(rays.device).detach().expand(rays.shape[:-2]).reshape(-1)
    except RuntimeError as error:
        raise ValueError(f"{name} must be a number or {tuple(rays.shape[:-2])}, one for each of the rays") from error
