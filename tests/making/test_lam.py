"""LAM zips: splats that ride the vertices of a skinned mesh."""

import json
import struct
import zipfile

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats.ply import save_ply
from glsplat.making.lam import is_lam_zip, load_lam_zip
from glsplat.splats import SH_C0, Splats

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0.5]])
WEIGHTS = np.array([[1, 0], [0.75, 0.25], [0.25, 0.75], [0, 1.0]])
ORDER = [2, 0, 3, 1]  # splat 2 rides vertex 0, and so on


def skin_glb() -> bytes:
    """Two triangles on two joints, the second a metre above the first, and a morph target that must not matter."""
    arrays = [
        (VERTICES.astype("<f4"), 5126, "VEC3"),
        (np.tile([0, 1, 0, 0], (4, 1)).astype("u1"), 5121, "VEC4"),
        (np.pad(WEIGHTS, ((0, 0), (0, 2))).astype("<f4"), 5126, "VEC4"),
        (np.array([[0], [1], [2], [0], [2], [3]], "<u2"), 5123, "SCALAR"),
        (np.full((4, 3), 9, "<f4"), 5126, "VEC3"),
    ]
    binary, views, accessors = b"", [], []
    for array, component, kind in arrays:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind})
        binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
    primitive = {
        "attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2},
        "indices": 3,
        "targets": [{"POSITION": 4}],
    }
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0}, {"name": "neck", "children": [2]}, {"name": "jaw", "translation": [0, 1, 0]}],
        "meshes": [{"primitives": [primitive]}],
        "skins": [{"joints": [1, 2]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x4E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.fixture
def offsets(rng) -> Splats:
    """Offsets of a centimetre, and plain RGB where a 3DGS PLY has SH."""
    sh = rng.random((4, 1, 3))
    return Splats.create(
        rng.normal(0, 0.01, (4, 3)),
        rng.normal(size=(4, 4)),
        rng.uniform(0.01, 0.1, (4, 3)),
        rng.uniform(0.2, 0.9, 4),
        sh,
    )


@pytest.fixture
def packed(tmp_path, offsets):
    """Writes a zip; changes replace members by name, None leaves one out."""

    def write(changes=None, folder="", splats=None, extra=()):
        save_ply(splats or offsets, tmp_path / "offset.ply")
        members = {
            "offset.ply": (tmp_path / "offset.ply").read_bytes(),
            "skin.glb": skin_glb(),
            "vertex_order.json": json.dumps(ORDER).encode(),
            "animation.glb": b"ignored",
            **(changes or {}),
        }
        with zipfile.ZipFile(tmp_path / "lam.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in members.items():
                if data is not None:
                    archive.writestr(folder + name, data)
            for name, data in extra:
                archive.writestr(name, data)
        return tmp_path / "lam.zip"

    return write


def test_each_splat_rides_its_vertex(packed, offsets):
    avatar = load_lam_zip(packed())
    vertex = [ORDER.index(splat) for splat in range(4)]
    assert vertex == [1, 3, 0, 2]
    assert avatar.splats.means == pytest.approx(VERTICES[vertex] + offsets.means, abs=1e-6)
    assert avatar.skin.dense(2) == pytest.approx(WEIGHTS[vertex], abs=1e-6)
    assert avatar.skeleton.names == ("neck", "jaw") and avatar.skeleton.joints[1].tolist() == [0, 1, 0]
    assert avatar.splats.sh[:, 0] * SH_C0 + 0.5 == pytest.approx(offsets.sh[:, 0], abs=1e-6)  # RGB as it is
    assert avatar.splats.scales == pytest.approx(offsets.scales, rel=1e-5)
    assert avatar.splats.opacities == pytest.approx(offsets.opacities, rel=1e-5)
    assert np.abs((avatar.splats.quats * offsets.quats).sum(axis=1)) == pytest.approx(1, abs=1e-6)
    assert avatar.meta["source"] == "LAM, lam.zip"


def test_a_folder_inside_and_no_order(packed, offsets):
    path = packed({"vertex_order.json": None}, folder="avatar_7/")
    assert is_lam_zip(path)
    assert load_lam_zip(path).splats.means == pytest.approx(VERTICES + offsets.means, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"offset.ply": None}, ["needs the member offset.ply", "skin.glb"]),
        ({"skin.glb": None}, ["needs the member skin.glb"]),
        ({"offset.ply": b"hello"}, ["offset.ply: not a PLY"]),
        ({"skin.glb": b"glTF nonsense"}, ["skin.glb: "]),
        ({"vertex_order.json": b"[0, 1"}, ["vertex_order.json", "JSON"]),
        ({"vertex_order.json": b"[" * 100_000}, ["vertex_order.json", "JSON"]),
        ({"vertex_order.json": b"{}"}, ["vertex_order.json", "dict"]),
        ({"vertex_order.json": b"[0, 1, 2]"}, ["vertex_order.json", "list of 3"]),
        ({"vertex_order.json": b"[0, 1, 2, 2]"}, ["vertex_order.json", "once"]),
        ({"vertex_order.json": b"[0, 1, 2, 4]"}, ["vertex_order.json", "once"]),
        ({"vertex_order.json": b"[0, 1, 2, -1]"}, ["vertex_order.json", "once"]),
        ({"vertex_order.json": b"[0, 1, 2, 3.0]"}, ["vertex_order.json", "once"]),
        ({"vertex_order.json": b"[0, true, 2, 3]"}, ["vertex_order.json", "once"]),
    ],
)
def test_wrong_members(packed, changes, words):
    refused(packed(changes), *words)


