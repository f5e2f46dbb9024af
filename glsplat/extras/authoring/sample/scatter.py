"""Scatter points over a dressed body, and turn them into splats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.sample.cells import Cloud, SamplerConfig, avatar_of, prepare_cells, skin_of
from glsplat.extras.authoring.sample.surface import allot, face_densities, face_zones
from glsplat.meshes import RiggedMesh, vertex_normals

F64 = NDArray[np.float64]

PHOTO_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, sigma=2.1, inset=0.002, round_off=8)
"""Fewer samples and rounds than for a textured mesh: faster, and a photograph has less detail."""

_COVERED_DENSITY = 0.5  # of splats under hair, over that of bare surface
_MAX_SPREAD = 1.2  # of guessed splats: the front's colours show through the gaps between narrower ones
_SHOE_DENSITY = 2.0  # of splats on shoes: seams and laces are finer than cloth


class Zone(NamedTuple):
    """A part of the surface with its own number of splats."""

    points: slice
    splats: int
    area: float  # m^2


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """M points in zones with their own numbers of splats."""

    points: SurfacePoints
    density: F64  # [M] splats per area, relative within a zone
    zones: tuple[Zone, ...]
    faces: NDArray[np.intp]  # [M] triangles of the mesh

    def avatar(
        self, mesh: RiggedMesh, rgb: F64, detail: F64, rng: np.random.Generator, guessed: F64 | None = None
    ) -> Avatar:
        """Return splats of colours [M, 3] in sRGB, denser where ``detail`` [M] is 1 than where it is 0.

        They are wider where they are ``guessed`` [M] from 0 to 1. The mesh's expressions become shapes.
        """
        corners, skin = self.points.corners, skin_of(mesh)
        rest = self.points.at(mesh.vertices)
        normals = self.points.directions(vertex_normals(mesh.vertices, mesh.faces))
        layer = np.zeros(len(mesh.vertices))
        for index, part in enumerate(mesh.parts):
            layer[part.faces] = index
        prepared = []
        for zone, splats, area in self.zones:
            denser = self.density[zone] * (1 + PHOTO_SAMPLER.detail_boost * detail[zone])
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
                spread=None if guessed is None else 1 + (_MAX_SPREAD - 1) * guessed[zone],
            )
            prepared.append(prepare_cells(cloud, splats, PHOTO_SAMPLER, rng))
        # the largest first, so that it does not finish last on one core
        order = np.argsort([-zone.splats for zone in self.zones], kind="stable")
        cells = dict(zip(order, map_threads(lambda zone: prepared[zone](), order), strict=True))
        return avatar_of([cells[zone] for zone in range(len(prepared))], mesh, PHOTO_SAMPLER.opacity)


def scatter(
    mesh: RiggedMesh,
    splats: int,
    rng: np.random.Generator,
    covered: NDArray[np.bool_] | None = None,  # [V] surface under another, which needs few splats
    elsewhere: int = 0,  # of ``splats``: on that other surface
) -> Scatter:
    """Return points for ``splats - elsewhere`` splats, by area and density, stratified over the triangles.

    Splats elsewhere come from the covered surface, and the rest from the body: hands and faces keep theirs.
    """
    faces = mesh.faces
    area = triangle_areas(mesh.vertices, mesh.faces)
    shoes = np.array([part.name == "shoes" for part in mesh.parts])[mesh.face_parts]
    density = whole = face_densities(mesh, PHOTO_SAMPLER) * np.where(shoes, _SHOE_DENSITY, 1.0)
    if covered is not None:
        density = whole * np.where(covered[faces].all(axis=1), _COVERED_DENSITY, 1.0)
    label = face_zones(mesh)
    kept = {
        int(zone): (area * density)[label == zone].sum() / (area * whole)[label == zone].sum()
        for zone in np.unique(label)
    }
    counts = {zone: round(count * kept[zone]) for zone, count in allot(splats, label, PHOTO_SAMPLER)}
    counts[0] = splats - elsewhere - sum(count for zone, count in counts.items() if zone)
    chosen, weights, zones, first = [], [], [], 0
    for zone, count in counts.items():
        mine = np.flatnonzero((label == zone) & (area > 0))
        total = np.cumsum(area[mine] * density[mine])
        points_wanted = count * PHOTO_SAMPLER.samples
        at = (np.arange(points_wanted) + rng.random()) / points_wanted * total[-1]
        chosen.append(mine[np.searchsorted(total, at).clip(0, len(mine) - 1)])
        edge, along = rng.random((2, points_wanted))
        root = np.sqrt(edge)
        weights.append(np.stack([1 - root, root * (1 - along), root * along], axis=1))
        zones.append(Zone(slice(first, first + points_wanted), count, float(area[mine].sum())))
        first += points_wanted
    face = np.concatenate(chosen)
    points = SurfacePoints(faces[face].astype(np.intp), np.concatenate(weights))
    return Scatter(points, density[face], tuple(zones), face)


def even_points(mesh: RiggedMesh, count: int) -> SurfacePoints:
    """Return ``count`` middles of triangles, in proportion to their areas."""
    total = np.cumsum(triangle_areas(mesh.vertices, mesh.faces))
    face = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    return SurfacePoints(mesh.faces[face].astype(np.intp), np.full((count, 3), 1 / 3))
