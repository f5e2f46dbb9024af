"""LAM zips: splats attached to the vertices of a skinned mesh."""

import json
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glsplat.errors import FormatError
from glsplat.extras.authoring.importers import lam
from glsplat.extras.authoring.importers.lam import FOLLOW_MODES, is_lam_zip, load_lam_zip
from glsplat.formats.gltf import morphs
from glsplat.formats.ply import save_ply
from glsplat.splats import SH_C0, Splats
from tests.formats.scenes import glb_arrays, glb_of
from tests.formats.test_fuzz import json_values, places

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0.5]])
WEIGHTS = np.array([[1, 0], [0.75, 0.25], [0.25, 0.75], [0, 1.0]])
ORDER = [2, 0, 3, 1]  # a permutation, as in real files, where it is an order for drawing
SMILE = {1: [0.01, 0, 0], 3: [0, 0.02, -0.01]}  # offsets by vertex; BLINK is stored densely
BLINK = np.array([[0, 0, 0], [0, 0, 0], [0, -0.003, 0], [0, 0, 0]], "<f4")


def skin_glb(change=lambda document: None) -> bytes:
    """Two triangles on two joints, the second a metre above the first, and two morph targets, one of them sparse."""
    accessors, views, binary = glb_arrays(
        VERTICES.astype("<f4"),
        np.tile([0, 1, 0, 0], (4, 1)).astype("u1"),
        np.pad(WEIGHTS, ((0, 0), (0, 2))).astype("<f4"),
        np.array([[0], [1], [2], [0], [2], [3]], "<u2"),
        BLINK,
        np.array(list(SMILE), "<u2")[:, None],
        np.array(list(SMILE.values()), "<f4"),
    )
    del accessors[5:]
    sparse = {"count": 2, "indices": {"bufferView": 5, "componentType": 5123}, "values": {"bufferView": 6}}
    accessors.append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    primitive = {
        "attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2},
        "indices": 3,
        "targets": [{"POSITION": 5}, {"POSITION": 4}],
    }
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"mesh": 0, "skin": 0},
            {"name": "neck", "children": [2]},
            {"name": "head", "translation": [0, 1, 0]},
        ],
        "meshes": [{"primitives": [primitive], "extras": {"targetNames": ["mouthSmileLeft", "eyeBlinkLeft"]}}],
        "skins": [{"joints": [1, 2]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    change(document)
    return glb_of(document, binary)


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
    """Return a function that writes a zip; changes replace members by name, None drops one."""

    def write(changes=None, folder="", splats=None, extra=()):
        save_ply(splats or offsets, tmp_path / "offset.ply")
        members = {
            "offset.ply": (tmp_path / "offset.ply").read_bytes(),
            "skin.glb": skin_glb(),
            "vertex_order.json": json.dumps(ORDER).encode(),
            "animation.glb": b"ignored",
            "bsData.json": b'{"names": [], "metadata": {}, "frames": []}',
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


def test_splat_i_belongs_to_vertex_i(packed, offsets):
    """vertex_order.json is a permutation and is not read."""
    avatar = load_lam_zip(packed(folder="arkitWithBSData/"))
    assert avatar.splats.means == pytest.approx(VERTICES + offsets.means, abs=1e-6)
    assert avatar.skin.dense(2) == pytest.approx(WEIGHTS, abs=1e-6)
    assert avatar.skeleton.names == ("neck", "head") and avatar.skeleton.joints[1].tolist() == [0, 1, 0]
    assert avatar.splats.sh[:, 0] * SH_C0 + 0.5 == pytest.approx(offsets.sh[:, 0], abs=1e-6)  # RGB as it is
    assert avatar.splats.scales == pytest.approx(offsets.scales, rel=1e-5)
    assert avatar.splats.opacities == pytest.approx(offsets.opacities, rel=1e-5)
    assert np.abs((avatar.splats.quats * offsets.quats).sum(axis=1)) == pytest.approx(1, abs=1e-6)
    assert avatar.meta["source"] == "LAM, lam.zip"


def test_follow_head_binds_all_splats_to_the_head(packed, offsets):
    avatar = load_lam_zip(packed(), follow="head")
    assert avatar.skin.dense(2).tolist() == [[0, 1]] * 4
    assert avatar.splats.means == pytest.approx(VERTICES + offsets.means, abs=1e-6)
    skin = skin_glb(lambda document: document["nodes"][2].update(name="skull"))
    assert load_lam_zip(packed({"skin.glb": skin})).skeleton.names == ("neck", "skull")
    refused(packed({"skin.glb": skin}), 'no joint called "head"', follow="head")


def test_morph_targets_become_shapes(packed):
    shapes = load_lam_zip(packed()).shapes
    assert shapes.names == ("mouthSmileLeft", "eyeBlinkLeft")
    assert shapes.rows.tolist() == [1, 2, 3] and shapes.targets.tolist() == [0, 1, 0]
    assert shapes.metres == pytest.approx(np.array([SMILE[1], BLINK[2], SMILE[3]]), abs=1e-6)
    assert not shapes.bends.any()

    def unnamed(document):
        document["meshes"][0]["extras"] = {"targetNames": ["one"]}
        document["meshes"][0]["primitives"][0]["targets"].append({"NORMAL": 4})

    again = load_lam_zip(packed({"skin.glb": skin_glb(unnamed)})).shapes
    assert again.names == ("target_0", "target_1", "target_2") and again.targets.tolist() == [0, 1, 0]

    def none(document):
        del document["meshes"][0]["primitives"][0]["targets"], document["meshes"][0]["extras"]

    assert load_lam_zip(packed({"skin.glb": skin_glb(none)})).shapes is None


def sparse(**values):
    def change(document):
        accessor = document["accessors"][5]
        for key, value in values.items():
            (accessor if key in ("count", "type") else accessor["sparse"])[key.removeprefix("sparse_")] = value

    return change


def many(document):
    document["meshes"][0]["primitives"][0]["targets"] *= 1000


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (sparse(count=5), ["morph target 0 needs 4 offsets", "not 5"]),
        (sparse(sparse_count=2**40), ["truncated", "morph target 0"]),
        (sparse(sparse_count=-1), ["morph target 0 is a broken sparse accessor"]),
        (sparse(indices={"bufferView": 99, "componentType": 5123}), ["morph target 0", "bufferView"]),
        (sparse(indices={"bufferView": 6, "componentType": 5126}), ["morph target 0 needs indices"]),
        (sparse(indices={"bufferView": 6, "componentType": 5123}), ["morph target 0 needs indices"]),
        (sparse(values={"bufferView": 0, "byteOffset": 40}), ["truncated", "morph target 0 values"]),
        (sparse(type="SCALAR"), ["morph target 0 values needs type VEC3"]),
        (lambda document: document["accessors"][5].update(sparse=[]), ["morph target 0 is a broken sparse accessor"]),
        (many, ["at most 1024 morph targets, this one 2000"]),
    ],
)
def test_hostile_morph_targets(packed, change, words):
    refused(packed({"skin.glb": skin_glb(change)}), *words)


def test_shared_offsets_stay_bounded(packed, monkeypatch):
    """Targets may name one accessor many times: their total is bounded too."""
    monkeypatch.setattr(morphs, "_MAX_ROWS", 100)

    def shared(document):
        document["meshes"][0]["primitives"][0]["targets"] *= 100

    refused(packed({"skin.glb": skin_glb(shared)}), "move more than 100 vertices")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"offset.ply": None}, ["needs the member offset.ply", "skin.glb"]),
        ({"skin.glb": None}, ["needs the member skin.glb"]),
        ({"offset.ply": b"hello"}, ["offset.ply: not a PLY"]),
        ({"skin.glb": b"glTF nonsense"}, ["skin.glb: "]),
        ({"skin.glb": skin_glb(lambda d: d["nodes"][0].pop("skin"))}, ["skin.glb: splats ride triangles with a skin"]),
        ({"skin.glb": skin_glb(lambda d: d["nodes"][0].update(mesh=7))}, ["skin.glb: the file refers to mesh 7"]),
        ({"skin.glb": skin_glb().replace(b"\0\0\x80\x3f", b"\0\0\xc0\x7f", 1)}, ["POSITION needs finite numbers"]),
    ],
)
def test_wrong_members(packed, changes, words):
    refused(packed(changes), *words)


