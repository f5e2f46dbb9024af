"""``glsplat avatar``: make, import, export, motions; and the avatar that comes with the package."""

import json
import time
from pathlib import Path

import glsplat_apps.cli as cli
import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar, default_avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.formats import load
from glsplat.skinning.people import read_person
from glsplat.skinning.pose import Pose
from glsplat.skinning.posed import posed_splats
from glsplat.skinning.raster import mesh_picture
from glsplat.skinning.splat_gradients import footprints
from glsplat.splats import SH_C0

DATA = Path(cli.__file__).parents[1] / "glsplat" / "data"


def psnr(difference) -> float:
    return float(-10 * np.log10(np.mean(difference**2)))


def test_default_avatar_file():
    path = DATA / "default_avatar.glb"
    assert path.stat().st_size <= 4e6
    began = time.perf_counter()
    avatar = load(path)
    assert time.perf_counter() - began < 0.3
    assert isinstance(avatar, Avatar) and 39_000 <= len(avatar.splats) <= 41_000
    assert avatar.splats.sh_degree == 0 and avatar.skin.influences == 4
    assert avatar.splats.finite().all() and avatar.splats.scales.min() > 0
    assert {"version", "source", "licence", "consent", "body_model"} <= set(avatar.meta)
    low, high = np.percentile(avatar.splats.means, (0.1, 99.9), axis=0)
    assert low[1] == pytest.approx(0, abs=0.02) and 1.6 < high[1] < 2.0
    assert avatar.skeleton.joints[avatar.skeleton.names.index("left_wrist"), 0] > 0.5
    strongest = avatar.skin.joints[:, 0]
    for side, wrist in (("left", 20), ("right", 21)):
        fingers = [i for i, name in enumerate(avatar.skeleton.names) if name.startswith(f"{side}_") and i >= 25]
        assert np.isin(strongest, [wrist, *fingers]).sum() >= 3500
    licence = (DATA / "LICENSE-default-avatar.md").read_text()
    assert "CC0" in licence and "MakeHuman system assets, CC0 since 2020-09" in " ".join(licence.split())


@pytest.mark.shared
def test_default_avatar_looks_like_its_mesh(shared_data):
    """Full body at 512 pixels against the textured mesh: PSNR >= 30 dB over the body's box; hands >= 24 dB."""
    mesh, avatar = read_person(shared_data / "people" / "char_c_registry.npz"), default_avatar()
    pose, bend = Pose.zero(), 0.4
    index = {name: i for i, name in enumerate(mesh.skeleton.names)}
    for side, sign in (("left", 1), ("right", -1)):
        pose.rotations[index[f"{side}_shoulder"]] = (0, 0, -sign)
        pose.rotations[index[f"{side}_elbow"]] = (0, -sign * bend, 0)
        pose.rotations[index[f"{side}_hip"]] = (-sign * bend, 0, 0.1 * sign)
        pose.rotations[index[f"{side}_knee"]] = (bend, 0, 0)
    vertices, splats = mesh.posed(pose), posed_splats(avatar, pose)
    hand = vertices[np.isin(mesh.joints[:, 0], [20, *range(25, 40)])].mean(axis=0)
    rgb = np.maximum(splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0)
    for eye, target, fov, least in (
        ((0.4, 1, 3.0), (0, 0.93, 0), 37, 30),
        ((1.2, 1.3, -2.7), (0, 0.93, 0), 37, 30),
        (hand + (0.2, 0.15, 0.6), hand, 24, 24),
    ):
        camera = Camera(look_at(eye, target), pinhole(512, 512, fov), 512, 512)
        picture = footprints(
            splats.means.astype(np.float64),
            reference.quaternion_matrices(splats.quats),
            splats.scales.astype(np.float64),
            splats.opacities.astype(np.float64),
            camera,
        ).picture(rgb)
        wanted = mesh_picture(mesh, vertices, camera, 2)
        rows, columns = np.nonzero(wanted[..., 3] > 0)
        box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        assert psnr((np.clip(picture, 0, 1) - wanted)[box][..., :3]) >= least


