"""Hair by templates: found in a made-up picture, chosen by its length, and grown where the picture shows none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from scipy.spatial import cKDTree

from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.networks.head_parts import HeadPart
from glsplat.extras.authoring.paint.head import back_of_head, ears_of, vertices_of
from glsplat.extras.authoring.sample.scatter import scatter
from glsplat.extras.authoring.templates.hair import (
    MIN_AGREEMENT,
    FittedHair,
    bared,
    carved,
    fit_hair,
    haired,
    scattered,
)
from glsplat.extras.authoring.templates.hair_mask import SeenHair, seen_hair
from glsplat.extras.authoring.templates.hair_splats import (
    HAIR_SPLATS,
    covered_by_hair,
    hair_splats,
    with_template_hair,
)
from glsplat.extras.authoring.templates.head_view import HeadView, head_view, value_at
from glsplat.extras.authoring.templates.library import HAIR, template
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.splats import SH_C0
from tests.extras.authoring.paint.scene import photographed

DARK = np.array([40, 25, 18])


@cache
def pictured(name: str | None) -> tuple[HeadView, np.ndarray]:
    """Return the made-up person with dark hair of that template drawn into the picture, and where [H, W]."""
    scene = photographed("front")
    shot, body = scene.shots[0], scene.body
    head = head_view(body, scene.fit, shot)
    drawn = np.zeros(shot.mask.shape, np.uint8)
    if name is not None:
        own = template(name)
        skull = body.vertices[head.skull]
        where = own.vertices - skull.mean(axis=0) + head.middle
        points = where[own.parts[0].faces].mean(axis=1)
        points = np.concatenate([points, (points[:, None] + where[own.parts[0].faces]).reshape(-1, 3) / 2])
        there = head.camera(points[points[:, 1] > head.middle[1] - 0.35])
        pixels = shot.project(there)
        pixels = pixels[there[:, 2] < head.body_z(pixels) + 0.01].astype(int)
        drawn[pixels[:, 1], pixels[:, 0]] = 1
        drawn = cv2.morphologyEx(drawn, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    hair = drawn > 0
    noise = np.random.default_rng(0).normal(0, 4, (int(hair.sum()), 1))
    rgb = shot.rgb.copy()
    rgb[hair] = (DARK + noise).clip(0, 255).astype(np.uint8)
    return head_view(body, scene.fit, replace(shot, rgb=rgb, mask=shot.mask | hair)), hair


@cache
def fitted(name: str) -> tuple[SeenHair, FittedHair]:
    """Return the hair of the picture with that template, found and fitted."""
    head, _ = pictured(name)
    seen = seen_hair(head)
    assert seen is not None
    hair = fit_hair(head, seen, tuple(HAIR))
    assert hair is not None
    return seen, hair


def test_hair_is_found_by_its_colour_and_a_bald_head_has_none() -> None:
    for name in ("short02", "long01"):
        true, seen = pictured(name)[1], fitted(name)[0].mask
        assert (true & seen).sum() > 0.85 * (true | seen).sum()
    assert seen_hair(pictured(None)[0]) is None


def test_hair_like_skin_is_what_stands_out_from_the_skull() -> None:
    head, drawn = pictured("bob01")
    rgb, up = head.shot.rgb.copy(), head.plane(np.stack(np.nonzero(drawn)[::-1], axis=1) + 0.5)[:, 1]
    rgb[drawn] = np.median(rgb[face_pixels(head)], axis=0)
    seen = seen_hair(replace(head, shot=replace(head.shot, rgb=rgb)))
    assert seen is not None and seen.hat is None and seen.mask[~drawn].sum() < 0.1 * seen.mask.sum()
    assert seen.mask.sum() > 0.3 * (up > head.sizes.chin).sum()
    hair = fit_hair(head, seen, tuple(HAIR))
    assert hair is not None and hair.agreement > MIN_AGREEMENT


def test_a_networks_labels_decide_where_they_make_sense() -> None:
    head, drawn = pictured("bob01")
    up = head.plane(np.stack(np.mgrid[: drawn.shape[0], : drawn.shape[1]][::-1], axis=-1) + 0.5)[..., 1]
    rgb = head.shot.rgb.copy()
    rgb[drawn] = np.median(rgb[face_pixels(head)], axis=0)  # colours tell nothing
    plain = replace(head, shot=replace(head.shot, rgb=rgb))
    labels = np.where(head.shot.mask, HeadPart.SKIN, HeadPart.BACKGROUND).astype(np.uint8)
    by_colour = seen_hair(head)
    assert by_colour is not None and (found := seen_hair(head, labels)) is not None  # it may not know this hair
    assert (by_colour.mask == found.mask).all()
    labels[drawn] = HeadPart.HAIR
    seen = seen_hair(plain, labels)
    assert seen is not None and seen.hat is None and not (seen.mask & ~drawn).any()
    assert (seen.mask & drawn).sum() > 0.9 * (drawn & (up > head.sizes.eyes)).sum()
    rim = head.sizes.eyes + 0.05
    labels[drawn & (up > rim)] = HeadPart.HAT
    same = seen_hair(plain, labels)  # a hat of the hair's colour is hair
    assert same is not None and same.hat is None and (same.mask == seen.mask).all()
    rgb[drawn & (up > rim)] = 40, 90, 200
    hatted = seen_hair(plain, labels)
    assert hatted is not None and hatted.hat is not None and abs(hatted.hat - rim) < 0.03
    assert not (hatted.mask & (up > rim + 0.01)).any()
    labels[up > head.sizes.eyes] = HeadPart.BACKGROUND  # it takes hair for the room
    assert (again := seen_hair(head, labels)) is not None and (by_colour.mask == again.mask).all()


def test_a_fringe_is_hair_but_a_beard_and_eyebrows_are_not() -> None:
    head, _ = pictured("bob01")
    where = head.plane(np.stack(np.mgrid[: head.shot.mask.shape[0], : head.shot.mask.shape[1]][::-1], axis=-1) + 0.5)
    aside, up = where[..., 0], where[..., 1] - head.sizes.eyes
    hair = head.shot.mask & (up > 0.06)
    fringe = (aside > 0) & (aside < 0.05) & (up > -0.04) & (up < 0.07)
    below = (np.abs(aside) < 0.07) & (np.abs(up + 0.09) < 0.02)
    brow = (aside < -0.01) & (aside > -0.04) & (np.abs(up - 0.03) < 0.005)
    labels = np.where(head.shot.mask, HeadPart.SKIN, HeadPart.BACKGROUND).astype(np.uint8)
    labels[hair | fringe | below | brow] = HeadPart.HAIR
    seen = seen_hair(head, labels)
    assert seen is not None and seen.mask[fringe].mean() > 0.95
    assert not (seen.mask & brow).any() and not (seen.mask & below & (np.abs(aside) < 0.03)).any()


def test_hair_that_a_network_takes_for_a_forehead_or_glasses_is_found_by_its_colour() -> None:
    head, drawn = pictured("short03")
    up = head.plane(np.stack(np.mgrid[: drawn.shape[0], : drawn.shape[1]][::-1], axis=-1) + 0.5)[..., 1]
    labels = np.where(head.shot.mask, HeadPart.SKIN, HeadPart.BACKGROUND).astype(np.uint8)
    labels[drawn & (up > head.sizes.eyes + 0.07)] = HeadPart.HAIR
    labels[drawn & (np.abs(up - head.sizes.eyes - 0.05) < 0.02)] = 6  # glasses
    seen = seen_hair(head, labels)
    assert seen is not None and (seen.mask & ~drawn).sum() < 0.05 * drawn.sum()
    assert seen.mask[drawn & (up > head.sizes.eyes)].mean() > 0.9


def test_a_forehead_in_shade_below_white_hair_is_no_hair() -> None:
    head, _ = pictured(None)
    where = head.plane(np.stack(np.mgrid[: head.shot.mask.shape[0], : head.shot.mask.shape[1]][::-1], axis=-1) + 0.5)
    aside, up = where[..., 0], where[..., 1] - head.sizes.eyes
    top = head.shot.mask & (up > 0.065)
    sides = head.shot.mask & (np.abs(aside) > 0.055) & (up > -0.1) & ~top
    rgb = head.shot.rgb.copy()
    rgb[head.shot.mask & (aside < -0.02) | sides] = DARK  # the shade, and hair in it
    rgb[top] = np.median(rgb[face_pixels(head)], axis=0) + 20
    labels = np.where(head.shot.mask, HeadPart.SKIN, HeadPart.BACKGROUND).astype(np.uint8)
    labels[top | sides] = HeadPart.HAIR
    seen = seen_hair(replace(head, shot=replace(head.shot, rgb=rgb)), labels)
    assert seen is not None and seen.mask[top].mean() > 0.9
    assert not seen.mask[~top & (np.abs(aside) < 0.05)].any()


def face_pixels(head: HeadView) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the clearly visible face."""
    column, row = head.shot.view.pixels[face_vertices(head.body) & (head.shot.visibility > 0.5)].astype(int).T
    return row, column


