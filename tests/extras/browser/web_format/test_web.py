"""The avatar as a browser fetches it: as good as its steps, small, in parts; liars refused."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat.errors import FormatError
from glsplat.extras.browser.web_format.read import HEAD, decode_avatar, read_header
from glsplat.extras.browser.web_format.write import encode_avatar
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Level
from glsplat.views import view_of
from tests.formats.test_contract import peak_of
from tests.light.lit import surfaced

Change = Callable[[dict[str, Any]], None]


def someone(count: int, degree: int = 0, influences: int = 4, joints: int = 20, seed: int = 5) -> glsplat.Avatar:
    """Random splats on a random tree of joints."""
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3))
    scales = np.exp(rng.uniform(-9, -2, (count, 3)))
    scales[::7, 1] = 0  # flat ones
    splats = glsplat.Splats(
        rng.normal(0, 0.7, (count, 3)), rng.normal(size=(count, 4)), scales, rng.uniform(0.01, 1, count), sh, True
    )
    parents = [-1, *(int(rng.integers(0, i)) for i in range(1, joints))]
    rig = glsplat.Skeleton.from_joints([f"j{i}" for i in range(joints)], parents, rng.normal(size=(joints, 3)))
    weights = rng.dirichlet(np.full(influences, 0.4), count)
    return glsplat.Avatar(splats, rig, glsplat.Skin(rng.integers(0, joints, (count, influences)), weights))


def with_face(avatar: glsplat.Avatar, seed: int = 3) -> glsplat.Avatar:
    rng = np.random.default_rng(seed)
    count = len(avatar.splats)
    rows = np.repeat(np.arange(0, count, 3), 2)
    shapes = Shapes.create(
        ["jawOpen", "cheekPuff", "mine"],
        count,
        splats=rows,
        targets=np.tile([0, 2], len(rows) // 2),
        moves=rng.normal(0, 0.01, (len(rows), 3)),
        bends=rng.normal(0, 0.3, (len(rows), 2, 3)),
        limits=[[0, 1], [-1, 1], [0, 2]],
    )
    return replace(avatar, shapes=shapes)


@pytest.mark.parametrize(("degree", "influences", "joints"), [(0, 4, 20), (3, 8, 300), (1, 1, 2), (2, 2, 256)])
def test_what_comes_back_is_off_by_half_a_step_at_most(degree: int, influences: int, joints: int) -> None:
    first = someone(701, degree, influences, joints)
    back = decode_avatar(encode_avatar(first))
    extent = np.ptp(first.splats.means, axis=0)
    # the file has its own order: by the nearest mean
    at = [int(np.abs(first.splats.means - mean).sum(axis=1).argmin()) for mean in back.splats.means]
    assert sorted(at) == list(range(701))
    was, is_now = first.splats.take(at), back.splats
    assert (np.abs(was.means - is_now.means) <= extent / 65535 * 0.51).all()
    assert np.abs(was.opacities - is_now.opacities).max() <= 0.51 / 255
    dots = np.abs((was.quats * is_now.quats).sum(axis=1))
    assert np.degrees(2 * np.arccos(dots.min().clip(0, 1))) < 0.3
    flat = was.scales == 0
    assert (is_now.scales[flat] == 0).all()
    assert np.abs(np.log(was.scales[~flat] / is_now.scales[~flat])).max() <= 7 / 254 * 0.51
    dark = np.maximum(was.sh, -1.7724539) if degree == 0 else was.sh
    assert np.abs(dark[:, 0] - is_now.sh[:, 0]).max() <= np.ptp(dark[:, 0], axis=0).max() / 255 * 0.51
    assert np.abs(was.sh[:, 1:] - is_now.sh[:, 1:]).max(initial=0) <= np.abs(was.sh).max() / 127 * 0.51
    assert is_now.antialias and back.skeleton.same(first.skeleton)
    assert np.array_equal(back.skeleton.rest, first.skeleton.rest)
    dense = [np.zeros((701, joints)) for _ in range(2)]
    for array, skin in zip(dense, (first.skin.take(at), back.skin), strict=True):
        np.add.at(array, (np.arange(701)[:, None], skin.joints), skin.weights)
    assert np.abs(dense[0] - dense[1]).max() <= influences * 1.01 / 4095


def test_the_default_avatar_is_small_and_looks_the_same() -> None:
    """0.8 MB, shapes and surface, its first picture after 0.25 MB; 60 dB in a pose that nothing was tuned with."""
    avatar = glsplat.default_avatar()
    data = encode_avatar(avatar)
    header, first = read_header(data)
    ends = [first + part.offset + part.bytes for part in header.parts]
    assert [(part.level, part.splats) for part in header.parts[:4]] == [(3, 4500), (0, 40000), (1, 14000), (2, 7000)]
    assert ends[0] <= 250_000 and ends[1] <= 800_000 and ends[-1] == len(data) <= 1_700_000
    more = [(part.level, part.kind) for part in header.parts[4:]]  # when all is shown
    assert sorted(more) == [(level, kind) for level in range(4) for kind in ("shapes", "surface")]
    assert encode_avatar(avatar) == data
    back = decode_avatar(data)
    assert [(one.density, one.psnr) for one in back.levels] == [(one.density, one.psnr) for one in avatar.levels]
    cameras = view_of(np.array((0.3, 1.5, 1.6)), np.array((0, 1.2, 0)), (256, 256), 65.0, ipd=0.063)
    rng = np.random.default_rng(77)
    pose = glsplat.Pose(rng.normal(0, 0.15, (55, 3)), (0.1, 0, 0.05))
    config = glsplat.RenderConfig(output="float32", target="32f")
    pictures = []
    for one in (avatar, back):
        with glsplat.Renderer(replace(one, levels=()), size=(256, 256), views=2, config=config) as renderer:
            pictures.append(np.array(renderer.render(list(cameras), pose)))
    error = np.mean((pictures[0][..., :3] - pictures[1][..., :3]) ** 2)
    assert pictures[0][..., 3].mean() > 0.1 and -10 * np.log10(error) >= 60


def test_a_face_and_levels_come_back() -> None:
    first = with_face(someone(400))
    coarse = replace(someone(90, seed=8), skeleton=first.skeleton)
    first = replace(first, levels=(Level(coarse, 120.0, 31.5),))
    back = decode_avatar(encode_avatar(first))
    assert back.shapes is not None and back.levels[0].content.shapes is None and first.shapes is not None
    assert back.shapes.names == first.shapes.names and np.array_equal(back.shapes.limits, first.shapes.limits)
    at = [int(np.abs(first.splats.means - mean).sum(axis=1).argmin()) for mean in back.splats.means]
    same = first.shapes.take(np.array(at))
    assert np.array_equal(same.targets, back.shapes.targets) and np.array_equal(same.bends, back.shapes.bends)
    assert np.abs(same.moves.astype(int) - back.shapes.moves).max() <= 8
    assert (back.levels[0].density, back.levels[0].psnr) == (120.0, 31.5)


def test_what_is_never_drawn_is_left_out() -> None:
    some = someone(50)
    means, opacities = np.array(some.splats.means), np.array(some.splats.opacities)
    means[3] = np.nan
    opacities[4] = 0.003
    changed = replace(some, splats=replace(some.splats, means=means, opacities=opacities))
    assert len(decode_avatar(encode_avatar(changed)).splats) == 48
    gone = replace(some, splats=replace(some.splats, opacities=np.zeros(50)))
    with pytest.raises(FormatError, match="nothing of which is drawn"):
        encode_avatar(gone)


def changed(data: bytes, change: Change) -> bytes:
    """The file with another header."""
    _, version, _, packed, _ = HEAD.unpack_from(data)
    header = json.loads(zlib.decompress(data[16 : 16 + packed], -15))
    change(header)
    text = json.dumps(header).encode()
    packer = zlib.compressobj(wbits=-15)
    head = packer.compress(text) + packer.flush()
    return HEAD.pack(b"GSAV", version, 0, len(head), len(text)) + head + data[16 + packed :]


def of_part(index: int, **values: Any) -> Change:
    return lambda header: header["parts"][index].update(values)


def of_header(**values: Any) -> Change:
    return lambda header: header.update(values)


LIES: dict[str, Change] = {
    "more splats": of_part(0, splats=2000),
    "fewer splats": of_part(0, splats=299),
    "billions of splats": of_part(0, splats=1 << 40),
    "no splats": of_part(0, splats=0),
    "beyond the end": of_part(0, offset=1 << 40),
    "before the beginning": of_part(0, offset=-5),
    "bytes beyond": of_part(1, bytes=1 << 30),
    "no level 0": of_part(0, level=1),
    "a level twice": lambda header: header["parts"].append(header["parts"][0]),
    "no parts": of_header(parts=[]),
    "a thousand parts": lambda header: header.update(parts=header["parts"] * 500),
    "another degree": of_header(sh_degree=3),
    "degree nine": of_header(sh_degree=9),
    "three influences": of_header(influences=3),
    "joints by name only": lambda header: header["joints"].update(names=["a"] * 20),
    "too many joints": lambda header: header["joints"].update(names=[f"{i}" for i in range(1000)]),
    "a circle": lambda header: header["joints"].update(parents=[1, 0, *[0] * 18]),
    "no frame": lambda header: header["joints"].update(rest=[0.0] * 240),
    "a box of two": of_part(0, low=[0, 0]),
    "a box inside out": of_part(0, low=[9, 9, 9], high=[-9, -9, -9]),
    "a box far out": of_part(0, high=[1e30, 1e30, 1e30]),
    "huge scales": of_part(0, scales=[0, 700]),
    "colours that are text": of_part(0, colours=["a"] * 6),
    "entries": of_part(1, entries=100_000),
    "billions of entries": of_part(1, entries=1 << 40),
    "shapes of nobody": of_header(shapes=None),
    "shapes without limits": lambda header: header["shapes"].update(limits=[0.0]),
    "a joint that is not there": lambda header: header["joints"].update(
        names=["a"], parents=[-1], rest=[1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], inverse_bind=[1.0] + [0.0] * 11
    ),
}


@pytest.fixture(scope="module")
def face() -> bytes:
    return encode_avatar(with_face(someone(300)))


@pytest.mark.parametrize("lie", LIES)
def test_lies_are_refused_before_memory_is_taken(face: bytes, lie: str) -> None:
    data = changed(face, LIES[lie])

    def read() -> None:
        with pytest.raises(FormatError) as caught:
            decode_avatar(data)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 300

    assert peak_of(read) < 4_000_000


def test_bombs_are_not_unpacked(face: bytes) -> None:
    packer = zlib.compressobj(9, wbits=-15)
    bomb = packer.compress(bytes(50_000_000)) + packer.flush()
    for data in (
        HEAD.pack(b"GSAV", 1, 0, len(bomb), 1000) + bomb,
        HEAD.pack(b"GSAV", 1, 0, len(bomb), 50_000_000) + bomb,
        changed(face, of_part(0, offset=len(face), bytes=len(bomb))) + bytes(len(face)) + bomb,
    ):

        def read(data: bytes = data) -> None:
            with pytest.raises(FormatError):
                decode_avatar(data)

        assert peak_of(read) < 4_000_000


def test_every_cut_and_a_thousand_damaged_files_end_in_one_line_or_an_avatar(face: bytes) -> None:
    for size in range(0, len(face), 293):
        with pytest.raises(FormatError):
            decode_avatar(face[:size])
    rng = np.random.default_rng(20)
    read = 0
    for _ in range(1000):
        data = bytearray(face)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(0, 256)
        try:
            decode_avatar(bytes(data))
            read += 1
        except FormatError as error:
            assert "\n" not in str(error)
    assert read < 800  # most are found out


def test_another_version_is_named() -> None:
    with pytest.raises(FormatError, match="version 2, this reads 1"):
        decode_avatar(struct.pack("<4sHHII", b"GSAV", 2, 0, 1, 1))
    with pytest.raises(FormatError, match="GSAV"):
        decode_avatar(b"glTF")


@pytest.mark.parametrize("shaded", [True, False])
def test_it_comes_back_to_the_byte_with_its_levels(shaded: bool) -> None:
    first = surfaced(with_face(someone(500, seed=12)), seed=3, shaded=shaded)
    coarse = surfaced(replace(someone(90, seed=8), skeleton=first.skeleton), seed=4, shaded=not shaded)
    last = replace(someone(40, seed=2), skeleton=first.skeleton)
    data = encode_avatar(replace(first, levels=(Level(coarse, 120.0, 31.5), Level(last, 60.0, 28.0))))
    back = decode_avatar(data)
    kinds = [(part.kind, part.level) for part in read_header(data)[0].parts]
    assert kinds[-2:] == [("surface", 0), ("surface", 1)]  # behind all that a picture needs
    for one, was in ((back, first), (back.levels[0].content, coarse)):
        at = [int(np.abs(was.splats.means - mean).sum(axis=1).argmin()) for mean in one.splats.means]
        found, expected = one.splats.surface, was.splats.surface
        wanted = expected.take(at)
        assert np.array_equal(found.normals, wanted.normals) and np.array_equal(found.occlusion, wanted.occlusion)
        assert (found.shade is None) == (wanted.shade is None)
        assert np.array_equal(found.shades_or_one(), wanted.shades_or_one())
    assert back.levels[1].content.splats.surface is None


FALSE: list[dict[str, Any]] = [{"shaded": False}, {"shaded": 1}, {"level": 1}, {"kind": "light"}, {"bytes": 5}]
FALSE_LIES = [of_part(2, **lie) for lie in FALSE]


@pytest.mark.parametrize(
    "lie", [*FALSE_LIES, LIES["more splats"], lambda header: header["parts"].append(header["parts"][2])]
)
def test_lies_about_it_are_refused(lie: Change) -> None:
    data = changed(encode_avatar(surfaced(with_face(someone(300)))), lie)

    def read() -> None:
        with pytest.raises(FormatError) as caught:
            decode_avatar(data)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 300

    assert peak_of(read) < 4_000_000
