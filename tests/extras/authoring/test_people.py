"""The person archive and the mesh it holds."""

import io
import struct
import zipfile
import zlib

import cv2
import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.raster import mesh_picture, mesh_picture_and_depth, visible_faces
from glsplat.extras.formats.person import read_person
from glsplat.extras.formats.texture import decode_texture
from glsplat.meshes import MeshPart, RiggedMesh


def png(pixels) -> np.ndarray:
    ok, data = cv2.imencode(".png", cv2.cvtColor(np.asarray(pixels, np.uint8), cv2.COLOR_RGBA2BGRA))
    assert ok
    return data.reshape(-1)


def archive(**changes):
    """A square of one metre in the plane z = 0, its upper half bound to a second joint; None drops a key."""
    texture = np.zeros((2, 2, 4), np.uint8)
    texture[0, 0], texture[0, 1] = (255, 0, 0, 255), (0, 255, 0, 255)  # upper row: v near 1
    texture[1, 0], texture[1, 1] = (0, 0, 255, 255), (255, 255, 255, 255)
    data = {
        "vertices": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
        "joints": np.array([[0, 0, 0], [0, 1, 0]], np.float32),
        "parents": np.array([-1, 0], np.int8),
        "joint_names": np.array(["base", "top"]),
        "skin_indices": np.array([[0, 1]] * 4, np.uint8),
        "skin_weights": np.array([[1, 0], [1, 0], [0, 1], [0, 1]], np.float16),
        "part_names": np.array(["square"]),
        "faces_0": np.array([[0, 1, 2], [0, 2, 3]], np.uint16),
        "faces_uv_0": np.array([[0, 1, 2], [0, 2, 3]], np.uint16),
        "uv_0": np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32),
        "texture_0": png(texture),
    }
    data.update(changes)
    return {key: value for key, value in data.items() if value is not None}


@pytest.fixture
def square(tmp_path) -> RiggedMesh:
    np.savez(tmp_path / "p.npz", **archive())
    return read_person(tmp_path / "p.npz")


def test_v_axis_points_up(square):
    uv = np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]])
    rgb = square.parts[0].sample(uv)[:, :3]
    assert rgb == pytest.approx(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]]))
    assert square.parts[0].sample(np.array([[0.5, 0.5]]))[0, :3] == pytest.approx([0.5, 0.5, 0.5], abs=1e-9)
    assert square.parts[0].sample(uv + [3, -2]) == pytest.approx(square.parts[0].sample(uv))


def test_picture_matches_the_geometry(square):
    """The square seen head on fills a known box, each texel where it belongs."""
    camera = Camera(look_at((0.5, 0.5, 2), (0.5, 0.5, 0)), pinhole(40, 40, 2 * np.degrees(np.arctan(0.5))), 40, 40)
    ids, bary = visible_faces(square, square.vertices, camera)
    assert (ids >= 0).sum() == 400 and (ids[10:30, 10:30] >= 0).all()
    at = np.einsum("nk,nkc->nc", bary[15, 12][None], square.vertices[square.faces[ids[15, 12]]][None])[0]
    assert at == pytest.approx([2.5 / 20, 1 - 5.5 / 20, 0])
    picture = mesh_picture(square, square.vertices, camera, supersample=2)
    assert picture[12, 12] == pytest.approx([1, 0, 0, 1], abs=1e-6)
    assert picture[27, 12] == pytest.approx([0, 0, 1, 1], abs=1e-6)
    assert picture[5, 5].tolist() == [0, 0, 0, 0]
    tilted = square.vertices + square.vertices[:, :1] * (0, 0, 0.5)  # nearer to the right
    _, depth = mesh_picture_and_depth(square, tilted, camera, supersample=2)
    assert np.isinf(depth[5, 5]) and 1.9 < depth[20, 12] < 2.0 and 1.55 < depth[20, 29] < 1.7


