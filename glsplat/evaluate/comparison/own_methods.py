"""The project's own methods: one photograph as splats or as a mesh, a video as a mesh, and the scan itself."""

from __future__ import annotations

from dataclasses import dataclass

from glsplat.avatar import Avatar
from glsplat.evaluate.comparison.participant import Participant
from glsplat.making.reconstruct.photos import from_photos, mesh_from_photos
from glsplat.making.refine import RefineConfig, refine
from glsplat.making.surface import make_avatar
from glsplat.meshes import RiggedMesh

__all__ = ["MeshImage", "Photo", "Scan"]


@dataclass(frozen=True)
class _Own:
    """What the project's own methods are told."""

    seed: int = 0
    quick: bool = False  # a look, not a result


@dataclass(frozen=True)
class Photo(_Own):
    """The photograph of the front to splats, as ``glsplat avatar photo`` makes them; the height is told."""

    def make(self, participant: Participant) -> Avatar:
        """Raises CaptureError where the check refuses the photograph."""
        return from_photos(participant.photo, height=participant.height, seed=self.seed)


@dataclass(frozen=True)
class MeshImage(_Own):
    """The same photograph to a textured mesh, as ``glsplat avatar photo --as mesh`` makes them."""

    def make(self, participant: Participant) -> RiggedMesh:
        """Raises CaptureError where the check refuses the photograph."""
        return mesh_from_photos(participant.photo, height=participant.height)


@dataclass(frozen=True)
class Scan(_Own):
    """The participant's own mesh to splats, as ``glsplat avatar make`` makes them: the most that splats can reach."""

    def make(self, participant: Participant) -> Avatar:
        """Raises FormatError for a mesh that cannot be read."""
        mesh = participant.mesh
        if self.quick:
            return make_avatar(mesh, 10_000, self.seed)
        return refine(make_avatar(mesh, 40_000, self.seed), mesh, self.seed, RefineConfig(steps=_STEPS))


_STEPS = 60  # of fitting; the command takes 450
