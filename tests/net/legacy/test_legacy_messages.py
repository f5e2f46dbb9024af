"""Messages of the older clients: a Unity camera, one eye or both."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.errors import ProtocolError
from glsplat.net.messages import Decoder, WireOptions
from glsplat.skinning.skeleton import Skeleton


def decode(message, options=None):
    return Decoder(options).decode(json.dumps(message))


def unity_camera(position, quat_xyzw, eye):
    names = ("pos_x", "pos_y", "pos_z", "rot_x", "rot_y", "rot_z", "rot_w")
    return dict(zip(names, map(float, (*position, *quat_xyzw)), strict=True)) | {"eye": eye}


def test_a_unity_head_sees_what_it_saw_in_unity(rng):
    """Points in front of a left-handed camera keep their place in the picture; only the eye's offset is added."""
    options = WireOptions(ipd=0.06)
    for _ in range(20):
        turn, place = Rotation.random(random_state=int(rng.integers(1e6))), rng.normal(size=3)
        cameras = [unity_camera(place, turn.as_quat(), eye) for eye in ("right", "left")]
        request = decode({"frame_id": 1, "cameras": cameras, "smplx": {}}, options)
        for camera, offset in zip(request.cameras, (-0.03, 0.03), strict=True):
            point = rng.normal(size=3)
            x, y, z = turn.inv().apply(point - place)  # Unity: right, up, forward of the head
            ours = camera.viewmat @ (*(point * (-1, 1, 1)), 1)
            np.testing.assert_allclose(ours[:3], [x - offset, -y, z], atol=1e-9)


def test_old_forms():
    head = unity_camera((0, 1.6, -2), (0, 0, 0, 1), "right")
    smplx = {"root_pose": [0, 0.5, 0], "trans": [9, 9, 9], "body_pose": [0.0] * 63, "lhand_pose": [0.1] * 45}
    options = WireOptions(size=(512, 256), quality=70)
    request = decode({"camera": head, "smplx": smplx}, options)
    assert request.form == "single-legacy" and request.eyes == (1,) and request.frame_id is None
    assert (request.cameras[0].width, request.cameras[0].height, request.options.quality) == (512, 256, 70)
    np.testing.assert_array_equal(request.pose.trans, 0)  # ignored, as their server does
    np.testing.assert_allclose(request.pose.rotations[0], [0, 0.5, 0])
    np.testing.assert_allclose(request.pose.rotations[25:40], 0.1)
    fov = 2 * math.degrees(math.atan(128 / request.cameras[0].K[1, 1]))
    assert fov == pytest.approx(65)
    bundle = decode({"frame_id": 3, "cameras": [head, head | {"eye": "left"}], "smplx": smplx})
    assert bundle.form == "bundle-legacy" and bundle.eyes == (0, 1) and bundle.frame_id == 3
    assert bundle.cameras[0].name == "left"


def test_a_pose_is_for_the_rig_that_is_shown():
    """Else it would be a pose of other joints, which nobody in a room could be drawn in."""
    head = unity_camera((0, 1.6, -2), (0, 0, 0, 1), "left")
    rod = Skeleton.from_joints(["root", "tip"], [-1, 0], [[0, 0, 0], [0, 1, 0]])
    text = json.dumps({"frame_id": 4, "cameras": [head], "smplx": {"root_pose": [0, 0.5, 0]}})
    with pytest.raises(ProtocolError, match="takes poses") as refused:
        Decoder(skeleton=rod).decode(text)
    assert (refused.value.code, refused.value.frame_id) == ("bad_pose", 4)
    assert Decoder(skeleton=rod).decode(json.dumps({"frame_id": 4, "cameras": [head]})).pose is None


@pytest.mark.parametrize(
    "message",
    [
        {"cameras": []},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 1), "left")] * 2},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 0), "left")]},
        {"cameras": [unity_camera((0, 1e9, 0), (0, 0, 0, 1), "left")]},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 1), "middle")]},
        {"camera": {"pos_x": 0}},
        {"camera": unity_camera((0, 0, 0), (0, 0, 0, 1), "left"), "smplx": {"body_pose": [1, 2]}},
        {"camera": unity_camera((0, 0, 0), (0, 0, 0, 1), "left"), "frame_id": -4},
    ],
)
def test_old_forms_are_checked_too(message):
    with pytest.raises(ProtocolError) as caught:
        decode(message)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