def refused(path, *words):
    with pytest.raises(FormatError) as caught:
        load_lam_zip(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message and "glsplat-" not in message, message
    for word in words:
        assert word in message, message


def test_wrong_numbers(packed, offsets):
    def changed(**values):
        now = {key: getattr(offsets, key) for key in ("means", "quats", "scales", "opacities", "sh")}
        return Splats.create(*{**now, **values}.values())

    refused(packed(splats=offsets.take(np.arange(3))), "3 splats", "4 vertices")
    refused(packed(splats=changed(sh=offsets.sh * 2 - 1)), "RGB in [0, 1]")
    refused(packed(splats=changed(means=offsets.means + VERTICES)), "offsets from the mesh", "--mesh")
    means = offsets.means.copy()
    means[1] = np.nan
    avatar = load_lam_zip(packed(splats=changed(means=means)))
    assert avatar.splats.finite().tolist() == [True, False, True, True]  # kept, as every reader keeps them


def test_hostile_zips(packed, tmp_path, monkeypatch):
    """Names are never used as paths, and sizes are checked before a byte is unpacked."""
    outside = packed(extra=[("../../evil/animation.glb", b"x"), ("/abs/other.ply", b"x")])
    before = set(tmp_path.rglob("*"))
    assert len(load_lam_zip(outside).splats) == 4
    assert set(tmp_path.rglob("*")) == before and not (tmp_path.parent / "evil").exists()
    refused(packed(extra=[("b/offset.ply", b"ply\n")]), "two members", "offset.ply")

    bomb = packed({"vertex_order.json": b" " * ((1 << 26) + 1)})
    assert bomb.stat().st_size < 1 << 20
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("unpacked"))
    refused(bomb, "vertex_order.json", "64 MiB")
    monkeypatch.undo()

    path = packed()
    data = bytearray(path.read_bytes())
    directory = data.find(b"PK\x01\x02")
    for flag, word in ((1, "encrypted"),):
        locked = bytearray(data)
        locked[directory + 8] |= flag
        path.write_bytes(locked)
        refused(path, word)
    for cut in (b"", b"PK", bytes(data[: len(data) // 2]), b"hello"):
        path.write_bytes(cut)
        refused(path)
        assert not is_lam_zip(path)
    data[60] ^= 0xFF  # inside the packed PLY
    path.write_bytes(data)
    refused(path)
    refused(tmp_path / "absent.zip", "cannot read")
    refused(tmp_path, "cannot read")
    assert not is_lam_zip(tmp_path / "absent.zip")
