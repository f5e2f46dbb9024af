"""Decoding requests: the three forms, what is refused, and that nothing else than ProtocolError ever comes out."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import ProtocolError
from glsplat.net.messages import MAX_MESSAGE_BYTES, Ack, Decoder, WireOptions, error_text, eye_fields
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.sample import Sample

EYE = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [50, 60, 31, 33]}
GOOD = {"v": 1, "frame_id": 7, "ack": 6, "t": 1234.5, "eyes": [EYE, EYE], "size": [64, 48]}
GOOD |= {"pose": {"root_pose": [0, 1, 0]}}

LEVEL = [0, 1.6, 0, 0, 0, 0, 1]
HEAD = {"pose": None, "tracking": {"head": [0, 1.6, 0, 0, 0, 0, 1]}}


def decode(message, options=None, skeleton=None):
    text = message if isinstance(message, (str, bytes)) else json.dumps(message)
    return Decoder(options, skeleton).decode(text)


def refused(message, code=None):
    with pytest.raises(ProtocolError) as caught:
        decode(message)
    assert code is None or caught.value.code == code
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
    return caught.value


def test_a_native_request():
    body = np.linspace(-1, 1, 63).reshape(21, 3).tolist()
    request = decode(GOOD | {"quality": 90, "crop": True, "pose": {"body_pose": body, "root_pose": [0.1, 0, 0]}})
    assert (request.frame_id, request.ack, request.t) == (7, 6, 1234.5)
    assert request.options.quality == 90 and request.options.crop
    assert request.form == "native" and request.eyes == (0, 1)
    flat = decode(GOOD | {"pose": {"body_pose": np.ravel(body).tolist()}})
    np.testing.assert_array_equal(flat.pose.rotations[1:], request.pose.rotations[1:])
    assert decode({k: v for k, v in GOOD.items() if k != "pose"}).pose is None
    camera = request.cameras[1]
    assert (camera.width, camera.height) == (64, 48)
    np.testing.assert_array_equal(camera.K, [[50, 0, 31], [0, 60, 33], [0, 0, 1]])
    np.testing.assert_array_equal(camera.viewmat[2], [0, 0, 1, 2])
    np.testing.assert_allclose(request.pose.rotations[1:22], body)
    np.testing.assert_allclose(request.pose.rotations[0], [0.1, 0, 0])


def test_unknown_fields_are_left_for_the_future():
    assert decode(GOOD | {"view": "mirror", "pose": {"jaw_pose": [0, 0, 0], "betas": [[1, [2]]]}}).frame_id == 7


def test_defaults_are_the_servers():
    message = {"v": 1, "frame_id": 0, "eyes": [EYE]}
    request = decode(message, WireOptions(size=(320, 200), quality=55))
    assert (request.cameras[0].width, request.cameras[0].height, request.options.quality) == (320, 200, 55)
    assert request.eyes == (0,) and request.ack is None


def test_fields_of_a_camera_survive_the_wire_exactly(rng):
    quat = rng.normal(size=4)
    left, right = stereo_cameras(head_matrix(rng.normal(size=3), quat), K=[[700.3, 0, 511], [0, 690, 480.5], [0, 0, 1]])
    message = {"v": 1, "frame_id": 1, "size": [1024, 1024], "eyes": [eye_fields(left), eye_fields(right)]}
    for sent, got in zip((left, right), decode(message).cameras, strict=True):
        np.testing.assert_array_equal(sent.viewmat, got.viewmat)
        np.testing.assert_array_equal(sent.K, got.K)


def test_an_acknowledgement_alone():
    assert decode({"v": 1, "ack": 9}) == Ack(9)


def test_poses_by_joint_name_for_other_rigs():
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], np.zeros((2, 3)))
    request = decode(GOOD | {"pose": {"joints": {"b": [0, 0, 1]}}}, skeleton=skeleton)
    np.testing.assert_array_equal(request.pose.rotations, [[0, 0, 0], [0, 0, 1]])


def test_translations_are_in_the_parents_frame_as_posed():
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[0, :3, :3] = rotation_matrices([0.3, -0.5, 0.2])
    rest[1, :3, :3] = rotation_matrices([1.0, 0.4, -0.7])
    rest[1, :3, 3] = 0.1, 0.5, 0.0
    skeleton = Skeleton(("root", "tip"), np.array([-1, 0]), rest)
    message = {"v": 1, "frame_id": 1, "eyes": [EYE], "size": [64, 64]}
    posed = {"joints": {"root": [0, 0, 1.2]}}
    moved = posed | {"translations": {"tip": [0.2, -0.1, 0.05]}}
    frames = []
    for pose in (posed, moved):
        given = Decoder(skeleton=skeleton).decode(json.dumps(message | {"pose": pose})).pose
        frames.append(skeleton.forward(given.rotations, given.trans, given.translations))
    expected = frames[0][0, :3, :3] @ [0.2, -0.1, 0.05]
    assert np.allclose(frames[1][1, :3, 3] - frames[0][1, :3, 3], expected)


def test_waist_feet_and_body_go_to_the_solver_as_they_came():
    body = {"hips": [0, 1, 0], "left-foot-ball": [0.1, 0, 0.2, 0, 0, 0, 1], "chest": None}
    tracking = {"head": LEVEL, "waist": LEVEL, "left_foot": LEVEL, "body": body, "tail": [1, 2]}
    request = decode({"v": 1, "frame_id": 1, "tracking": tracking, "eyes": [EYE]})
    sample = request.tracking
    assert sample == Sample.from_json(tracking)
    assert sample.waist == tuple(LEVEL)
    assert sample.body == {"hips": (0, 1, 0), "left-foot-ball": tuple(body["left-foot-ball"])}


def test_an_expression_comes_with_a_pose_or_with_tracking():
    numbers = [0.0] * 52
    numbers[17] = 0.5
    for sent in ({"jawOpen": 0.5, "cheekPuff": 0}, numbers):
        assert decode(GOOD | {"pose": {"expression": sent}}).pose.expression == {"jawOpen": 0.5}
        request = decode({"v": 1, "frame_id": 1, "tracking": {"head": LEVEL, "expression": sent}})
        assert request.tracking.expression == {"jawOpen": 0.5}
    assert decode(GOOD).pose.expression == {}
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], np.zeros((2, 3)))
    pose = {"joints": {"b": [0, 0, 1]}, "expression": {"Fcl_Joy": 2}}
    assert decode(GOOD | {"pose": pose}, skeleton=skeleton).pose.expression == {"Fcl_Joy": 2.0}


@pytest.mark.parametrize(
    ("expression", "code"),
    [
        *((value, "bad_pose") for value in ([0.5] * 51, [], {"": 1.0}, {"x" * 65: 1}, {str(i): 1 for i in range(257)})),
        *((value, "bad_field") for value in (1, "jawOpen", {"jawOpen": "wide"}, {"jawOpen": None}, [None] * 52)),
    ],
)
@pytest.mark.parametrize("of", ["pose", "tracking"])
def test_what_is_no_expression_is_refused(of, expression, code):
    given = {"root_pose": [0, 0, 0]} if of == "pose" else {"head": LEVEL}
    refused(GOOD | {"pose": None, of: given | {"expression": expression}}, code)


def test_where_eyes_look_comes_with_tracking():
    tracking = {"head": LEVEL, "leftEye": [0, 0, -1], "rightEye": [0.1, 0, -0.9]}
    request = decode({"v": 1, "frame_id": 1, "tracking": tracking})
    sample = request.tracking
    assert sample.left_eye == (0, 0, -1) and sample.right_eye == (0.1, 0, -0.9)


def test_tracking_in_place_of_a_pose():
    tracking = {"head": [0, 1.6, 0.2, 0, 0, 0, 1], "left": None, "right": [0.3, 1, 0.2, 0, 0, 0, 2]}
    request = decode({"v": 1, "frame_id": 1, "tracking": tracking, "size": [64, 64]}, WireOptions(ipd=0.064))
    assert request.tracking == Sample.from_json(tracking)
    np.testing.assert_allclose(request.cameras[1].position, [0.032, 1.6, 0.2], atol=1e-12)
    assert decode({"v": 1, "frame_id": 1, "tracking": tracking, "eyes": [EYE]}).eyes == (0,)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"v": 2}, "version"),
        ({"v": None}, "version"),
        ({"v": "1"}, "bad_field"),
        ({"frame_id": None}, "bad_request"),
        ({"frame_id": -1}, "bad_request"),
        ({"frame_id": 2**32}, "bad_request"),
        ({"frame_id": 10**40}, "bad_request"),
        ({"frame_id": 1.5}, "bad_field"),
        ({"frame_id": True}, "bad_field"),
        ({"ack": -1}, "bad_request"),
        ({"eyes": []}, "bad_request"),
        ({"eyes": [EYE] * 3}, "bad_request"),
        ({"eyes": None}, "bad_request"),
        ({"eyes": {}}, "bad_field"),
        ({"eyes": [{"viewmat": EYE["viewmat"]}]}, "bad_field"),
        ({"eyes": [EYE | {"viewmat": EYE["viewmat"][:15]}]}, "bad_request"),
        ({"eyes": [EYE | {"K": [50, 50, 32]}]}, "bad_request"),
        ({"eyes": [EYE | {"K": [0, 50, 32, 32]}]}, "bad_camera"),
        ({"eyes": [EYE | {"K": [-50, 50, 32, 32]}]}, "bad_camera"),
        ({"eyes": [EYE | {"K": [1e300, 50, 32, 32]}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [0] * 16}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [1e300] * 16}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [1.01, *EYE["viewmat"][1:]]}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [-1, *EYE["viewmat"][1:]]}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [*EYE["viewmat"][:12], 0, 0, 2, 1]}]}, "bad_camera"),
        ({"eyes": [EYE | {"viewmat": [*EYE["viewmat"][:3], 1e9, *EYE["viewmat"][4:]]}]}, "bad_camera"),
        ({"size": [64]}, "bad_size"),
        ({"size": [0, 64]}, "bad_size"),
        ({"size": [4096, 64]}, "bad_size"),
        ({"size": [64.5, 64]}, "bad_field"),
        ({"quality": 0}, "bad_request"),
        ({"quality": 101}, "bad_request"),
        ({"crop": "yes"}, "bad_field"),
        ({"t": "now"}, "bad_field"),
        ({"want": "song"}, "bad_request"),
        ({"light": "nowhere"}, "bad_request"),
        ({"pose": []}, "bad_field"),
        ({"pose": {}}, "bad_pose"),
        ({"pose": {"poze": [0, 0, 0]}}, "bad_pose"),
        ({"pose": {"body_pose": [0] * 60}}, "bad_pose"),
        ({"pose": {"body_pose": [[0, 0], [1]]}}, "bad_pose"),
        ({"pose": {"root_pose": [0, 0, 0], "trans": [1e30, 0, 0]}}, "bad_pose"),
        ({"pose": {"trans": [[[0, 0, 0]]]}}, "bad_field"),
        ({"pose": {"joints": {"tail": [0, 0, 0]}}}, "bad_pose"),
        ({"tracking": {"head": [0] * 7}}, "bad_request"),  # a pose is there already
        ({"pose": None, "tracking": {"head": [0, 0, 0]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": [0] * 7}}, "bad_camera"),
        ({"pose": None, "tracking": {"head": [0, 1e9, 0, 0, 0, 0, 1]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "leftEye": [0, 0, 0]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "leftEye": [0, 1]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "leftEye": [1e300, 1, 0]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "leftEye": "ahead"}}, "bad_field"),
        ({"pose": None, "tracking": {"head": LEVEL, "waist": [0] * 6}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "left_foot": [0] * 7}}, "bad_camera"),
        ({"pose": None, "tracking": {"head": LEVEL, "right_foot": [1e9, 0, 0, 0, 0, 0, 1]}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "body": []}}, "bad_field"),
        ({"pose": None, "tracking": {"head": LEVEL, "body": {"hips": "here"}}}, "bad_field"),
        ({"pose": None, "tracking": {"head": LEVEL, "body": {"hips": [0, 1]}}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "body": {"hips": [0, 1e9, 0]}}}, "bad_request"),
        ({"pose": None, "tracking": {"head": LEVEL, "body": {f"j{i}": None for i in range(257)}}}, "bad_request"),
        ({"pose": None, "eyes": None, "tracking": {"left": [0, 0, 0, 0, 0, 0, 1]}}, "bad_request"),
    ],
)
def test_what_is_refused(change, code):
    error = refused(GOOD | change, code)
    if change.keys().isdisjoint({"frame_id"}) and code != "bad_field":
        assert error.frame_id == 7


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "bad_json"),
        ("null", "bad_field"),
        ("[]", "bad_field"),
        ("{", "bad_json"),
        ("{}", "version"),
        ('{"v":1}', "bad_request"),
        ('{"v":1,"frame_id":1,"t":NaN}', "bad_json"),
        ('{"v":1,"frame_id":1,"t":Infinity}', "bad_json"),
        ('{"v":1,"frame_id":1,"t":1e999}', "bad_field"),
        ('{"v":1,"frame_id":1,"pose":{"expression":{"jawOpen":1e999}}}', "bad_field"),
        ('{"v":1,"frame_id":1,"eyes":' + "[" * 30000, "bad_field"),
        ('{"x":' + "[" * 30000 + "]" * 30000 + "}", "bad_json"),
        (b'{"v":1,"frame_id":1,"x":"\xff"}', "bad_request"),
        ('{"v":1,"frame_id":1,"x":"\ud800"}', "bad_json"),
        (" " * (MAX_MESSAGE_BYTES + 1), "too_big"),
        ('"' + "é" * (MAX_MESSAGE_BYTES // 2) + '"', "too_big"),
    ],
)
def test_text_that_is_no_request(text, code):
    refused(text, code)


def test_a_nearly_orthonormal_rotation_is_taken():
    view = list(EYE["viewmat"])
    view[0] = 1 + 4e-4
    assert decode(GOOD | {"eyes": [EYE | {"viewmat": view}]}).eyes == (0,)


@pytest.mark.parametrize("connection", [False, True])
@pytest.mark.parametrize("asked", [None, False, True])
def test_a_request_may_ask_for_the_mirror_image_or_for_none(connection, asked):
    more = {} if asked is None else {"mirror": asked}
    shown = connection if asked is None else asked
    for message in (GOOD, {key: value for key, value in GOOD.items() if key != "eyes"} | HEAD):
        plain = decode(message).cameras
        got = decode(message | more, WireOptions(mirror=connection)).cameras
        for one, other in zip(got, plain, strict=True):
            np.testing.assert_array_equal(one.viewmat, other.viewmat * (-1 if shown else 1, 1, 1, 1))


def test_parts_that_are_left_out():
    def hide(parts, known=frozenset({"head"})):
        return Decoder(parts=known).decode(json.dumps(GOOD | {"hide": parts}))

    assert hide(["head", "head"]).options.hide == ("head",) and hide([]).options.hide == () == decode(GOOD).options.hide
    for parts, known, words in (
        (["foot"], {"head"}, "hide knows head; found another word"),
        (["head"], set(), "needs one avatar that has a joint of that name"),
    ):
        with pytest.raises(ProtocolError, match=words) as caught:
            hide(parts, frozenset(known))
        assert caught.value.code == "bad_request" and caught.value.frame_id == 7
    for wrong in ("head", [1], {}, True):
        assert refused(GOOD | {"hide": wrong}, "bad_field")


def test_the_box_is_asked_for():
    assert decode(GOOD | {"box": True}).options.box and not decode(GOOD).options.box
    assert refused(GOOD | {"box": 1}, "bad_field") and refused(GOOD | {"mirror": "yes"}, "bad_field")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_any_damage_to_a_good_request(data):
    text = bytearray(json.dumps(GOOD).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    try:
        Decoder().decode(bytes(text))
    except ProtocolError as error:
        assert error.code and len(str(error)) <= 300 and str(error).isprintable()
        json.loads(error_text(error.code, str(error), error.frame_id))
