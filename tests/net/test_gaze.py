"""Whom the eyes of a tracked avatar look at: who looks at it, its image in a mirror, the others of its room."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import ProtocolError
from glsplat.extras.rooms.feature import Member
from glsplat.extras.rooms.room import Room
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.messages import Decoder, Request, eye_fields
from glsplat.net.wire_schema import MAX_FACES
from glsplat.rotations import rotation_matrices
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import Calibration

HEAD = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]  # looks along -z
ASIDE = [0.6, 1.6, -1.5]


def request(number: int = 1, head: Any = HEAD, **fields: Any) -> Request:
    message = {"v": 1, "frame_id": number, "t": number * 100 / 3, "tracking": {"head": head}, **fields}
    found = Decoder().decode(json.dumps(message))
    assert isinstance(found, Request)
    return found


def looked_at(place: list[float], seconds: float = 10, **fields: Any) -> float:
    """The share of the time in which the eyes' joints look within 4 degrees of a ``place``."""
    solver = TrackingSolver(default_avatar().skeleton, Calibration(), idle=True)
    towards = np.array(place) - HEAD[:3]
    near = 0
    count = int(30 * seconds)
    for k in range(count):
        pose = solver.solve(request(k + 1, **fields), 0.0).pose
        x, y, z = rotation_matrices(pose.rotations[23:25])[:, :, 2].mean(0)
        looks = np.array([-x, y, -z])  # the head's joint looks along +z, its user along -z
        angle = np.arccos(np.clip(looks @ towards / np.linalg.norm(looks) / np.linalg.norm(towards), -1, 1))
        near += np.degrees(angle) < 4
    return near / count


def eyes_at(place: list[float]) -> list[dict[str, Any]]:
    return [eye_fields(camera) for camera in stereo_cameras(head_matrix(place, (0, 1, 0, 0)), size=(16, 16))]


def test_a_face_that_a_request_names_is_looked_at_and_else_it_is_not():
    assert looked_at(ASIDE, want="pose", faces=[ASIDE]) > 0.6
    assert looked_at(ASIDE, want="pose") < 0.2


def test_who_looks_at_the_avatar_is_looked_at():
    assert looked_at(ASIDE, eyes=eyes_at(ASIDE)) > 0.6


@pytest.mark.check
def test_before_a_mirror_its_user_meets_the_own_eyes():
    """A mirror at x = .3: the eye that is sent is FLIP_X of the image, and the image is what is looked at."""
    image = [0.7, 1.6, -1.6]
    mirrored = [-image[0], *image[1:]]
    assert looked_at(image, eyes=eyes_at(mirrored), mirror=True) > 0.6


@pytest.mark.check
def test_the_own_eyes_are_no_face():
    assert looked_at([0.0, 1.6, -5.0], eyes=eyes_at(HEAD[:3])) == looked_at([0.0, 1.6, -5.0], want="pose")


@pytest.mark.parametrize(
    "faces", [[[0, 1]], [[0, 1, 2, 3]], [["a", 0, 0]], [[0, 1e9, 0]], [[0, 1, 2]] * (MAX_FACES + 1), "x", [None]]
)
def test_what_is_no_list_of_places_is_refused(faces):
    with pytest.raises(ProtocolError, match=r"faces|Expected"):
        request(want="pose", faces=faces)


def test_in_a_room_everybody_has_the_faces_of_the_others_in_the_own_space():
    room = Room("lab")
    rest = Pose.zero(55)
    ann, bob, cat = (Member(room, room.join(name, "a", 0.0), rest) for name in ("ann", "bob", "cat"))
    assert ann.meeting(request()).faces == ()
    (face,) = bob.meeting(request(head=[0.1, 1.7, 0.2, 0, 0, 0, 1])).faces
    seen = np.linalg.inv(bob.person.seat) @ ann.person.seat @ [0.0, 1.6, 0.0, 1.0]
    assert face == pytest.approx(seen[:3])
    assert len(cat.meeting(request(faces=[[0, 1, 2]])).faces) == 3
    ann.end(goodbye=True)
    assert len(cat.meeting(request()).faces) == 1
