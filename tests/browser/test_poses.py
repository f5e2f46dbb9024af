"""stream/pose.js: it refuses what Python refuses, and shows people between two samples."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat.errors import ProtocolError
from glsplat.net.codec.body import AT_ORIGIN, pack_body
from glsplat.net.reply import pack_poses, parse_reply
from glsplat.rotations import slerp, vector_quaternions
from glsplat.skinning.expression import ARKIT
from tests.browser.flat_page import flat_page

MAIN = """
import { People, parsePoses } from '/vr/stream/pose.js';
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const plain = (value) => JSON.parse(JSON.stringify(value, (_, v) => (ArrayBuffer.isView(v) ? [...v] : v)));
const read = (text) => plain(parsePoses(bytes(text)));
const verdict = (text) => {
  try {
    parsePoses(bytes(text));
    return '';
  } catch (error) {
    return error.constructor === Error && !error.message.includes('\\n') ? error.message : `WRONG: ${error.stack}`;
  }
};
Object.assign(window, { People, parsePoses, bytes, plain, read, verdict });
"""
SHA = bytes(range(32, 64))


@pytest.fixture(scope="module")
def page(chromium: Any) -> Any:
    with flat_page(chromium, MAIN, "window.People") as page:
        yield page


def text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def pose(seed: int, face: bool = True, stretched: bool = False) -> glsplat.Pose:
    rng = np.random.default_rng(seed)
    return glsplat.Pose(
        rng.normal(0, 1, (55, 3)),
        rng.normal(size=3),
        rng.normal(size=(55, 3)) if stretched else None,
        rng.uniform(0, 1, 52) if face else None,
    )


def reply(*bodies: bytes, number: int = 1, **info: Any) -> str:
    return text(pack_poses(number, {"want": "pose", **info}, bodies))


def test_it_refuses_what_python_refuses_in_one_sentence(page: Any) -> None:
    """1,500 damaged replies, all cuts, and junk. Bodies: the same verdict. Elsewhere JSON may be read differently."""
    rng = np.random.default_rng(12)
    packed = [pack_body(pose(i, stretched=i == 2), SHA, AT_ORIGIN, at=i, t=i, key=i) for i in (1, 2)]
    whole = pack_poses(3, {"want": "pose"}, packed)
    first = len(pack_poses(3, {"want": "pose"}, ()))
    cases = [whole[:size] for size in range(0, len(whole), 7)] + [rng.bytes(n) for n in range(0, 400, 3)]
    cases += [b"VR\x01\x00" + rng.bytes(n) for n in range(100)]
    same = len(cases)
    for _ in range(1500 - same):
        data = bytearray(whole)
        for at in rng.integers(first - 1, len(data), rng.integers(1, 5)):
            data[at] = rng.integers(0, 256)
        cases.append(bytes(data))
    said = page.evaluate("(all) => all.map(verdict)", [text(case) for case in cases])
    assert not [one for one in said if one.startswith("WRONG")]
    for number, (case, verdict) in enumerate(zip(cases, said, strict=True)):
        try:
            parse_reply(case)
            assert not verdict or number < same, verdict
        except ProtocolError as error:
            assert verdict, error
    assert 150 < said.count("") < 1350
    header = [bytearray(whole) for _ in range(300)]
    for data in header:
        for at in rng.integers(0, first, 3):
            data[at] = rng.integers(0, 256)
    said = page.evaluate("(all) => all.map(verdict)", [text(bytes(one)) for one in header])
    assert not [one for one in said if one.startswith("WRONG")]


def test_others_are_shown_between_their_samples_and_oneself_at_the_newest(page: Any) -> None:
    """Against slerp in Python; the server's clock is another one, and the network jitters by 15 ms."""
    people = [{"key": key, "you": key == 1} for key in (1, 2)]
    poses = [pose(i, face=i % 2 == 0) for i in range(8)]
    rng = np.random.default_rng(5)
    sent = []
    for i, one in enumerate(poses):
        at = 777_000 + 50 * i + rng.uniform(0, 15)  # when it came, of what was sampled each 50 ms
        bodies = [
            pack_body(one, SHA, AT_ORIGIN, at=at, t=10 + 50 * i, key=key, frame_id=i + 1, you=key == 1)
            for key in (1, 2)
        ]
        room = {"room": {"people": people}} if i == 0 else {}
        sent.append((reply(*bodies, number=i + 1, now=at + 1, **room), 5000 + 50 * i + 20 + rng.uniform(0, 10)))
    found = page.evaluate(
        """(sent) => {
          const people = new People();
          for (const [text, now] of sent) people.arrived(parsePoses(bytes(text)), now);
          return [5300, 5324.5, 5350, 5362, 5379, 9000].map((now) => plain(people.at(now)));
        }""",
        sent,
    )
    ages = []
    for bodies in found:
        mine, other = bodies
        assert mine["you"] and np.allclose(mine["root"], poses[-1].trans, atol=1e-5)
        # where in the motion is it, by the root; then every joint has to agree
        root = np.array(other["root"])
        best = None
        for i in range(7):
            step = poses[i + 1].trans - poses[i].trans
            part = float((root - poses[i].trans) @ step / (step @ step))
            if -1e-6 <= part <= 1 + 1e-6 and np.allclose(poses[i].trans + part * step, root, atol=1e-4):
                best = i, part
        assert best is not None
        i, part = best
        wanted = vector_quaternions(slerp(poses[i].rotations, poses[i + 1].rotations, part))
        got = np.array(other["joints"]).reshape(55, 4)[:, (3, 0, 1, 2)]
        assert np.abs((wanted * got).sum(axis=1)).min() > 1 - 2e-5
        ages.append((i + part, other["age"]))
    moments = [moment for moment, _ in ages]
    assert moments == sorted(moments) and moments[0] < 6 and moments[-1] > 6.9999
    steps = np.diff(moments[:4]) / np.diff([5300, 5324.5, 5350, 5362])
    assert np.allclose(steps, 1 / 50, rtol=0.02)  # evenly, whatever the network did
    assert all(50 <= age <= 60 for _, age in ages[:4]) and ages[-1][1] > 3000