def test_template_is_chosen_by_length_and_agrees() -> None:
    short, long = fitted("short02")[1], fitted("long01")[1]
    assert short.name.startswith("short") and not short.long and long.name == "long01" and long.long
    assert min(short.agreement, long.agreement) > MIN_AGREEMENT and max(short.agreement, long.agreement) <= 1
    head, seen = short.head, short.seen
    beside = replace(seen, mask=np.roll(seen.mask, 80, axis=1))  # hair that is not on the head agrees with nothing
    wrong = fit_hair(head, beside, tuple(HAIR))
    assert wrong is not None and wrong.agreement < short.agreement - 0.3


def test_hairline_and_fringe_choose_the_template_and_its_side() -> None:
    for name in ("short01", "short03", "bob01"):
        head, drawn = pictured(name)
        middle = float(head.shot.project(head.camera(head.middle[None]))[0, 0])
        turn = np.array([[-1, 0, 2 * middle], [0, 1, 0]])
        turned = cv2.warpAffine(drawn.astype(np.uint8), turn, drawn.shape[::-1]) > 0
        for mask in (drawn, turned):
            rows, columns = np.nonzero(mask)
            seen = SeenHair(mask, head.plane(np.stack([columns, rows], axis=1) + 0.5), None)
            view = replace(head, shot=replace(head.shot, mask=head.shot.mask | mask))
            hair = fit_hair(view, seen, tuple(HAIR))
            assert hair is not None and hair.name == name


