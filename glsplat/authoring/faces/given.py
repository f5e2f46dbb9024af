"""A face that moves for a person from a photograph: the open body's expressions, teeth, lids and lashes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.eyeballs import Eyeball, eyeballs
from glsplat.authoring.faces.lids import ShutLid, shut_lids, with_lids
from glsplat.authoring.faces.open_face import with_expressions, with_mouth
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.authoring.faces.trimmings import LidEdges, joined, lid_edges, with_lashes
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh

__all__ = ["FACE_SPLATS", "Features", "expressive", "features_of", "with_face"]

FACE_SPLATS = 900
"""Splats that teeth, gums, lids and lashes take of those of an avatar."""

_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=64)
_LASHES = 0.45  # of opacities: what photographs show of lashes is there already


def expressive(mesh: RiggedMesh) -> RiggedMesh:
    """The ``mesh``, whose first vertices are the open body's, with 52 shapes of ARKit."""
    return mesh if mesh.morphs is not None else with_expressions(mesh, _same(mesh))


class Features(NamedTuple):
    """What a face has by its mesh alone; ``features_of`` finds it."""

    face: RiggedMesh  # with expressions
    balls: list[Eyeball]
    edges: list[LidEdges]  # of the lids before them
    lids: list[ShutLid]
    teeth: RiggedMesh


def features_of(mesh: RiggedMesh, seed: int = 0) -> Features:
    """Eyes, lids and teeth of a ``mesh`` whose first vertices are the open body's.

    It has parts called eyes, mouth and skin.
    """
    face, balls = expressive(mesh), eyeballs(mesh, "eyes")
    edges = [lid_edges(face, ball) for ball in balls]
    furnished = with_mouth(face, _same(mesh))
    teeth = replace(furnished, parts=tuple(one for one in furnished.parts if one.name == "teeth"))
    return Features(face, balls, edges, shut_lids(face, list(zip(balls, edges, strict=True)), seed), teeth)


def with_face(avatar: Avatar, mesh: RiggedMesh, total: int, seed: int = 0, features: Features | None = None) -> Avatar:
    """The avatar that was made on ``mesh``, whose first vertices are the open body's, with 52 shapes of ARKit.

    Its own are kept where it has them, which is better: a splat near the lips may ride the wrong one. Teeth and lashes
    are added behind the lips and at the lids, ``total`` splats with them; the rest keeps its places and colours.
    ``features`` are those of the mesh and the seed, where they are known. Without levels and cones.
    """
    face, balls, edges, lids, teeth = features or features_of(mesh, seed)
    given = avatar if avatar.shapes is not None else with_shapes(replace(avatar, levels=()), face)
    given = replace(given, splats=replace(given.splats, cones=None, cones_psnr=None), levels=())
    given = with_lids(given, lids)
    given = with_lashes(given, face, balls, seed, strength=_LASHES, light=False, openings=edges)
    left = max(total - len(given.splats), FEWEST)
    return joined(given, make_avatar(teeth, left, seed, _SAMPLER))


def _same(mesh: RiggedMesh) -> np.ndarray:
    every = np.arange(len(mesh.vertices))
    return np.where(every < len(open_body().vertices), every, -1)