def test_a_mouth_does_not_wait_as_the_rest_of_a_body_does(page: Any) -> None:
    jaw, blink = ARKIT.index("jawOpen"), ARKIT.index("eyeBlinkLeft")
    faces = [{}, {}, {}, {"jawOpen": 1.0, "eyeBlinkLeft": 1.0}, {"eyeBlinkLeft": 1.0}, {}]
    sent = []
    for i, face in enumerate(faces):
        one = glsplat.Pose(np.zeros((55, 3)), (float(i), 0, 0), expression=face)
        body = pack_body(one, SHA, AT_ORIGIN, at=900 + 100 * i, t=100 * i, key=2, frame_id=i + 1)
        room = {"room": {"people": [{"key": 2, "you": False}]}} if i == 0 else {}
        sent.append((reply(body, number=i + 1, now=901 + 100 * i, **room), 5000 + 100 * i))
    found = page.evaluate(
        """([sent, wanted]) => {
          const people = new People();
          return sent.flatMap(([text, came]) => {
            people.arrived(parsePoses(bytes(text)), came);
            return [came + 10, came + 90].map((now) => {
              const [{ expression, root }] = plain(people.at(now));
              return [root[0], ...wanted.map((i) => expression?.[i] ?? 0)];
            });
          });
        }""",
        [sent, [jaw, blink]],
    )
    jaws = [opened for _, opened, _ in found]
    assert jaws == [0] * 6 + [1] * 2 + [0] * 4  # with the body that says so, both ways
    late = [i / 2 - root for i, (root, _, _) in enumerate(found)][6:]
    assert min(late) > 0.4  # samples: the rest is shown between two of them
    assert [blinks for _, _, blinks in found][6:8] == pytest.approx(
        [max(0.0, r - 2) for r, _, _ in found[6:8]], abs=0.01
    )


def test_who_left_is_forgotten_and_strangers_are_not_taken_in(page: Any) -> None:
    def body(key: int, at: float) -> bytes:
        return pack_body(pose(key % 50), SHA, AT_ORIGIN, at=at, t=None, key=key)

    there = {"room": {"people": [{"key": 1}, {"key": 2}]}}
    replies = [
        reply(body(1, 1), body(2, 1), body(9, 1), now=1, **there),
        reply(body(1, 2), now=2),
        reply(now=3, room={"people": [{"key": 2}]}),
        reply(body(1, 4), now=4),
    ]
    seen = page.evaluate(
        """(replies) => {
          const people = new People();
          return replies.map((text, i) => {
            people.arrived(parsePoses(bytes(text)), i);
            return people.at(i).map(({ key }) => key);
          });
        }""",
        replies,
    )
    assert seen == [[1, 2], [1, 2], [2], [2]]
    many = [reply(*(body(key, at) for key in range(at, at + 5)), now=at, room={"people": [{"key": at + 1}]})
            for at in range(200)]  # fmt: skip
    left = page.evaluate(
        """(replies) => {
          const people = new People();
          replies.forEach((text, i) => { people.arrived(parsePoses(bytes(text)), i); people.at(i); });
          return people.size;
        }""",
        many,
    )
    assert left == 1
