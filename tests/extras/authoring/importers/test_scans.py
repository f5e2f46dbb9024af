"""An OBJ without a rig takes joints and weights from a rigged body."""

import cv2
import numpy as np
import pytest
import trimesh

from glsplat.errors import FormatError
from glsplat.extras.authoring.importers.bind import read_obj_person
from glsplat.extras.formats.person import read_body


def body_file(path, **changes):
    """A cross of boxes 1.6 m high: trunk on joint 0, arms on joint 1 (left) and 2 (right)."""
    parts = [trimesh.creation.box((0.3, 1.6, 0.2)).apply_translation((0, 0.8, 0))]
    for sign in (1, -1):
        parts.append(trimesh.creation.box((0.6, 0.1, 0.1)).apply_translation((0.45 * sign, 1.2, 0)))
    parts = [part.subdivide().subdivide() for part in parts]
    owner = np.repeat([0, 1, 2], [len(part.vertices) for part in parts])
    whole = trimesh.util.concatenate(parts)
    data = {
        "v_template": np.asarray(whole.vertices) - (0, 0.8, 0),
        "faces": np.asarray(whole.faces),
        "joints": np.array([[0, 0, 0], [0.15, 0.4, 0], [-0.15, 0.4, 0]]),
        "parents": np.array([-1, 0, 0]),
        "joint_names": np.array(["trunk", "left", "right"]),
        "skin_indices": owner[:, None],
        "skin_weights": np.ones((len(owner), 1)),
    }
    data.update(changes)
    np.savez(path, **{key: value for key, value in data.items() if value is not None})
    return np.asarray(whole.vertices), np.asarray(whole.faces), owner


def obj(path, vertices, faces, extra=""):
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + ["vt 0.25 0.75", "vt 0.75 0.75", "vt 0.25 0.25"]
    lines += [f"f {a + 1}/1 {b + 1}/2/7 {c - len(vertices)}/-1" for a, b, c in faces]
    path.write_text(extra + "\n".join(lines))


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_weights_and_joints_follow_the_body(tmp_path, unit):
    vertices, faces, owner = body_file(tmp_path / "body.npz")
    texture = np.zeros((4, 4, 3), np.uint8)
    texture[:2, :2] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / "skin.png"), texture)
    (tmp_path / "scan.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd skin.png\n")
    obj(tmp_path / "scan.obj", (vertices + (3, 1, 2)) * unit, faces, "mtllib scan.mtl\n")
    mesh = read_obj_person(tmp_path / "scan.obj", read_body(tmp_path / "body.npz"))
    assert mesh.vertices == pytest.approx(vertices, abs=1e-5)
    assert mesh.skeleton.joints[1] == pytest.approx([0.15, 1.2, 0], abs=1e-6)
    dense = np.zeros((len(vertices), 3))
    np.add.at(dense, (np.arange(len(vertices))[:, None], mesh.joints), mesh.weights)
    away = np.abs(vertices[:, 0]) > 0.16  # where trunk and arms touch either may be nearest
    assert (dense.argmax(axis=1) == owner)[away].all()
    assert mesh.parts[0].sample(mesh.parts[0].uv[0, :1])[0, :3] == pytest.approx([1, 0, 0])
    assert mesh.parts[0].uv[0] == pytest.approx(np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25]]))


def test_other_poses_and_broken_files_are_refused(tmp_path):
    vertices, faces, _ = body_file(tmp_path / "body.npz")
    body = read_body(tmp_path / "body.npz")
    scan = tmp_path / "scan.obj"
    obj(scan, vertices[:, [1, 0, 2]], faces)  # lying
    for text, word in (
        (None, "T-pose"),
        ("", "triangles"),
        ("v 0 0 0\nv 1 x 0\n", "usable"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "element 4 of 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "finite"),
    ):
        if text is not None:
            scan.write_text(text)
        with pytest.raises(FormatError, match=word) as caught:
            read_obj_person(scan, body)
        assert str(caught.value).startswith(str(scan)) and "\n" not in str(caught.value)
    obj(scan, vertices, faces, "mtllib scan.mtl\n")
    (tmp_path / "scan.mtl").write_text("map_Kd ../elsewhere.png\n")
    with pytest.raises(FormatError, match="beside it"):
        read_obj_person(scan, body)
