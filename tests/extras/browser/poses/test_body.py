"""A body on the wire: packed, unpacked, and refused where it is damaged."""

from __future__ import annotations

import numpy as np
import pytest

import glsplat
from glsplat.errors import PoseError, ProtocolError
from glsplat.net.codec.body import AT_ORIGIN, for_recipient, pack_body, placement_of, unpack_bodies
from glsplat.net.reply import pack_poses, parse_reply
from glsplat.rotations import turn_between
from glsplat.skinning.expression import ARKIT

SHA = bytes(range(32))


def someone(seed: int, joints: int = 55, stretched: bool = False, face: bool = True) -> glsplat.Pose:
    """A pose with angles up to two turns: half of the quaternions have a negative w."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(joints, 3))
    vectors *= (rng.uniform(0, 4 * np.pi, joints) / np.linalg.norm(vectors, axis=1))[:, None]
    return glsplat.Pose(
        vectors,
        rng.normal(size=3),
        rng.normal(0, 0.1, (joints, 3)) if stretched else None,
        dict(zip(ARKIT, rng.uniform(0, 1, 52), strict=True)) if face else None,
    )


@pytest.mark.parametrize(("joints", "stretched", "face"), [(55, False, True), (1, True, False), (300, True, True)])
def test_what_was_packed_comes_back(joints: int, stretched: bool, face: bool) -> None:
    pose = someone(joints, joints, stretched, face)
    place = glsplat.scene.similarity((1.5, -2, 3), (0.1, 0.7, -0.3, 0.5), 1.3)
    packed = pack_body(pose, SHA, placement_of(place), at=12345.678, t=None, key=7, frame_id=2**32 - 1, opacity=0.5)
    (body,) = unpack_bodies(bytes((1,)) + packed)
    assert np.degrees(np.linalg.norm(turn_between(pose.rotations, body.pose.rotations), axis=1)).max() < 0.006
    assert np.allclose(body.pose.trans, pose.trans, atol=1e-6) and np.allclose(body.place, place, atol=1e-6)
    assert (body.key, body.frame_id, body.at, body.t, body.you) == (7, 2**32 - 1, 12345.678, None, False)
    assert body.sha256 == SHA.hex() and abs(body.opacity - 0.5) < 0.003
    for name in ARKIT:
        assert abs(pose.expression.get(name, 0) - body.pose.expression.get(name, 0)) <= 0.51 / 255
    if stretched:
        assert body.pose.translations is not None and pose.translations is not None
        assert np.allclose(body.pose.translations, pose.translations, atol=1e-7)
    mine = unpack_bodies(bytes((1,)) + for_recipient(packed, True, 0.2))[0]
    assert mine.you and abs(mine.opacity - 0.2) < 0.003 and for_recipient(packed, False, 0.5) is packed


def test_a_body_that_its_size_cannot_count_is_refused() -> None:
    with pytest.raises(PoseError, match="a pose of 12000 joints is too long for the wire"):
        pack_body(glsplat.Pose(np.zeros((12000, 3))), SHA, AT_ORIGIN, at=0.0, t=None)


def test_two_people_are_below_a_kilobyte_each_and_skipped_by_their_size() -> None:
    packed = [pack_body(someone(i), SHA, AT_ORIGIN, at=i, t=i / 3, key=i) for i in (1, 2)]
    first = (len(packed[0]) + 5).to_bytes(2, "little") + packed[0][2:] + b"later"  # a version that appends
    data = pack_poses(9, {"want": "pose"}, [first, packed[1]])
    reply = parse_reply(data)
    assert [body.key for body in reply.bodies] == [1, 2] and reply.nbytes == len(data) < 2000
    assert reply.bodies[1].t == 2 / 3 and reply.pictures == {} and reply.images() == []


@pytest.mark.check
def test_damaged_replies_are_read_or_refused_in_one_line() -> None:
    rng = np.random.default_rng(11)
    bodies = [pack_body(someone(i, 55, i == 2), SHA, AT_ORIGIN, at=i, t=i) for i in (1, 2)]
    whole = pack_poses(3, {"want": "pose", "room": {"people": []}}, bodies)
    for size in range(0, len(whole), 3):
        with pytest.raises(ProtocolError):
            parse_reply(whole[:size])
    read = 0
    for round_ in range(3000):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(0, 256)
        if round_ % 3 == 0:
            data += rng.bytes(rng.integers(0, 9))
        try:
            parse_reply(bytes(data))
            read += 1
        except ProtocolError as error:
            assert "\n" not in str(error) and len(str(error)) < 300
    assert 300 < read < 2700


@pytest.mark.parametrize(
    ("at", "value"),
    [
        (12, b"\x00\x00\x00\x00\x00\x00\xf0\x7f"),  # at: infinity
        (64, b"\x00\x00\xc0\x7f"),  # place: NaN
        (76, b"\x00\x00\x00\x00" * 4),  # no rotation
        (92, b"\x00\x00\x00\x00"),  # scale 0
        (92, b"\x00\x00\x80\xbf"),  # scale -1
        (96, b"\xff\xff\x7f\x7f"),  # 3e38 m away
        (108, bytes(8)),  # a joint without a rotation
        (30, b"\xff\xff"),  # joints
        (30, b"\x00\x00"),
        (0, b"\x10\x00"),
    ],
)
def test_what_is_no_body_is_refused(at: int, value: bytes) -> None:
    packed = bytearray(pack_body(someone(1), SHA, AT_ORIGIN, at=1, t=1))
    packed[at : at + len(value)] = value
    with pytest.raises(ProtocolError):
        unpack_bodies(bytes((1,)) + bytes(packed))
