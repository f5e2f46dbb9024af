"""Points strewn over a dressed body, and the splats that stand for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.sample.cells import Cloud, SamplerConfig, avatar_of, begun, skin_of
from glsplat.extras.authoring.sample.surface import allot, face_densities, face_zones
from glsplat.meshes import RiggedMesh, vertex_normals

__all__ = ["PHOTO_SAMPLER", "Scatter", "even_points", "scatter"]

F64 = NDArray[np.float64]

PHOTO_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, sigma=2.1, inset=0.002, round_off=8)
"""Fewer samples and rounds than a textured mesh gets: seconds, and a photograph has less to show."""


class Zone(NamedTuple):
    """A part of the surface that has its own number of splats."""

    points: slice
    splats: int
    area: float  # m^2


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """M points in zones that have their own number of splats."""

    points: SurfacePoints
    density: F64  # [M] of splats by area, relative, in its zone
    zones: tuple[Zone, ...]
    faces: NDArray[np.intp]  # [M] triangles of the mesh

    def avatar(self, mesh: RiggedMesh, rgb: F64, busy: F64, rng: np.random.Generator) -> Avatar:
        """Splats of colours [M, 3] in sRGB, denser where ``busy`` [M] is 1 than where it is 0.

        With the mesh's expressions as its shapes, where it has some.
        """
        corners, skin = self.points.corners, skin_of(mesh)
        rest = self.points.at(mesh.vertices)
        normals = self.points.directions(vertex_normals(mesh.vertices, mesh.faces))
        layer = np.zeros(len(mesh.vertices))
        for index, part in enumerate(mesh.parts):
            layer[part.faces] = index
        begin = []
        for zone, splats, area in self.zones:
            denser = self.density[zone] * (1 + PHOTO_SAMPLER.detail_boost * busy[zone])
            cloud = Cloud(
                points=rest[zone],
                normals=normals[zone],
                rgb=rgb[zone],
                share=1 / self.density[zone],
                density=denser,
                layer=layer[corners[zone, 0]],
                corners=self.points.take(zone).matrix(len(mesh.vertices)),
                area=area,
                faces=self.faces[zone],
                skin=skin,
            )
            begin.append(begun(cloud, splats, PHOTO_SAMPLER, rng))
        # the largest first, so that no core has it last and alone
        order = np.argsort([-zone.splats for zone in self.zones], kind="stable")
        made = dict(zip(order, map_threads(lambda zone: begin[zone](), order), strict=True))
        return avatar_of([made[zone] for zone in range(len(begin))], mesh, PHOTO_SAMPLER.opacity)


def scatter(mesh: RiggedMesh, splats: int, rng: np.random.Generator) -> Scatter:
    """Points for so many splats, in proportion to area and density; every triangle gets its share."""
    faces = mesh.faces
    area = triangle_areas(mesh.vertices, mesh.faces)
    density = face_densities(mesh, PHOTO_SAMPLER)
    label = face_zones(mesh)
    chosen, weights, zones, first = [], [], [], 0
    for zone, count in allot(splats, label, PHOTO_SAMPLER):
        mine = np.flatnonzero((label == zone) & (area > 0))
        total = np.cumsum(area[mine] * density[mine])
        many = count * PHOTO_SAMPLER.samples
        at = (np.arange(many) + rng.random()) / many * total[-1]
        chosen.append(mine[np.searchsorted(total, at).clip(0, len(mine) - 1)])
        edge, along = rng.random((2, many))
        root = np.sqrt(edge)
        weights.append(np.stack([1 - root, root * (1 - along), root * along], axis=1))
        zones.append(Zone(slice(first, first + many), count, float(area[mine].sum())))
        first += many
    face = np.concatenate(chosen)
    points = SurfacePoints(faces[face].astype(np.intp), np.concatenate(weights))
    return Scatter(points, density[face], tuple(zones), face)


def even_points(mesh: RiggedMesh, count: int) -> SurfacePoints:
    """So many middles of triangles, as often as the triangle's area says."""
    total = np.cumsum(triangle_areas(mesh.vertices, mesh.faces))
    face = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    return SurfacePoints(mesh.faces[face].astype(np.intp), np.full((count, 3), 1 / 3))
