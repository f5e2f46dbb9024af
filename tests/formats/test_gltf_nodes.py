"""glTF of other writers: node transforms, drafts of the extension, quantised and external buffers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats.gltf.splats import save_gltf
from glsplat.reference import evaluate_sh, quaternion_matrices
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import assert_equal, awkward_splats, edit_glb, glb_parts, load_gltf, random_splats, write_glb

KHR = "KHR_gaussian_splatting"


# --- node transforms ------------------------------------------------------------------------------------------------


def placed(tmp_path: Path, splats: Splats, **node: Any) -> Splats:
    save_gltf(splats, tmp_path / "n.glb")
    edit_glb(tmp_path / "n.glb", lambda d: d["nodes"][0].update(node))
    out = load_gltf(tmp_path / "n.glb")
    assert isinstance(out, Splats)
    return out


def covariance(splats: Splats) -> np.ndarray:
    shapes = quaternion_matrices(splats.quats) * splats.scales[:, None, :].astype(float)
    return shapes @ shapes.transpose(0, 2, 1)


TURN = np.array(quaternion_matrices(np.array([[0.5, 0.1, -0.7, 0.3]]))[0])
MATRICES = {
    "turned, scaled, moved": 2.5 * TURN,
    "stretched": TURN @ np.diag([3.0, 0.5, 1.0]),
    "sheared": np.array([[1.0, 0.8, 0.0], [0.0, 1.0, 0.3], [0.2, 0.0, 1.0]]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]) @ TURN,
}


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("degree", [0, 3])
def test_node_matrix(tmp_path: Path, name: str, degree: int) -> None:
    splats, linear = random_splats(40, degree), MATRICES[name]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, (1, -2, 3)
    out = placed(tmp_path, splats, matrix=matrix.T.reshape(-1).tolist())
    np.testing.assert_allclose(out.means, splats.means @ linear.T + (1, -2, 3), atol=2e-6)
    expected = linear @ covariance(splats) @ linear.T
    np.testing.assert_allclose(covariance(out), expected, atol=3e-6 * np.abs(expected).max())
    np.testing.assert_allclose(np.linalg.norm(out.quats, axis=1), 1, atol=1e-6)
    # what was seen along d in the node's frame is seen along the turned d in the world
    left, _, right = np.linalg.svd(linear)
    d = np.random.default_rng(1).normal(size=(40, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    colours = evaluate_sh(splats.sh.astype(float), d, degree)
    np.testing.assert_allclose(evaluate_sh(out.sh.astype(float), d @ (left @ right).T, degree), colours, atol=1e-5)


def test_hierarchy_of_trs_nodes_and_two_instances(tmp_path: Path) -> None:
    splats = random_splats(20)
    save_gltf(splats, tmp_path / "a.glb")

    def nest(document: dict[str, Any]) -> None:
        document["nodes"] = [
            {"mesh": 0, "translation": [1, 0, 0]},
            {"children": [0, 2], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]},
            {"mesh": 0},
            {"mesh": 0, "name": "not in the scene"},
        ]
        document["scenes"] = [{"nodes": [1]}]

    edit_glb(tmp_path / "a.glb", nest)
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats) and len(out) == 40
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(out.means[:20], 2 * (splats.means + np.array([1, 0, 0])) @ quarter.T, atol=2e-6)
    np.testing.assert_allclose(out.means[20:], 2 * splats.means @ quarter.T, atol=2e-6)
    np.testing.assert_allclose(out.scales[:20], 2 * splats.scales, rtol=1e-6)


def test_awkward_values_under_a_node_do_not_spread(tmp_path: Path) -> None:
    for linear in (2 * TURN, MATRICES["sheared"]):
        matrix = np.eye(4)
        matrix[:3, :3] = linear
        out = placed(tmp_path, awkward_splats(), matrix=matrix.T.reshape(-1).tolist())
        np.testing.assert_array_equal(np.isfinite(out.means).all(axis=1), [0, 0, *[1] * 8])
        shaped = np.isfinite(out.quats).all(axis=1) & np.isfinite(out.scales).all(axis=1)
        np.testing.assert_array_equal(shaped, [1, 1, 1, 0, 1, 1, 0, 1, 1, 1])


def test_singular_node_is_refused(tmp_path: Path) -> None:
    for node in ({"scale": [1, 0, 1]}, {"scale": [1e308, 1e308, 1e308], "translation": [1e308, 0, 0]}):
        if node["scale"][1]:
            placed(tmp_path, random_splats(3), **node)  # absurd, but invertible
            continue
        with pytest.raises(FormatError, match="can be inverted"):
            placed(tmp_path, random_splats(3), **node)


# --- other writers --------------------------------------------------------------------------------------------------


def raw_file(
    path: Path, attributes: dict[str, tuple[np.ndarray, int, bool]], extension: dict[str, Any] | None = None
) -> None:
    """A GLB as another program would write it: interleaved nothing, one view an attribute."""
    blob, views, accessors, names = b"", [], [], {}
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    for name, (array, component, normalized) in attributes.items():
        data = np.ascontiguousarray(array).tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        names[name] = len(accessors)
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array),
                          "type": kinds[array.shape[1]], "normalized": normalized})  # fmt: skip
        blob += data + bytes(-len(data) % 4)
    primitive = {"mode": 0, "attributes": names, "extensions": {KHR: extension or {}}}
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(blob)}], "bufferViews": views,
                "accessors": accessors, "meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}],
                "scenes": [{"nodes": [0]}]}  # fmt: skip
    write_glb(path, document, blob)


def test_first_drafts_with_underscores_and_colour(tmp_path: Path) -> None:
    splats = random_splats(20)
    rgba = np.clip(np.c_[splats.sh[:, 0] * SH_C0 + 0.5, splats.opacities] * 255, 0, 255).round().astype(np.uint8)
    raw_file(tmp_path / "a.glb", {
        "POSITION": (splats.means, 5126, False),
        "_ROTATION": (splats.quats[:, [1, 2, 3, 0]], 5126, False),
        "_SCALE": (splats.scales, 5126, False),
        "COLOR_0": (rgba, 5121, True),
    })  # fmt: skip
    out = load_gltf(tmp_path / "a.glb")
    np.testing.assert_array_equal(out.quats, splats.quats)
    np.testing.assert_array_equal(out.scales, splats.scales)
    np.testing.assert_allclose(out.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(out.sh[:, 0] * SH_C0 + 0.5, rgba[:, :3] / 255, atol=1e-6)


def test_quantised_attributes(tmp_path: Path) -> None:
    splats = random_splats(20)
    quats = np.round(splats.quats[:, [1, 2, 3, 0]] * 32767).astype("<i2")
    raw_file(tmp_path / "a.glb", {
        "POSITION": (np.arange(60).reshape(20, 3).astype("<i2"), 5122, False),
        f"{KHR}:ROTATION": (quats, 5122, True),
        f"{KHR}:SCALE": (np.full((20, 3), 7, "<u2"), 5123, False),
        f"{KHR}:OPACITY": (np.arange(0, 240, 12)[:, None].astype("u1"), 5121, True),
        f"{KHR}:SH_DEGREE_0_COEF_0": (splats.sh[:, 0], 5126, False),
    }, {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"})  # fmt: skip
    # one byte an opacity is legal in a buffer of its own
    out = load_gltf(tmp_path / "a.glb")
    assert out.means[3].tolist() == [9, 10, 11] and (out.scales == 7).all()
    np.testing.assert_allclose(out.opacities, np.arange(0, 240, 12) / 255, atol=1e-7)
    np.testing.assert_allclose(out.quats, splats.quats, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(out.quats, axis=1), 1, atol=1e-6)


def test_review_draft_with_logarithmic_scales(tmp_path: Path) -> None:
    splats = random_splats(20)
    attributes = {
        "POSITION": (splats.means, 5126, False),
        f"{KHR}:ROTATION": (splats.quats[:, [1, 2, 3, 0]], 5126, False),
        f"{KHR}:SCALE": (np.log(splats.scales), 5126, False),
        f"{KHR}:OPACITY": (splats.opacities[:, None], 5126, False),
        f"{KHR}:SH_DEGREE_0_COEF_0": (splats.sh[:, 0], 5126, False),
    }
    raw_file(tmp_path / "a.glb", attributes)
    out = load_gltf(tmp_path / "a.glb")
    np.testing.assert_allclose(out.scales, splats.scales, rtol=1e-6)


def test_interleaved_buffer_view(tmp_path: Path) -> None:
    splats = random_splats(20)
    table = np.hstack(
        [splats.means, splats.scales, splats.quats[:, [1, 2, 3, 0]], splats.opacities[:, None], splats.sh[:, 0]]
    )
    offsets = {"POSITION": (0, "VEC3"), f"{KHR}:SCALE": (12, "VEC3"), f"{KHR}:ROTATION": (24, "VEC4"),
               f"{KHR}:OPACITY": (40, "SCALAR"), f"{KHR}:SH_DEGREE_0_COEF_0": (44, "VEC3")}  # fmt: skip
    blob = table.astype("<f4").tobytes()
    primitive = {"mode": 0, "attributes": {n: i for i, n in enumerate(offsets)}, "extensions": {KHR: {}}}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(blob)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(blob), "byteStride": 56}],
        "accessors": [{"bufferView": 0, "byteOffset": at, "componentType": 5126, "count": 20, "type": kind}
                      for at, kind in offsets.values()],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
    }  # fmt: skip
    write_glb(tmp_path / "a.glb", document, blob)
    out = load_gltf(tmp_path / "a.glb")
    assert isinstance(out, Splats)
    assert_equal(out, splats)


def test_external_buffer_beside_the_file(tmp_path: Path) -> None:
    splats = random_splats()
    save_gltf(splats, tmp_path / "a.glb")
    document, blob = glb_parts((tmp_path / "a.glb").read_bytes())
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "data.bin").write_bytes(blob)
    document["buffers"][0]["uri"] = "sub%20dir/data.bin"
    write_glb(tmp_path / "b.glb", document, b"")
    out = load_gltf(tmp_path / "b.glb")
    assert isinstance(out, Splats)
    assert_equal(out, splats)


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "%2e%2e/secret.bin", "/etc/passwd", "file:///etc/passwd", "link.bin", "..\\secret.bin",
     "sub/../../secret.bin", "http://example.org/x.bin"],
)  # fmt: skip
def test_no_buffer_outside_the_folder(tmp_path: Path, uri: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    save_gltf(random_splats(), inner / "a.glb")
    document, blob = glb_parts((inner / "a.glb").read_bytes())
    (tmp_path / "secret.bin").write_bytes(blob)
    (inner / "link.bin").symlink_to(tmp_path / "secret.bin")
    document["buffers"][0]["uri"] = uri
    write_glb(inner / "a.glb", document, b"")
    with pytest.raises(FormatError, match="outside the file's own folder"):
        load_gltf(inner / "a.glb")
