"""Avatars that are handed out, read in the page: the numbers that Python reads, good pictures, and no lie believed."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Item, Pose, Scene
from glsplat.extras.browser.web_format.read import HEAD, decode_avatar
from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.formats.motion_files import load_motion
from glsplat.renderer.levels import Proxy, chosen
from glsplat.skinning.expression import ARKIT
from tests.browser.draw.conftest import Bench, floats, posed
from tests.browser.draw.test_parity import eyes, psnr, thing, truth
from tests.extras.browser.web_format.test_web import someone, with_face
from tests.light.lit import surfaced

READ = "([name, piece]) => import('/vr/test/page.js').then((m) => m.decoded(name, piece))"
PICTURE = "(question) => import('/vr/test/page.js').then((m) => m.crowdPicture(question))"


def array(level: dict[str, str], name: str, kind: Any) -> np.ndarray:
    return np.frombuffer(base64.b64decode(level[name]), kind)


def same(level: dict[str, str], avatar: Avatar) -> None:
    """Float for float, to the last bit or two of a 32-bit float (exp and sqrt are each library's own)."""
    splats, skin = avatar.splats, avatar.skin
    pairs = {"means": splats.means, "quats": splats.quats, "scales": splats.scales, "opacities": splats.opacities}
    for name, expected in {**pairs, "sh": splats.sh, "weights": skin.weights}.items():
        found = array(level, name, np.float32)
        assert np.allclose(found, expected.ravel(), rtol=2e-6, atol=2e-7), name
    assert np.array_equal(array(level, "joints", np.uint16), skin.joints.ravel())


def test_a_handed_out_person_comes_coarsest_first_and_looks_as_the_exact_one(bench: Bench) -> None:
    """What quantising costs, together with another context: at least 60 dB."""
    person = glsplat.default_avatar()
    data = encode_avatar(person)
    bench.data["person"] = data
    found = bench.js(READ, ["person", 1 << 15])
    expected = decode_avatar(data)
    assert found["order"] == 3 * [3, 0, 1, 2]  # the splats of each, then their shapes, then their surfaces
    for number, avatar in enumerate([expected, *(level.content for level in expected.levels)]):
        same(found["levels"][str(number)], avatar)
    pose = load_motion("wave-and-turn", person.skeleton).at(2.11)
    cameras = eyes((-0.7, 1.3, 2.4), (0, 0.95, 0))
    name = bench.offer("read", expected)
    found = bench.pictures(cameras, things=[name], poses=[thing(pose)], kinds=["32f"])
    assert psnr(found["32f"], truth(Scene([Item(person, pose=pose)]), cameras)) >= 60


def eye_of(camera: glsplat.Camera) -> dict[str, Any]:
    """As WebXR has it, of a camera whose principal point may be anywhere."""
    (fx, _, cx), (_, fy, cy), _ = camera.K
    w, h = camera.width, camera.height
    transform = np.linalg.inv(np.diag([1.0, -1, -1, 1]) @ camera.viewmat)
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = 2 * fx / w, 2 * fy / h
    projection[0, 2], projection[1, 2] = 1 - 2 * cx / w, 2 * cy / h - 1
    projection[2, 2], projection[2, 3], projection[3, 2] = -1.001, -0.1, -1
    matrices = {"transform": transform.T.ravel().tolist(), "projection": projection.T.ravel().tolist()}
    return {**matrices, "width": w, "height": h}


def test_a_crowd_draws_the_level_that_the_desktop_chooses(bench: Bench) -> None:
    """By a camera of a headset's kind, off axis; far away a coarser level; without the head where it is one's own."""
    bench.data["person"] = encode_avatar(glsplat.default_avatar())
    person = decode_avatar(bench.data["person"])
    pose = load_motion("walk", person.skeleton).at(0.4)
    densities = [level.density for level in person.levels]
    for distance, hidden in ((2.0, True), (4.5, False), (9.0, False)):
        centred = eyes((0.3, 1.2, distance), (0, 1, 0))[0]
        K = centred.K.copy()
        K[:2, 2] += 31.5, -12.25
        camera = replace(centred, K=K)
        level = chosen(densities, Proxy.of(person).density(camera, bones=pose.bones(person.skeleton)))
        content = person if level == 0 else person.levels[level - 1].content
        content = content.without("head") if hidden else content
        found = bench.js(PICTURE, {"name": "person", "pose": posed(pose), "camera": eye_of(camera), "headless": hidden})
        assert found["drawn"] == len(content.splats)
        like(found, truth(Scene([Item(replace(content, levels=()), pose=pose)]), [camera])[0], 90)


def like(found: dict[str, Any], expected: np.ndarray, least: float) -> None:
    """At least that many dB in the layer; what is shown is rounded once."""
    assert found["error"] == 0 and psnr(floats(found["floats"]).reshape(expected.shape)[::-1], expected) >= least
    canvas = np.frombuffer(base64.b64decode(found["canvas"]), np.uint8).reshape(expected.shape)[::-1]
    assert psnr(canvas / np.float32(255), expected.clip(0, 1)) >= 55


def test_an_expression_on_the_wire_moves_the_face(bench: Bench) -> None:
    bench.data["face"] = encode_avatar(with_face(someone(900, seed=77)))
    camera = eyes((0.3, 0.4, 3.2), (0, 0, 0))[0]
    weights = np.zeros(52)
    weights[ARKIT.index("jawOpen")] = 0.7
    pose = Pose(np.zeros((20, 3)), (0, 0, 0), expression={"jawOpen": 0.7})
    asked = {"name": "face", "pose": posed(pose), "camera": eye_of(camera), "expression": weights.tolist()}
    like(bench.js(PICTURE, asked), truth(Scene([Item(decode_avatar(bench.data["face"]), pose=pose)]), [camera])[0], 90)


@pytest.mark.parametrize("surface", [False, True])
def test_damaged_and_lying_files_are_refused_in_one_sentence(bench: Bench, surface: bool) -> None:
    avatar = with_face(someone(300, int(not surface), 4, 12, seed=9))
    bench.data["some"] = encode_avatar(surfaced(avatar) if surface else avatar)
    found = bench.js(
        "(seed) => import('/vr/test/page.js').then((m) => m.fuzzed('some', 900, seed))", 20261125 + surface
    )
    assert found["other"] == []
    assert len(found["refused"]) > 20 and found["read"] < 300
    assert all(len(words) < 160 and "\n" not in words for words in found["refused"])


def with_header(data: bytes, **changes: Any) -> bytes:
    """The same file whose header says something else, unpacked sizes and all."""
    _, _, _, packed, _ = HEAD.unpack_from(data)
    header = json.loads(zlib.decompress(data[HEAD.size : HEAD.size + packed], -15))
    for path, value in changes.items():
        *keys, last = path.split("__")
        at = header
        for key in keys:
            at = at[int(key) if key.isdigit() else key]
        at[last] = value
    text = json.dumps(header).encode()
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    head = packer.compress(text) + packer.flush()
    return HEAD.pack(b"GSAV", 1, 0, len(head), len(text)) + head + data[HEAD.size + packed :]


LIES = [
    ({"parts__0__splats": 2**21}, "unpack to"),
    ({"parts__0__splats": 7}, "unpack to more than"),
    ({"joints__parents": [1, 0, *range(1, 11)]}, "form a cycle"),
    ({"parts__0__offset": 3}, "does not follow the previous one"),
    ({"parts__0__low": [0, 0, 1e300]}, "without a box"),
    ({"influences": 3}, "influences that are not"),
    ({"joints__rest": [0.0] * 144}, "not invertible"),
    ({"shapes__limits": [0.5, 1, 0, 1, 0, 1]}, "do not include 0"),
]
SURFACE_LIES = [
    ({"parts__1__shaded": False}, "unpack to more than"),
    ({"parts__1__shaded": 1}, "shaded that is not"),
    ({"parts__1__level": 3}, "a surface without splats"),
    ({"parts__1__kind": "light"}, "nor their surface"),
]


def test_a_lie_and_its_sentence(bench: Bench) -> None:
    face, lit = with_face(someone(400, 1, 4, 12, seed=9)), surfaced(someone(300, seed=5))
    for avatar, lies in ((face, LIES), (lit, SURFACE_LIES)):
        for changes, words in lies:
            bench.data["liar"] = with_header(encode_avatar(avatar), **changes)
            said = bench.js("""async () => {
              const { decoded } = await import('/vr/test/page.js');
              return decoded('liar', 1 << 16).then(() => 'believed', (error) => `${error.name}: ${error.message}`);
            }""")
            assert said.startswith("BlobError: ") and words in said, changes