def test_nearer_triangles_win_and_holes_let_through(square):
    far = square.vertices - (0, 0, 0.5)
    both = np.concatenate([square.vertices, far])
    hole = np.full((2, 2, 4), 255, np.uint8)
    hole[0, :, 3] = 0  # upper half transparent
    front = MeshPart("front", square.parts[0].faces, square.parts[0].uv, hole)
    back = MeshPart("back", square.parts[0].faces + 4, square.parts[0].uv, np.full((2, 2, 4), 99, np.uint8) | 128)
    mesh = RiggedMesh(both, square.skeleton, np.zeros((8, 1), int), np.ones((8, 1)), (back, front))
    camera = Camera(look_at((0.5, 0.5, 2), (0.5, 0.5, 0)), pinhole(40, 40, 60), 40, 40)
    ids, _ = visible_faces(mesh, both, camera)
    assert front.cutout and not back.cutout
    assert set(ids[24:28, 18:22].ravel()) <= {2, 3} and set(ids[14:17, 18:22].ravel()) <= {0, 1}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"vertices": None}, ["vertices"]),
        ({"part_names": np.array(["a", "b"])}, ["faces_1"]),
        ({"part_names": np.array([], "U1")}, ["triangle"]),
        ({"faces_0": np.array([[0, 1, 9], [0, 1, 2]], np.uint16)}, ["square", "9 of 4"]),
        ({"faces_uv_0": np.array([[0, 1, 9], [0, 1, 2]], np.uint16)}, ["faces_uv_0"]),
        ({"skin_indices": np.array([[0, 7]] * 4)}, ["joint 7 of 2"]),
        ({"skin_weights": np.ones((3, 2))}, ["joints and weights"]),
        ({"vertices": np.full((4, 3), np.nan)}, ["finite"]),
        ({"parents": np.array([1, 0])}, ["root"]),
        ({"texture_0": np.arange(20, dtype=np.uint8)}, ["texture_0", "JPEG, PNG or WebP"]),
        ({"joints": np.array([["a", "b", "c"]] * 2)}, ["needs an array of numbers"]),
    ],
)
def test_wrong_archives(tmp_path, changes, words):
    path = tmp_path / "bad.npz"
    np.savez(path, **archive(**changes))
    with pytest.raises(FormatError) as caught:
        read_person(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    for word in words:
        assert word in message, message


def test_files_that_are_no_archives(tmp_path):
    whole = io.BytesIO()
    np.savez(whole, **archive())
    pickled = io.BytesIO()
    np.savez(pickled, vertices=np.array([{}], object), allow_pickle=True)
    for name, data in {
        "cut.npz": whole.getvalue()[:300],
        "text.npz": b"hello",
        "empty.npz": b"",
        "pickled.npz": pickled.getvalue(),
    }.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FormatError, match=name):
            read_person(tmp_path / name)
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(FormatError, match=r"one\.npy"):
        read_person(tmp_path / "one.npy")
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as zipped:
        zipped.writestr("readme.txt", "nothing")
    with pytest.raises(FormatError, match=r"zip\.npz"):
        read_person(tmp_path / "zip.npz")
    with pytest.raises(FormatError, match="absent"):
        read_person(tmp_path / "absent.npz")


def test_webp_and_damage_without_a_word(capfd):
    """Of damage there is one line, ours: the libraries write theirs to standard error."""
    picture = np.random.default_rng(0).integers(0, 255, (40, 50, 3), np.uint8)
    found = decode_texture(cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes(), "x")
    assert np.array_equal(found[..., 2::-1], picture) and (found[..., 3] == 255).all()
    for kind in (".png", ".jpg", ".webp"):
        data = cv2.imencode(kind, picture)[1].tobytes()
        for at in range(30, len(data), 97):
            for broken in (data[:at], data[:at] + bytes([data[at] ^ 255]) + data[at + 1 :]):
                try:
                    assert decode_texture(broken, "x").shape[2] == 4
                except FormatError as error:
                    assert str(error).startswith("x: ") and "\n" not in str(error)
    assert capfd.readouterr() == ("", "")


def claiming(width: int, height: int) -> bytes:
    """A small PNG whose header speaks of another size."""
    data = bytearray(cv2.imencode(".png", np.zeros((3, 4, 3), np.uint8))[1].tobytes())
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    return bytes(data)


def test_textures_that_no_graphics_card_takes():
    for width, height in ((40_000, 40_000), (16_385, 1), (1, 30_000), (2**31 - 1, 2**31 - 1)):
        with pytest.raises(FormatError, match=f"x: a texture has at most 16384 pixels a side, .* {width} x {height}"):
            decode_texture(claiming(width, height), "x")
    long = cv2.imencode(".jpg", np.zeros((8, 20_000, 3), np.uint8))[1]
    with pytest.raises(FormatError, match="16384 pixels a side, this one 20000 x 8"):
        decode_texture(long.tobytes(), "x")
    bitmap = bytearray(cv2.imencode(".bmp", np.zeros((2, 2, 3), np.uint8))[1].tobytes())
    bitmap[18:26] = struct.pack("<ii", 60_000, 60_000)
    for odd in (bytes(bitmap), np.zeros((3, 3), np.uint8), np.zeros(9, np.float32), b"\xff\xd8", b"\x89PNG"):
        with pytest.raises(FormatError, match="x: a texture is"):
            decode_texture(odd, "x")