@pytest.fixture(scope="module")
def person(tmp_path_factory) -> Path:
    """A striped box with two joints."""
    import cv2
    import trimesh

    box = trimesh.creation.box((0.4, 1.0, 0.2)).subdivide().subdivide()
    points, faces = np.asarray(box.vertices) + (0, 0.5, 0), np.asarray(box.faces)
    texture = np.zeros((16, 16, 3), np.uint8)
    texture[::2] = (60, 180, 240)
    path = tmp_path_factory.mktemp("person") / "box.npz"
    np.savez(
        path,
        vertices=points.astype(np.float32),
        joints=np.array([[0, 0, 0], [0, 0.5, 0]], np.float32),
        parents=np.array([-1, 0]),
        joint_names=np.array(["low", "high"]),
        skin_indices=np.tile([0, 1], (len(points), 1)).astype(np.uint8),
        skin_weights=np.stack([1 - points[:, 1], points[:, 1]], 1).astype(np.float32),
        part_names=np.array(["box"]),
        faces_0=faces.astype(np.uint16),
        faces_uv_0=faces.astype(np.uint16),
        uv_0=points[:, :2].astype(np.float32) + (0.2, 0),
        texture_0=cv2.imencode(".png", texture)[1].reshape(-1),
    )
    return path


def test_make_import_export(person, tmp_path, capsys):
    out = tmp_path / "a.glb"
    words = ["avatar", "make", str(person), "-o", str(out), "--splats", "200", "--steps", "2", "--json"]
    assert cli.main([*words, "--licence", "CC0-1.0"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    first = out.read_bytes()
    assert facts["splats"] == 200 and facts["bytes"] == len(first)
    assert cli.main([*words, "--licence", "CC0-1.0"]) == 0 and out.read_bytes() == first
    avatar = load(out)
    assert avatar.meta["licence"] == "CC0-1.0" and avatar.meta["source"] == "box.npz"

    (tmp_path / "pose.json").write_text('{"joints": {"high": [0, 0, 1.0]}, "trans": [0, 0, 0.5]}')
    ply = tmp_path / "posed.ply"
    assert cli.main(["avatar", "export", str(out), "--pose", str(tmp_path / "pose.json"), "-o", str(ply)]) == 0
    assert load(ply).means[:, 2].mean() == pytest.approx(0.5, abs=0.02)

    zero, bound = tmp_path / "zero.ply", tmp_path / "bound.glb"
    assert cli.main(["avatar", "export", str(out), "-o", str(zero)]) == 0
    assert cli.main(["avatar", "import", str(zero), "--mesh", str(person), "-o", str(bound)]) == 0
    assert load(bound).skin.dense(2) == pytest.approx(avatar.skin.dense(2), abs=0.1)


def test_motions(tmp_path, capsys):
    assert cli.main(["avatar", "motions", "-o", str(tmp_path)]) == 0
    for name in ("idle", "walk", "wave-and-turn"):
        assert (tmp_path / f"{name}.json").read_bytes() == (DATA / f"{name}.json").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["make", "absent.npz", "-o", "a.glb"], "absent.npz: cannot read"),
        (["make", "{person}", "-o", "a.ply"], "written as .glb"),
        (["make", "{person}", "-o", "a.glb", "--steps", "-1"], "--steps"),
        (["make", "{person}", "-o", "a.glb", "--splats", "3"], "at least 100"),
        (["import", "{person}", "-o", "a.glb"], "an LHM dump needs query_points"),
        (["import", "{person}", "--mesh", "{person}", "-o", "a.glb"], "box.npz"),
        (["export", "{person}", "-o", "a.ply"], "box.npz"),
        (["export", "{avatar}", "--pose", "nonsense", "-o", "a.ply"], "nonsense: no such file"),
        (["export", "{avatar}", "--pose", "idle", "--at", "nan", "-o", "a.ply"], "--at"),
    ],
)
def test_mistakes_are_one_line(person, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    places = {"{person}": str(person), "{avatar}": str(DATA / "default_avatar.glb")}
    assert cli.main(["avatar", *(places.get(word, word) for word in words)]) == 1
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error
    assert not list(tmp_path.iterdir())
