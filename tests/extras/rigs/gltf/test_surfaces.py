"""What colours a surface: factors, textures turned and cut, colours of vertices; strips, fans and morph targets."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import load
from glsplat.meshes import RiggedMesh
from glsplat.pictures import to_linear, to_srgb
from tests.formats.scenes import glb_arrays, write_glb

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")  # v down: the picture upright
RNG = np.random.default_rng(2)
PICTURE = RNG.integers(0, 256, (8, 8, 4)).astype(np.uint8)


def square(
    tmp_path: Path,
    material: dict[str, Any] | None = None,
    mode: int = 4,
    indices: tuple[int, ...] = (0, 1, 2, 0, 2, 3),
    texture: dict[str, Any] | None = None,
    kind: str = ".png",
    mesh: dict[str, Any] | None = None,
    uri: str | None = None,
    **attributes: np.ndarray,
) -> RiggedMesh:
    """A square of two triangles in a file, read."""
    arrays = {"POSITION": CORNERS, "TEXCOORD_0": UV, **attributes}
    accessors, views, blob = glb_arrays(*arrays.values(), np.array(indices, "<u2")[:, None])
    for accessor in accessors[:-1]:
        accessor["normalized"] = accessor["componentType"] != 5126
    named = {name: place for place, name in enumerate([*arrays, "indices"])}
    primitive: dict[str, Any] = {"indices": named.pop("indices"), "mode": mode, "material": 0}
    targets = [{"POSITION": named.pop(name)} for name in list(named) if name.startswith("target")]
    if targets:
        primitive["targets"] = targets
    how = [cv2.IMWRITE_WEBP_QUALITY, 101] if kind == ".webp" else []
    image = cv2.imencode(kind, cv2.cvtColor(PICTURE, cv2.COLOR_RGBA2BGRA), how)[1].tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive | {"attributes": named}], **(mesh or {})}],
        "materials": [material or {}],
        "textures": [{"source": 0} if texture is None else texture],
        "images": [{"uri": uri or "data:image/png;base64," + base64.b64encode(image).decode()}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    (tmp_path / "a b+é.png").write_bytes(image)
    path = tmp_path / "square.glb"
    write_glb(path, document, blob)
    return load(path)


def seen(mesh: RiggedMesh, x: float, y: float) -> np.ndarray:
    """RGBA in [0, 1] at a point of the square."""
    part = mesh.parts[0]
    for face, uv in zip(part.faces, part.uv, strict=True):
        corners = mesh.vertices[face][:, :2]
        shares = np.linalg.solve(np.vstack([corners.T, np.ones(3)]), [x, y, 1])
        if shares.min() > -1e-9:
            return part.sample(shares @ uv)
    raise AssertionError("no triangle is there")


TEXTURED = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
TEXELS = [(0.3125, 0.8125), (0.8125, 0.4375), (0.4375, 0.1875)]  # centres of texels


def texel(x: float, y: float) -> np.ndarray:
    return PICTURE[int((1 - y) * 8), int(x * 8)] / 255


@pytest.mark.parametrize(
    ("kind", "texture"), [(".png", None), (".webp", {"extensions": {"EXT_texture_webp": {"source": 0}}})]
)
def test_a_picture_stands_upright(tmp_path: Path, kind: str, texture: dict[str, Any] | None) -> None:
    mesh = square(tmp_path, TEXTURED, kind=kind, texture=texture)
    for x, y in TEXELS:
        assert seen(mesh, x, y)[:3] == pytest.approx(texel(x, y)[:3], abs=1e-9)
        assert seen(mesh, x, y)[3] == 1  # opaque, whatever the picture's alpha


def test_a_factor_is_linear(tmp_path: Path) -> None:
    factor = [0.5, 0.25, 1.0, 1.0]
    base = {"baseColorTexture": {"index": 0}, "baseColorFactor": factor}
    mesh = square(tmp_path, {"pbrMetallicRoughness": base})
    for x, y in TEXELS:
        wanted = to_srgb(to_linear(texel(x, y)[:3]) * factor[:3])
        assert seen(mesh, x, y)[:3] == pytest.approx(wanted, abs=0.003)
    plain = square(tmp_path, {"pbrMetallicRoughness": {"baseColorFactor": factor}})
    assert seen(plain, 0.4, 0.6)[:3] == pytest.approx(to_srgb(np.array(factor[:3])), abs=0.003)


@pytest.mark.parametrize("cut", [0.25, 0.5, 0.9])
def test_a_mask_is_cut_where_it_says(tmp_path: Path, cut: float) -> None:
    mesh = square(tmp_path, TEXTURED | {"alphaMode": "MASK", "alphaCutoff": cut})
    for x, y in [(i / 8 + 1 / 16, j / 8 + 1 / 16) for i in range(8) for j in range(8)]:
        if x > y:  # of the first triangle
            assert (seen(mesh, x, y)[3] >= 0.5) == (texel(x, y)[3] >= cut), (x, y)


def test_a_turned_texture_by_hand(tmp_path: Path) -> None:
    """At (0.5, 0.25) with v down: scaled by 2 (1, 0.5), by 30 degrees (0.866 + 0.25, -0.5 + 0.433), offset.

    As three.js has it, whose uv matrix is (s c, s sin; -s sin, s c) for one scale of both.
    """
    turn = {"offset": [0.1, 0.2], "rotation": np.pi / 6, "scale": [2, 2]}
    used = {"index": 0, "extensions": {"KHR_texture_transform": turn}}
    uv = np.full((4, 2), (0.5, 0.25), "<f4")
    mesh = square(tmp_path, {"pbrMetallicRoughness": {"baseColorTexture": used}}, TEXCOORD_0=uv)
    assert mesh.parts[0].uv[0, 0] == pytest.approx([1.2160254, 1 - 0.1330127], abs=1e-6)


def test_the_set_of_coordinates_that_a_transform_names(tmp_path: Path) -> None:
    used = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    mesh = square(tmp_path, {"pbrMetallicRoughness": {"baseColorTexture": used}}, TEXCOORD_1=UV / 2)
    assert mesh.parts[0].uv[0] == pytest.approx(np.array([[0, 0.5], [0.5, 0.5], [0.5, 1]]))


def test_pictures_beside_the_file(tmp_path: Path) -> None:
    """Their names are those of addresses: a blank is %20, any other letter its bytes of UTF-8."""
    mesh = square(tmp_path, TEXTURED, uri="a%20b+%C3%A9.png")
    for x, y in TEXELS:
        assert seen(mesh, x, y)[:3] == pytest.approx(texel(x, y)[:3], abs=1e-9)


@pytest.mark.parametrize("textured", [False, True])
def test_colours_of_vertices(tmp_path: Path, textured: bool) -> None:
    colours = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]], np.uint8)
    mesh = square(tmp_path, TEXTURED if textured else None, COLOR_0=colours)
    for x, y, shares in ((0.6, 0.3, (0.4, 0.3, 0.3, 0)), (0.2, 0.7, (0.3, 0, 0.2, 0.5)), (1.0, 0.0, (0, 1, 0, 0))):
        linear = np.array(shares) @ colours[:, :3] / 255
        if not textured:
            assert seen(mesh, x, y)[:3] == pytest.approx(to_srgb(linear), abs=0.03)
    if textured:
        assert seen(mesh, 1.0, 0.0)[[0, 2]] == pytest.approx([0, 0], abs=0.05)  # green takes the others away
        assert mesh.parts[0].texture.shape[0] > 8
    corners = [seen(mesh, *CORNERS[i, :2])[:3] for i in range(4)]
    if not textured:
        assert np.array(corners) == pytest.approx(colours[:, :3] / 255, abs=0.003)


@pytest.mark.parametrize("alpha", [0, 90, 110, 255])
@pytest.mark.parametrize("mode", ["OPAQUE", "MASK", "BLEND"])
def test_alpha_of_vertices_counts_where_the_material_asks_for_it(tmp_path: Path, mode: str, alpha: int) -> None:
    """glTF 2.0, 3.9.4: alpha is factor times texture times vertex, then cut; of what is opaque it is ignored."""
    colours = np.array([[255, 128, 0, alpha]] * 4, np.uint8)
    material = {"alphaMode": mode, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.8]}}
    material |= {"alphaCutoff": 0.3} if mode == "MASK" else {}
    mesh = square(tmp_path, material, COLOR_0=colours)
    cut = {"OPAQUE": -1.0, "MASK": 0.3, "BLEND": 0.5}[mode]
    assert (seen(mesh, 0.6, 0.3)[3] >= 0.5) == (0.8 * alpha / 255 >= cut)


@pytest.mark.parametrize(("mode", "indices"), [(5, (0, 1, 3, 2)), (6, (0, 1, 2, 3))])
def test_strips_and_fans(tmp_path: Path, mode: int, indices: tuple[int, ...]) -> None:
    mesh = square(tmp_path, mode=mode, indices=indices)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2] == pytest.approx([1, 1])  # both face the same way and cover the square


def test_morph_targets_at_their_default_weights(tmp_path: Path) -> None:
    target = np.array([[0, 0, 1], [0, 0, 2], [0, 0, 3], [0, 0, 4]], "<f4")
    still = square(tmp_path, target_0=target)
    assert still.vertices == pytest.approx(CORNERS)
    moved = square(tmp_path, target_0=target, target_1=10 * target, mesh={"weights": [0.5, 0.1]})
    assert moved.vertices == pytest.approx(CORNERS + 1.5 * target)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"material": TEXTURED, "texture": {"extensions": {"KHR_texture_basisu": {"source": 0}}}}, "ktxdecompress"),
        ({"material": {"pbrMetallicRoughness": {"baseColorFactor": [1, 2]}}}, "material 0 is malformed"),
        ({"material": {"pbrMetallicRoughness": 3}}, "material 0 is malformed"),
        ({"material": TEXTURED, "uri": "../a.png"}, "lies outside"),
        ({"material": TEXTURED, "uri": "%2e%2e/a.png"}, "lies outside"),
        ({"material": TEXTURED, "uri": "a%00.png"}, "is not the path of a file"),
        ({"material": TEXTURED, "uri": "data:image/png;base64,AAAA"}, "JPEG, PNG or WebP"),
        ({"indices": (0, 1, 9)}, "name 9"),
        ({"indices": (0, 1)}, "whole triangles"),
        ({"COLOR_0": np.full((3, 4), 255, np.uint8)}, "COLOR_0 needs 4"),
        ({"target_0": np.zeros((3, 3), "<f4"), "mesh": {"weights": [1.0]}}, "morph target needs 4"),
        ({"TEXCOORD_0": UV[:3]}, "TEXCOORD_0 needs 4"),
    ],
)
def test_what_is_refused(tmp_path: Path, how: dict[str, Any], words: str) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        square(tmp_path, **how)
    assert "\n" not in str(caught.value) and "square.glb" in str(caught.value)
