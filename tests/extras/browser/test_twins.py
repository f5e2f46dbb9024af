"""What the page computes to draw an avatar by itself (web/draw, web/avatar, web/stream), and its twins in Python."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import glsplat
from glsplat.extras.browser.web_format.read import decode_avatar
from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.light import Light
from glsplat.net.codec.body import AT_ORIGIN, pack_body, placement_of
from glsplat.net.reply import pack_poses, parse_reply
from glsplat.renderer.levels import Proxy, chosen
from glsplat.scene import similarity
from glsplat.skinning.expression import ARKIT
from tests.extras.browser.web_format.test_web import someone, with_face
from tests.light.lit import random_light, surfaced
from tests.twins import Twin, both_sides, text_of

SHA = bytes(range(32, 64))


def rig(seed: int, joints: int = 6) -> dict[str, Any]:
    """Return a skeleton as Skeleton of bones.js takes it, 12 numbers a joint, row by row."""
    skeleton = someone(8, joints=joints, seed=seed).skeleton
    return {
        "names": list(skeleton.names),
        "parents": skeleton.parents.tolist(),
        "rest": skeleton.rest[:, :3].ravel().tolist(),
        "inverseBind": skeleton.inverse_bind[:, :3].ravel().tolist(),
    }


def bones(rig: dict[str, Any], vectors: list[float], root: list[float], translations: list[float] | None) -> Any:
    """Return skinning matrices [J, 12] of a pose: rotation vectors [3 J], root and translations [3 J] in metres."""
    four = np.tile(np.eye(4), (2, len(rig["parents"]), 1, 1))
    four[:, :, :3] = np.reshape([rig["rest"], rig["inverseBind"]], (2, -1, 3, 4))
    skeleton = glsplat.Skeleton(rig["names"], rig["parents"], four[0], four[1])
    moved = None if translations is None else np.reshape(translations, (-1, 3))
    return skeleton.bone_matrices(np.reshape(vectors, (-1, 3)), np.array(root), moved).ravel()


def poses() -> list[dict[str, Any]]:
    rng = np.random.default_rng(6)
    return [
        {
            "rig": rig(seed),
            "vectors": rng.normal(0, 1.2, 18).tolist(),
            "root": rng.normal(size=3).tolist(),
            "translations": rng.normal(0, 0.1, 18).tolist() if seed else None,
        }
        for seed in range(3)
    ]


def level(densities: list[float], wanted: float, before: int | None) -> int:
    """Return the level of detail for a view."""
    return chosen(densities, wanted, before)


def limits() -> list[dict[str, Any]]:
    wanted = [1, 199, 200, 205, 209, 211, 300, 385, 405, 419, 421, 900]
    return [{"densities": [800, 400, 200], "wanted": w, "before": b} for w in wanted for b in (None, 0, 1, 2, 3)]


def density(file: str, camera: dict[str, Any], vectors: list[float], root: list[float]) -> float:
    """Return pixels per metre at which a camera (of a camera file) shows an avatar (its file, in base64) in a pose."""
    avatar = decode_avatar(base64.b64decode(file))
    bones = avatar.skeleton.bone_matrices(np.reshape(vectors, (-1, 3)), np.array(root), None)
    K = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]])
    seen = glsplat.Camera(np.array(camera["w2c"]), K, camera["width"], camera["height"])
    return Proxy.of(avatar).density(seen, bones=bones)


def sights() -> list[dict[str, Any]]:
    rng, out = np.random.default_rng(9), []
    file = text_of(encode_avatar(someone(120, joints=5, seed=2)))
    for eye in ((0.0, 0.0, 3.0), (0.2, 0.1, 0.4), (0.0, 9.0, 20.0), (0.0, 0.0, -0.5)):
        w2c = glsplat.look_at(eye, (0.3, 0.2, -1.0)).tolist()
        K = {"fx": 420.0, "fy": 410.0, "cx": 300.5, "cy": 210.25}
        pose = {"vectors": rng.normal(0, 0.4, 15).tolist(), "root": [0.1, 0.0, -0.2]}
        out.append({"file": file, "camera": {"w2c": w2c, **K, "width": 640, "height": 480}, **pose})
    return out


def expressed(file: str, expression: list[float]) -> dict[str, Any]:
    """Return what the GPU reads of an expression of ARKit's order, and the means of the splats of an avatar then."""
    avatar = decode_avatar(base64.b64decode(file))
    shapes = avatar.shapes
    assert shapes is not None
    weights = shapes.weights(dict(zip(ARKIT, expression, strict=True)))
    if weights is None:
        return {"amounts": None, "means": None}
    means = avatar.splats.means.astype(np.float64)
    np.add.at(means, shapes.rows, shapes.metres * weights[shapes.targets, None])
    return {"amounts": shapes.amounts(weights).ravel(), "means": means.ravel()}