def refused(path, *words, **options):
    with pytest.raises(FormatError) as caught:
        load_lam_zip(path, **options)
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
    far = np.full_like(offsets.means, 3e19)  # its square is beyond float32
    refused(packed(splats=changed(means=far)), "offsets from the mesh", "5.2e+19 m")
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

    bomb = packed({"skin.glb": b" " * ((1 << 20) + 1)})
    assert bomb.stat().st_size < 1 << 14
    monkeypatch.setattr(lam, "_MAX_MEMBER_BYTES", 1 << 20)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("unpacked"))
    refused(bomb, "skin.glb", "1 MiB")
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


@settings(database=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_mutated_members(packed, data):
    """Any bytes, any JSON: an avatar, or one line that names the zip."""
    skin, changes = skin_glb(), {}
    if data.draw(st.booleans(), "the JSON"):

        def change(document):
            for _ in range(data.draw(st.integers(1, 3))):
                *steps, last = data.draw(st.sampled_from(places(document)))
                target = document
                for step in steps:
                    target = target[step]
                target[last] = data.draw(json_values)

        skin = skin_glb(change)
    for name, content in (("skin.glb", skin), ("offset.ply", None)):
        content = bytearray(content or zipfile.ZipFile(packed()).read("offset.ply"))
        for _ in range(data.draw(st.integers(0, 3), name)):
            at = data.draw(st.integers(0, len(content)))
            content[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
        changes[name] = bytes(content)
    path = packed(changes)
    tracemalloc.start()
    try:
        avatar = load_lam_zip(path, follow=data.draw(st.sampled_from(FOLLOW_MODES)))
        assert avatar.shapes is None or avatar.shapes.splats == len(avatar.splats)
    except FormatError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error) and "glsplat-" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 8_000_000