def test_a_bob_is_hair_that_covers_the_ears() -> None:
    head, drawn = pictured("bob01")
    rows, columns = np.nonzero(drawn)
    plane = head.plane(np.stack([columns, rows], axis=1) + 0.5)
    ears = head.plane_of(head.bare[np.any(ears_of(head.body), axis=0)])[:, 1].min()
    for end, length in ((ears - 0.008, "bob"), (ears + 0.02, "short")):
        some = plane[:, 1] > end
        mask = np.zeros_like(drawn)
        mask[rows[some], columns[some]] = True
        hair = fit_hair(head, SeenHair(mask, plane[some], None), ("bob01", "short01"))
        assert hair is not None and hair.name.startswith(length)


def test_a_wreath_of_hair_below_a_bald_crown_gets_a_template() -> None:
    head, drawn = pictured("short03")
    rows, columns = np.nonzero(drawn)
    plane = head.plane(np.stack([columns, rows], axis=1) + 0.5)
    low = (np.abs(plane[:, 1] - head.sizes.eyes) < 0.025) & (np.abs(plane[:, 0]) > 0.8 * head.sizes.half_width)
    mask = np.zeros_like(drawn)
    mask[rows[low], columns[low]] = True
    hair = fit_hair(head, SeenHair(mask, plane[low], None), tuple(HAIR))
    assert low.any() and hair is not None and hair.name != "afro01"


