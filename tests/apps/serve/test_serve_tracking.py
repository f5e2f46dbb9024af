"""Head and hands on the wire become a person's pose at the server."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glsplat.camera import stereo_cameras
from glsplat.data import default_avatar
from glsplat.errors import PoseError, ProtocolError
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.messages import Decoder, eye_fields
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.tracker import Tracker


def tracked(frame_id, x, **more):
    tracking = {"head": [x, 1.55, 0.1, 0, 0, 0, 1], "left": None, "right": [x + 0.3, 1.2, -0.3, 0, 0, 0, 1]}
    return {"v": 1, "frame_id": frame_id, "t": frame_id * 14.0, "size": [64, 64], "tracking": tracking, **more}


def test_tracking_becomes_a_pose_in_the_avatars_space():
    skeleton = default_avatar().skeleton
    calibration = Calibration(scale=1.25, floor=0.1)
    solver, alone = TrackingSolver(skeleton, calibration), Tracker(skeleton, calibration)
    decoder = Decoder()
    requests = [decoder.decode(json.dumps(tracked(i, i * 0.005))) for i in range(20)]
    for request in requests:
        expected = alone.update(request.tracking)
    for request in requests:
        solved = solver.solve(request, 0.0)
    np.testing.assert_array_equal(solved.pose.rotations, expected.rotations)
    np.testing.assert_array_equal(solved.pose.trans, expected.trans)
    assert "left_lost" in solved.notes
    np.testing.assert_allclose(solved.to_user @ (0, 1, 0, 1), (0, 1.35, 0, 1))
    for theirs in requests[19].cameras:
        mine = solved.seen(theirs)
        np.testing.assert_allclose(mine.position, (theirs.position - (0, 0.1, 0)) / 1.25)
        np.testing.assert_array_equal(mine.viewmat[:3, :3], theirs.viewmat[:3, :3])


@pytest.mark.extra(name="speech")
def test_eyes_that_no_sensor_sees_look_around_where_the_server_says_so():
    """The rest of the body is that of a server which does not."""
    skeleton, decoder = default_avatar().skeleton, Decoder()
    idle, plain = (TrackingSolver(skeleton, Calibration(), idle=on) for on in (True, False))
    eyes = [skeleton.names.index(f"{side}_eye_smplhf") for side in ("left", "right")]
    looks = []
    for i in range(1, 120):
        request = decoder.decode(json.dumps(tracked(i, 0.0)))
        one, other = idle.solve(request, 0.0).pose.rotations, plain.solve(request, 0.0).pose.rotations
        assert not other[eyes].any()
        np.testing.assert_array_equal(np.delete(one, eyes, axis=0), np.delete(other, eyes, axis=0))
        looks.append(one[eyes])
    assert 1 < np.degrees(np.abs(looks).max()) < 25
    assert np.ptp(looks, axis=0).max() > 0.02


numbers = st.floats(-1.5, 1.5) | st.floats(allow_nan=False, allow_infinity=False)
poses = st.none() | st.lists(numbers, min_size=7, max_size=7)
hands = st.none() | st.lists(numbers, min_size=75, max_size=75) | st.lists(numbers, max_size=4)
tracked_fields = {
    **dict.fromkeys(("head", "left", "right", "left_grip", "right_grip"), poses),
    **dict.fromkeys(("left_joints", "right_joints"), hands),
    **dict.fromkeys(("left_curl", "right_curl"), st.none() | numbers),
}


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(numbers, st.fixed_dictionaries({}, optional=tracked_fields)), min_size=1, max_size=4))
def test_any_tracking_gives_a_finite_pose_or_a_protocol_error(messages):
    """Whatever passes the decoder can be solved: what a client sends never fails in the render thread."""
    solver, decoder = TrackingSolver(default_avatar().skeleton, Calibration()), Decoder()
    for frame_id, (t, tracking) in enumerate(messages, 1):
        eyes = [eye_fields(eye) for eye in stereo_cameras(np.eye(4), size=(64, 64))]
        text = json.dumps({"v": 1, "frame_id": frame_id, "t": t, "eyes": eyes, "tracking": tracking})
        try:
            solved = solver.solve(decoder.decode(text), 0.0)
        except (ProtocolError, PoseError) as error:
            assert "\n" not in str(error) and len(str(error)) < 400
        else:
            assert np.isfinite(solved.pose.rotations).all() and np.isfinite(solved.pose.trans).all()
