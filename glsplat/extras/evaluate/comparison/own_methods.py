"""The project's own methods: one photograph as splats or as a mesh, a video as a mesh, and the scan itself."""

from __future__ import annotations

from dataclasses import dataclass

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.optimize.mesh_fit import fitted_to_mesh
from glsplat.extras.authoring.reconstruct.photos import from_photos, mesh_from_photos
from glsplat.extras.authoring.reconstruct.reconstructor import Options
from glsplat.extras.authoring.reconstruct.video import FRAMES, from_pictures, from_video
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.surface import make_avatar
from glsplat.extras.authoring.video.frames import FramePicture
from glsplat.extras.evaluate.avatar_score import pose_of
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.turntable import turntable
from glsplat.meshes import RiggedMesh

_STEPS, _SLOW = 450, 60  # steps of fitting, with numba and without; the command takes 900 and 450
_QUICK_FRAMES = 8

# a typical photograph, for participants without a capture note
_LOOK = (0.0, 1.3, 3.2), (0.0, 0.88, 0.0)
_FOV = 40.0  # degrees, vertical
_A_POSE = {"left_shoulder": (0.0, 0.0, -0.7), "left_hip": (0.0, 0.0, 0.07)}
_LIGHT = {"direction_to": (0.45, 0.75, 0.75), "colour": (0.62, 0.60, 0.57)}


@dataclass(frozen=True)
class _Own:
    """Options of the project's own methods."""

    seed: int = 0
    quick: bool = False  # less work, lower quality


@dataclass(frozen=True)
class Photo(_Own):
    """The front photograph to splats, as ``glsplat avatar photo`` with the participant's height."""

    def make(self, participant: Participant) -> Avatar:
        """Return the avatar. Raises CaptureError if the check refuses the photograph."""
        return from_photos(participant.photo, height=participant.height, seed=self.seed)


@dataclass(frozen=True)
class MeshImage(_Own):
    """The same photograph to a textured mesh, as ``glsplat avatar photo --as mesh`` does."""

    def make(self, participant: Participant) -> RiggedMesh:
        """Return the mesh. Raises CaptureError if the check refuses the photograph."""
        return mesh_from_photos(participant.photo, height=participant.height)


@dataclass(frozen=True)
class MeshVideo(_Own):
    """A video of the turning person to a textured mesh, as ``glsplat avatar video --as mesh`` does.

    A missing video is rendered: the participant turns once in the photograph's pose, camera and light.
    """

    def make(self, participant: Participant) -> RiggedMesh:
        """Return the mesh. Raises CaptureError if the check refuses the frames."""
        count = _QUICK_FRAMES if self.quick else FRAMES
        options = Options(height=participant.height, seed=self.seed)
        if participant.video is not None:
            made = from_video(participant.video, frames=count, options=options)
        else:
            made = from_pictures(self._drawn(participant, count), in_order=True, options=options)
        assert isinstance(made.content, RiggedMesh)
        return made.content

    def _drawn(self, participant: Participant, count: int) -> list[FramePicture]:
        mesh = participant.mesh
        camera = participant.camera or Camera(look_at(*_LOOK), pinhole(1024, 1536, _FOV), 1024, 1536)
        pose = participant.pose or pose_of(_A_POSE, mesh.skeleton)
        light = participant.light or _LIGHT
        shots = turntable(mesh, camera, pose, light["direction_to"], light["colour"], frames=count, seed=self.seed)
        return [FramePicture(f"frame {number}", shot.rgb, None) for number, shot in enumerate(shots, 1)]


@dataclass(frozen=True)
class Scan(_Own):
    """The participant's own mesh to splats, as ``glsplat avatar make`` does, with fewer steps of fitting."""

    def make(self, participant: Participant) -> Avatar:
        """Return the avatar. Raises FormatError if the mesh cannot be read."""
        mesh = participant.mesh
        if self.quick:
            return make_avatar(mesh, 10_000, self.seed, SamplerConfig(probe=256))
        return fitted_to_mesh(make_avatar(mesh, 40_000, self.seed), mesh, self.seed, _STEPS if available() else _SLOW)