def test_ears_and_a_neck_below_the_hair_stay_skin_and_the_skull_under_it_does_not() -> None:
    scene, hair = photographed("front"), fitted("short02")[1]
    body, rng = hair.head.body, np.random.default_rng(0)
    even = scatter(scene.mesh, 24_000, rng)
    bare = even.avatar(scene.mesh, np.full((len(even.density), 3), 0.6), np.zeros(len(even.density)), rng)
    splats = with_template_hair(bare, hair, hair_splats(hair, scene.light, 0)).splats
    skin = splats.sh[: len(bare.splats), 0, 0] * SH_C0 + 0.5 > 0.55
    near = cKDTree(scene.mesh.vertices).query(bare.splats.means)[1]
    end = splats.means[len(bare.splats) :, 1].min()
    assert skin[np.any(ears_of(body), axis=0)[near]].all()
    assert skin[vertices_of(body, "neck")[near] & (bare.splats.means[:, 1] < end)].all()
    middle = hair.head.middle
    behind = (bare.splats.means[:, 1] > middle[1]) & (bare.splats.means[:, 2] < middle[2] - 0.06)
    assert skin[behind].mean() < 0.1
    mask = haired(hair)
    assert mask[hair.head.skull].all() and not mask[scene.mesh.vertices[:, 1] < 1.0].any()
    light = scene.light
    painted = back_of_head(body, scene.shots[0], light, np.array([0.5, 0.3, 0.2]), bald=mask)
    assert np.allclose(painted.colour[mask & ~np.any(ears_of(body), axis=0)], (0.5, 0.3, 0.2))


def test_the_head_is_bare_under_hair_that_its_outline_followed() -> None:
    hair, shot = fitted("long01")[1], photographed("front").shots[0]
    head, skull = hair.head, hair.head.skull
    swollen = np.where(skull[:, None], head.middle + 1.5 * (head.bare - head.middle), shot.mesh.vertices)
    mesh = replace(shot.mesh, vertices=swollen)
    shot = replace(shot, mesh=mesh, view=shot.view.moved(mesh, skull))
    bare, (made,) = bared(hair, (shot,))
    behind = skull & ~face_vertices(head.body)
    assert bare.head.shot is made and np.allclose(made.mesh.vertices[behind], head.bare[behind], atol=1e-6)
    assert np.allclose(made.view.pixels, made.project(made.view.vertices))
    face = skull & face_vertices(head.body) & ~value_at(hair.seen.mask, shot.view.pixels)
    assert (made.mesh.vertices[face] == swollen[face]).mean() > 0.7  # what is seen stays, but beside the hair
    feet = swollen[:, 1] < 1.0
    assert np.array_equal(made.mesh.vertices[feet], swollen[feet])


def test_a_collar_of_the_hairs_colour_is_no_hair() -> None:
    head, _ = pictured("long01")
    rgb = head.shot.rgb.copy()
    where = head.plane(np.stack(np.mgrid[: rgb.shape[0], : rgb.shape[1]][::-1], axis=-1) + 0.5)
    aside, below = np.abs(where[..., 0]), head.sizes.chin - where[..., 1]
    rgb[head.shot.mask & (aside < 0.12) & (below > -0.01) & (below < 0.1)] = DARK
    seen = seen_hair(replace(head, shot=replace(head.shot, rgb=rgb)))
    assert seen is not None and not (seen.mask & (aside < 0.045) & (below > 0)).any()


