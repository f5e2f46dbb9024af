"""What looks wrong in a motion is said, and mended by the correction that is named; what people do is not doubted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from apps.args import motion_of
from glsplat.errors import PoseError
from glsplat.extras.motions.corrections import Corrections, split_corrections
from glsplat.extras.motions.doubts import doubt
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.motions.exports import SIDES, Export, turned
from tests.extras.motions.test_exports import EXPORTS, posed, worst_angle

Bad = Callable[[Motion, Skeleton], Motion]
ODD = ("01", "43", "85", "139", "140")  # climbing, swinging on a bar, on their hands


def about(x: float, y: float, z: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians([x, y, z])).as_matrix()


def moved(scale: float = 1.0, up: float = 0.0) -> Bad:
    return lambda motion, _: Motion(motion.fps, motion.rotations, motion.trans * scale + [0, up, 0])


BAD: dict[str, tuple[Bad, str]] = {
    "z up, on the back": (lambda m, s: turned(m, s, about(-90, 0, 0)), "up=-z"),
    "z up, on the face": (lambda m, s: turned(m, s, about(90, 0, 0)), "up=z"),
    "x up": (lambda m, s: turned(m, s, about(0, 0, -90)), "up=x"),
    "only the body lies": (lambda m, s: turned(m, s, about(90, 0, 0), path=False), "up=z"),
    "y down": (lambda m, s: turned(m, s, about(180, 0, 0)), "up=-y"),
    "the body upside down": (lambda m, s: turned(m, s, about(0, 0, 180), path=False), "up=-y"),
    "centimetres": (moved(100), "scale=0.01"),
    "centimetres from the floor": (moved(100, 95), "scale=0.01#floor=0"),
    "inches": (moved(39.37), "scale=0.0254"),
    "floats": (moved(up=0.3), "floor=0"),
    "sunk": (moved(up=-0.3), "floor=0"),
    "back to front": (lambda m, s: turned(m, s, about(0, 180, 0), path=False), "turn=180"),
    "the way mirrored": (lambda m, s: turned(m, s, np.diag([-1.0, 1, -1]), body=False), "turn=180"),
    "sideways": (lambda m, s: turned(m, s, about(0, 90, 0), path=False), "turn=-90"),
    "ten times too fast": (lambda m, s: Motion(m.fps * 20, m.rotations, m.trans), "fps=30"),
}
# in which the way stays wrong once the body is right, which is said next
NOT_ALL = ("only the body lies", "the body upside down")


def written(path: Path, motion: Motion) -> Path:
    """As JSON poses."""
    frames = [
        {"root_pose": r[0].tolist(), "body_pose": r[1:22].tolist(), "trans": t.tolist()}
        for r, t in zip(motion.rotations, motion.trans, strict=True)
    ]
    path.write_text(json.dumps({"fps": motion.fps, "frames": frames}))
    return path


@pytest.mark.parametrize("what", BAD)
def test_what_looks_wrong_and_what_mends_it(tmp_path: Path, skeleton: Skeleton, walk: Motion, what: str) -> None:
    make, correction = BAD[what]
    path = written(tmp_path / "walk.json", make(walk, skeleton))
    line = doubt(load_motion(path, skeleton), skeleton, "walk.json")
    assert line.startswith("looks wrong: ") and line.endswith(f"write walk.json#{correction}") and "\n" not in line
    mended = load_motion(f"{path}#{correction}", skeleton)
    left = doubt(mended, skeleton, "")
    assert left == "" or what in NOT_ALL
    trunk = posed(mended, skeleton)
    assert (trunk[:, JOINT_NAMES.index("head"), 1, 3] - trunk[:, 0, 1, 3] > 0.4).all()


def test_a_bvh_that_lies_down(tmp_path: Path, skeleton: Skeleton, walk: Motion) -> None:
    """Turned by its root, the hips beginning at the origin. Who goes somewhere goes on the floor: that says what is up.

    Of who walks on the spot nothing does.
    """
    here = load_motion("walk", skeleton)
    path = tmp_path / "walk.bvh"
    for upright, says in ((walk, ""), (here, "up=z")):
        lies = turned(upright, skeleton, about(90, 0, 0))
        lies = Motion(lies.fps, lies.rotations, lies.trans - lies.trans[0] - skeleton.joints[0])
        path.write_text(Export(EXPORTS["Mixamo"].names).text(lies, skeleton))
        line = doubt(load_motion(path, skeleton), skeleton, "walk.bvh")
        assert line.endswith(f"walk.bvh#{says}") if says else not line
        mended = load_motion(f"{path}#{says}" if says else path, skeleton)
        assert doubt(mended, skeleton, "") == ""
        turns = [np.eye(4), np.diag([-1.0, 1, -1, 1])]  # who faces where is not known either
        assert min(worst_angle(turn @ posed(mended, skeleton), posed(upright, skeleton)) for turn in turns) < 0.1


def test_left_called_right(tmp_path: Path, skeleton: Skeleton, walk: Motion) -> None:
    names = EXPORTS["Mixamo"].names
    other = {f"{a}_": f"{b}_" for a, b in (SIDES, SIDES[::-1])}
    swapped = {k: names[next((k.replace(a, b, 1) for a, b in other.items() if k.startswith(a)), k)] for k in names}
    path = tmp_path / "walk.bvh"
    path.write_text(Export(swapped).text(walk, skeleton))
    assert doubt(load_motion(path, skeleton), skeleton, "w").endswith("w#sides=swapped")
    mended = load_motion(f"{path}#sides=swapped", skeleton)
    assert doubt(mended, skeleton, "") == ""
    assert worst_angle(posed(mended, skeleton), posed(walk, skeleton)) < 0.1


@pytest.mark.parametrize("name", [*embedded_motions(), "walking", "one frame"])
def test_good_motions(skeleton: Skeleton, walk: Motion, name: str) -> None:
    motion = {"walking": walk, "one frame": Motion(30, walk.rotations[:1], walk.trans[:1])}.get(name)
    assert doubt(motion or load_motion(name, skeleton), skeleton, name) == ""


@pytest.mark.check
@pytest.mark.shared
def test_captured_motions_are_not_doubted(shared_data: Path, skeleton: Skeleton) -> None:
    files = [p for p in (shared_data / "real/motions").iterdir() if p.suffix in (".bvh", ".vrma")]
    files += [p for p in (shared_data / "mocap").iterdir() if p.suffix in (".bvh", ".amc")]
    assert len(files) >= 14
    for path in files:
        assert doubt(load_motion(path, skeleton), skeleton, path.name) == "", path.name


def test_commands_say_it_in_one_line(
    tmp_path: Path, skeleton: Skeleton, walk: Motion, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "w.json", moved(100)(walk, skeleton))
    motion_of(str(path), skeleton)
    said = capsys.readouterr().err
    assert said.startswith(f"--motion {path}: looks wrong: they move at ") and said.count("\n") == 1
    assert f"{path}#scale=0.01" in said
    motion_of(f"{path}#scale=0.01", skeleton)
    motion_of("walk", skeleton)
    assert capsys.readouterr().err == ""


def test_what_stands_behind_a_name() -> None:
    assert split_corrections(None) == (None, Corrections())
    assert split_corrections("Run") == ("Run", Corrections())
    assert split_corrections("") == ("", Corrections())
    assert split_corrections("Run#up=-z#a=b") == ("Run#a=b", Corrections(up="-z"))
    said = "up=x#scale=0.01#turn=90#floor=0#sides=swapped#fps=60"
    assert split_corrections(said) == (None, Corrections("x", 0.01, 90.0, True, True, 60.0))
    for axis in ("x", "-x", "y", "-y", "z", "-z"):
        world = Corrections(axis).world
        unit = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
        assert world @ unit == pytest.approx([0, 1, 0]) and np.linalg.det(world) == pytest.approx(1)


@pytest.mark.parametrize(
    ("said", "word"),
    [
        ("up=w", "up="),
        ("scale=0", "scale="),
        ("scale=nan", "scale="),
        ("scale=x", "scale="),
        ("turn=1e9", "turn="),
        ("floor=1", "floor="),
        ("sides=left", "sides="),
        ("fps=-1", "fps="),
        ("sides=swapped", "other makers"),
        ("size=2", "only glTF"),
    ],
)
def test_corrections_that_are_none(tmp_path: Path, skeleton: Skeleton, walk: Motion, said: str, word: str) -> None:
    path = written(tmp_path / "walk.json", walk)
    if said == "size=2":
        path = tmp_path / "walk.bvh"
        path.write_text(Export().text(walk, skeleton))
    with pytest.raises(PoseError) as caught:
        load_motion(f"{path}#{said}", skeleton)
    assert word in str(caught.value) and str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@pytest.mark.check
@pytest.mark.shared
def test_animations_of_games(shared_data: Path, skeleton: Skeleton) -> None:
    """Of some makers' models; in Godot's player knees do bend forwards."""
    for name, number in (("kaykit_mage.glb", 24), ("mannequiny_gdquest.glb", 9), ("quaternius_knight.glb", 8)):
        motion = load_motion(shared_data / "real/models" / name, skeleton, animation=str(number))
        assert doubt(motion, skeleton, "") == ""
    player = load_motion(shared_data / "real/models/godot_platformer_player.glb", skeleton, animation="walk")
    assert doubt(player, skeleton, "p").endswith("p#sides=swapped")


@pytest.mark.shared
def test_a_fox_is_refused(shared_data: Path, skeleton: Skeleton) -> None:
    with pytest.raises(Exception, match=r"fox\.glb.*this is not a standing person") as caught:
        load_motion(shared_data / "real/models/fox.glb", skeleton)
    assert "\n" not in str(caught.value)


def test_slow_people_in_centimetres(skeleton: Skeleton) -> None:
    for name in ("idle", "wave-and-turn"):
        motion = load_motion(name, skeleton)
        assert doubt(moved(100)(motion, skeleton), skeleton, "x").endswith("x#scale=0.01")


def test_walking_backwards_is_no_mistake(skeleton: Skeleton, walk: Motion) -> None:
    assert doubt(Motion(walk.fps, walk.rotations[::-1], walk.trans[::-1]), skeleton, "") == ""