def faces() -> list[dict[str, Any]]:
    rng = np.random.default_rng(3)
    file = text_of(encode_avatar(with_face(someone(60))))
    return [{"file": file, "expression": face.tolist()} for face in (np.zeros(52), *rng.uniform(-1, 2, (2, 52)))]


def avatar(file: str) -> dict[str, Any]:
    """Return the finest splats of an avatar's file."""
    found = decode_avatar(base64.b64decode(file))
    splats, surface = found.splats, found.splats.surface
    arrays = {"means": splats.means, "quats": splats.quats, "scales": splats.scales, "opacities": splats.opacities}
    return {
        "joints": list(found.skeleton.names),
        "shapes": [] if found.shapes is None else list(found.shapes.names),
        **{name: array.ravel() for name, array in arrays.items()},
        "sh": splats.sh.ravel(),
        "bound": found.skin.joints.ravel(),
        "weights": found.skin.weights.ravel(),
        "texels": None if found.shapes is None else found.shapes.texels().ravel(),
        "normals": None if surface is None else surface.normals.ravel(),
        "occlusion": None if surface is None else surface.occlusion,
        "shade": None if surface is None or surface.shade is None else surface.shade.ravel(),
    }


def files() -> list[dict[str, str]]:
    avatars = [someone(40, 0), someone(20, 3, 8, 260), with_face(surfaced(someone(40, 0, 2), shaded=True))]
    return [{"file": text_of(encode_avatar(one))} for one in avatars]


def uniforms(light: dict[str, Any]) -> NDArray[np.float32]:
    """Return light.glsl's uniforms."""
    return Light.from_json(light).uniforms().ravel()


def lights() -> list[dict[str, Any]]:
    return [{"light": {"sun": None, **random_light(seed, sun=seed > 3).to_json()}} for seed in (3, 4, 5)]


def bodies(reply: str) -> list[dict[str, Any]]:
    """Return the bodies of a reply in poses. Rotations are matrices, a quaternion has two signs."""
    out = []
    for one in parse_reply(base64.b64decode(reply)).bodies:
        pose = one.pose
        out.append({
            "head": [one.key, one.you, one.frame_id, one.at, one.t, one.sha256],
            "opacity": one.opacity,
            "place": one.place[:3].ravel(),
            "root": pose.trans,
            "joints": glsplat.rotations.rotation_matrices(pose.rotations).ravel(),
            "expression": None if not pose.expression else [pose.expression.get(name, 0) for name in ARKIT],
            "translations": None if pose.translations is None else pose.translations.ravel(),
        })  # fmt: skip
    return out


def replies() -> list[dict[str, str]]:
    rng = np.random.default_rng(12)

    def pose(face: bool, stretched: bool) -> glsplat.Pose:
        moved = rng.normal(size=(55, 3)) if stretched else None
        weights = rng.uniform(0, 1, 52) if face else None
        return glsplat.Pose(rng.normal(0, 1, (55, 3)), rng.normal(size=3), moved, weights)

    place = placement_of(similarity((1, 2, 3), (0.5, -0.1, 0.2, 0.8), 1.2))
    packed = [
        pack_body(pose(True, False), SHA, place, at=1e9 + 0.25, t=None, key=3, frame_id=2**32 - 1, opacity=0.2),
        pack_body(pose(False, True), SHA, AT_ORIGIN, at=2, t=7.5, key=2**32 - 1, you=True),
    ]
    return [{"reply": text_of(pack_poses(12, {"want": "pose", "driven_by": "Änne"}, some))} for some in (packed, [])]


TWINS = {
    "bones": Twin(bones, poses),
    "level": Twin(level, limits, 0),
    "density": Twin(density, sights, 1e-6),
    "expressed": Twin(expressed, faces, 1e-6),
    "avatar": Twin(avatar, files, 2e-6),
    "uniforms": Twin(uniforms, lights, 1e-6),
    "bodies": Twin(bodies, replies, 1e-5),
}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS)