def test_hair_half_as_wide_again_agrees_too() -> None:
    (head, _), (seen, hair) = pictured("bob01"), fitted("bob01")
    middle = float(head.shot.project(head.camera(head.middle[None]))[0, 0])
    mask = seen.mask.astype(np.uint8)
    wide = cv2.warpAffine(mask, np.array([[1.5, 0, -0.5 * middle], [0, 1, 0]]), mask.shape[::-1]) > 0
    other = fit_hair(
        replace(head, shot=replace(head.shot, mask=head.shot.mask | wide)),
        SeenHair(wide, seen.plane * (1.5, 1), None),
        tuple(HAIR),
    )
    assert other is not None and other.name.startswith("bob") and other.agreement > 0.6 < hair.agreement


def test_long_hair_follows_the_head_above_and_the_back_below() -> None:
    mesh = fitted("long01")[1].mesh
    assert np.allclose(mesh.weights.sum(axis=1), 1)
    of_head = (mesh.weights * (mesh.joints == JOINT_NAMES.index("head"))).sum(axis=1)
    joints = mesh.skeleton.joints
    neck, chest = (joints[JOINT_NAMES.index(name), 1] for name in ("neck", "spine3"))
    height = mesh.vertices[:, 1]
    assert (of_head[height > neck + 0.05] == 1).all() and (of_head[height < chest] == 0).all()
    order = np.argsort(height)
    steps = np.abs(np.diff(of_head[order])) / np.maximum(np.diff(height[order]), 0.002)
    assert steps.max() < 15  # a metre: nothing tears


def test_long_hair_of_a_tilted_head_ends_where_it_is_seen_to_end_above_the_shoulders() -> None:
    head, seen = pictured("long01")[0], fitted("long01")[0]
    lock = (seen.plane[:, 0] > 0.07) & (seen.plane[:, 1] > head.sizes.chin - 0.05)
    seen = replace(seen, plane=seen.plane[lock | (seen.plane[:, 1] > head.sizes.eyes)])
    low = np.quantile(seen.plane[:, 1], 0.01)
    hidden = []
    for angle in (0.0, -0.5):
        rotation = cv2.Rodrigues(np.array([0.0, 0.0, angle]))[0] @ head.rotation
        tilted = replace(head, rotation=rotation, offset=head.camera(head.middle[None])[0] - rotation @ head.middle)
        hair = fit_hair(tilted, seen, ("long01",))
        assert hair is not None and hair.long
        hidden.append(low - hair.end)
        points = hair.mesh.vertices[carved(hair, hair.mesh.vertices)]
        assert hair.head.plane_of(points)[:, 1].min() > hair.end - 0.032
    assert abs(hidden[0] - 0.12) < 0.001 and abs(hidden[1] - 0.03) < 0.01


def test_hair_behind_goes_on_under_a_brim_but_not_over_a_cap() -> None:
    hair = fitted("long01")[1]
    head, rim = hair.head, hair.head.sizes.eyes + 0.03
    height = head.plane_of(head.bare)[:, 1]
    points = scattered(hair.mesh, 20_000, np.random.default_rng(0))[0].at(hair.mesh.vertices)
    above = head.plane_of(points)[:, 1] - rim
    kept = []
    for brim in (0.0, 0.09):
        wide = 1 + brim / 0.1 * np.interp(height - rim, [0, 0.02, 0.05], [0, 1, 0])
        vertices = head.middle + np.where(head.skull, wide, 1)[:, None] ** [1, 0, 1] * (head.bare - head.middle)
        view = replace(head, shot=replace(head.shot, mesh=replace(head.shot.mesh, vertices=vertices)))
        stays = carved(replace(hair, head=view, seen=replace(hair.seen, hat=rim)), points)
        assert not stays[above > 0.031].any()
        kept.append(points[stays & (above > 0)])
    assert not len(kept[0]) and len(kept[1]) > 100 and kept[1][:, 2].max() < head.middle[2] + 0.02


def test_hair_has_its_colour_its_splats_and_leaves_the_face_alone() -> None:
    scene, hair = photographed("front"), fitted("long01")[1]
    rng = np.random.default_rng(0)
    covered = covered_by_hair(hair)
    even = scatter(scene.mesh, 24_000, np.random.default_rng(0))
    scattered = scatter(scene.mesh, 24_000, rng, covered, HAIR_SPLATS)
    zones = [[zone.splats for zone in each.zones] for each in (even, scattered)]  # the rest, both hands, the head
    assert sum(zones[1]) == 24_000 - HAIR_SPLATS and zones[0][1:3] == zones[1][1:3] and zones[1][3] < zones[0][3]
    bare = scattered.avatar(
        scene.mesh, np.full((len(scattered.density), 3), 0.6), np.zeros(len(scattered.density)), rng
    )
    made = with_template_hair(bare, hair, hair_splats(hair, scene.light, 0))
    grown = made.splats.means[len(bare.splats) :]
    assert 0.99 * HAIR_SPLATS < len(grown) <= HAIR_SPLATS
    rgb = made.splats.sh[len(bare.splats) :, 0] * SH_C0 + 0.5
    assert np.abs(np.median(rgb, axis=0) - DARK / 255).max() < 0.08
    eyes, middle = hair.head.sizes.eyes_rest, hair.head.middle
    face = (np.abs(grown[:, 0]) < 0.03) & (np.abs(grown[:, 1] - eyes + 0.04) < 0.04) & (grown[:, 2] > middle[2] + 0.05)
    assert not face.any()
    back = grown[grown[:, 2] < middle[2]]
    assert back[:, 1].min() < middle[1] - 0.25  # it hangs


def test_hair_half_in_shade_has_the_colour_of_its_lit_half() -> None:
    scene, hair = photographed("front"), fitted("short01")[1]
    shot = hair.head.shot
    where = hair.head.plane(np.stack(np.mgrid[: shot.mask.shape[0], : shot.mask.shape[1]][::-1], axis=-1) + 0.5)

    def behind(shade: float) -> float:
        """Return the brightness of unseen hair, with ``shade`` on the left half of face and light hair."""
        rgb = shot.rgb.copy()
        rgb[hair.seen.mask] = 220
        rgb[where[..., 0] < 0] = (rgb[where[..., 0] < 0] * shade).astype(np.uint8)
        drawn = replace(hair, head=replace(hair.head, shot=replace(shot, rgb=rgb)))
        splats = hair_splats(drawn, scene.light, 0).avatar.splats
        unseen = splats.means[:, 2] < hair.head.middle[2] - 0.03
        return float(np.median(splats.sh[unseen, 0, 0] * SH_C0 + 0.5))

    assert behind(0.3) > 0.78
    assert behind(0.6) < 0.76  # soft light: the median of both


def test_locks_have_the_contrast_of_the_pictures_locks_not_of_its_light() -> None:
    scene, hair = photographed("front"), fitted("short01")[1]
    shot, mask = hair.head.shot, hair.seen.mask
    column = np.nonzero(mask)[1]
    wide = column.max() - column.min()
    light, locks = 0.5 + (column - column.min()) / wide, 1 + 0.5 * np.sign(np.sin(column / 2))

    def spread(factor: np.ndarray) -> float:
        """Return the spread of the unseen hair's brightness, over its mean."""
        rgb, rng = shot.rgb.copy(), np.random.default_rng(0)
        rgb[mask] = (90 * factor[:, None] + np.zeros(3)).astype(np.uint8)
        drawn = replace(hair, head=replace(hair.head, shot=replace(shot, rgb=rgb)))
        even = scatter(scene.mesh, 4000, rng)
        bare = even.avatar(scene.mesh, np.full((len(even.density), 3), 0.6), np.zeros(len(even.density)), rng)
        splats = with_template_hair(bare, drawn, hair_splats(drawn, scene.light, 0)).splats
        behind = np.arange(len(splats)) >= len(bare.splats)
        behind &= splats.means[:, 2] < hair.head.middle[2] - 0.03
        grey = splats.sh[behind, 0, 0] * SH_C0 + 0.5
        return float(grey.std() / grey.mean())

    assert spread(light) < 0.7 * spread(locks)
    assert spread(locks) > 0.18  # splats average the template's finer locks
