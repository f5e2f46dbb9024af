"""The table's figures against figures by hand, over whole pictures and body parts."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.comparison.measure import Reference, Scores
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.protocol import Protocol, eyes, perform
from glsplat.extras.evaluate.comparison.stage import PARTS, Stage, StageTruth, labelled_mesh, labels_of, regions
from glsplat.gl.context import Context

PROTOCOL = Protocol(tasks=("waving",), views=("left",), size=128, light="none")
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def truths(people: list[Participant]) -> tuple[StageTruth, StageTruth]:
    """The same moment of two people."""
    out = []
    for one in people[:2]:
        with Stage(one.mesh, perform(one.mesh, PROTOCOL.tasks), PROTOCOL) as stage:
            out.append(stage.truth(0, "left"))
    return out[0], out[1]


def measured(truth: StageTruth, pictures: np.ndarray) -> dict:
    scores = Scores(PROTOCOL, 2)
    scores.add("pose", 1, 0, Reference.of(truth, PROTOCOL), pictures)
    return scores.to_json(9)


CHANGES: dict[str, Change] = {
    "the same": lambda mine, other: mine,
    "a pixel down": lambda mine, other: np.roll(mine, 1, axis=1),
    "eyes swapped": lambda mine, other: mine[::-1],
    "another person": lambda mine, other: other,
}


@pytest.mark.usefixtures("no_lpips")
@pytest.mark.parametrize("name", CHANGES)
def test_figures_are_those_by_hand(truths: tuple[StageTruth, StageTruth], name: str) -> None:
    truth, other = truths
    pictures = CHANGES[name](truth.pictures, other.pictures)
    found = measured(truth, pictures)
    for eye in range(2):
        one, wanted = pictures[eye, ..., :3] / 255.0, truth.pictures[eye, ..., :3] / 255.0
        values = {key: array[1][0][eye] for key, array in found["values"]["pose"].items()}
        square = float(((one - wanted) ** 2).mean())
        assert values["l1"] == pytest.approx(np.abs(one - wanted).mean(), abs=1e-7)
        assert values["psnr"] == pytest.approx(-10 * np.log10(square) if square else 120.0, abs=1e-4)
        assert values["lpips"] == pytest.approx(square, abs=1e-7)  # the stand-in
        assert (values["ssim"] == pytest.approx(1)) == (name == "the same")
        rows, columns = (np.flatnonzero((truth.pictures[eye, ..., 3] > 0).any(axis=axis)) for axis in (1, 0))
        box = np.s_[rows[0] - 2 : rows[-1] + 3, columns[0] - 2 : columns[-1] + 3]
        assert values["box_l1"] == pytest.approx(np.abs(one - wanted)[box].mean(), abs=1e-7)
        cover, true = pictures[eye, ..., 3].astype(float), truth.pictures[eye, ..., 3].astype(float)
        overlap = np.minimum(cover, true).sum() / np.maximum(cover, true).sum()
        assert values["overlap"] == pytest.approx(overlap, abs=1e-7)
        legs = truth.regions[eye] == PARTS.index("legs")
        by_part = found["parts"]["pose"]["legs"]["l1"][1][0][eye]
        assert by_part == pytest.approx(np.abs(one - wanted)[legs].mean(), abs=1e-7)
    assert found["values"]["tracking"]["l1"] == [[[None, None]]] * 2  # nothing was added there
    assert found["values"]["pose"]["l1"][0] == [[None, None]]


@pytest.mark.usefixtures("no_lpips")
def test_a_part_that_is_not_seen_has_no_figure(truths: tuple[StageTruth, StageTruth]) -> None:
    truth = truths[0]
    faceless = np.where(truth.regions == PARTS.index("face"), np.int8(-1), truth.regions)
    hidden = StageTruth(truth.cameras, truth.pictures, faceless)
    found = measured(hidden, cv2.GaussianBlur(truth.pictures[0], (5, 5), 0)[None].repeat(2, axis=0))
    assert found["parts"]["pose"]["face"]["psnr"] == [[[None, None]]] * 2
    assert found["parts"]["pose"]["legs"]["psnr"][1][0][0] > 10


def test_every_pixel_of_a_person_has_a_part_and_parts_are_where_they_are(
    people: list[Participant], context: Context
) -> None:
    mesh = people[1].mesh
    done = perform(mesh, ("standing",))
    protocol = Protocol(size=256)
    points = mesh.posed(done.pose(0))
    with MeshTruth(labelled_mesh(mesh), size=(256, 256), samples=1, supersample=1, context=context) as renderer:
        pictures = {view: renderer.render(eyes(points, view, protocol), done.pose(0))[0] for view in protocol.views}
    labels = {view: labels_of(picture) for view, picture in pictures.items()}
    for view, label in labels.items():
        assert ((label >= 0) == (pictures[view][..., 3] > 127)).all()
        rows = {part: np.flatnonzero((label == i).any(axis=1)) for i, part in enumerate(PARTS)}
        assert rows["head"].mean() < rows["torso"].mean() < rows["legs"].mean()
        assert len(rows["hands"]) and rows["hands"].min() > rows["torso"].min()
    face = {view: (label == PARTS.index("face")).sum() for view, label in labels.items()}
    assert face["front"] > 1.5 * max(face["left"], face["right"]) > 10 > face["back"]


def test_the_background_beside_a_part_is_the_part_s() -> None:
    labels = np.full((20, 20), -1, np.int8)
    labels[5:10, 5:10], labels[5:10, 12:15] = 0, 3
    found = regions(labels, 3)
    assert found[7, 4] == found[7, 2] == 0 and found[7, 1] == -1
    assert found[7, 10] == 0 and found[7, 11] == 3
    assert (found[labels >= 0] == labels[labels >= 0]).all()
    empty = np.full((8, 8), -1, np.int8)
    assert (regions(empty, 3) == -1).all()


def test_the_figure_fills_what_it_should(people: list[Participant]) -> None:
    mesh = people[3].mesh
    protocol = Protocol(size=200, tasks=("standing", "arms sideways"), light="none")
    with Stage(mesh, perform(mesh, protocol.tasks), protocol) as stage:
        for moment, axis in ((0, 1), (1, 0)):  # its height; its span, which is longer
            covered = stage.truth(moment, "front").pictures[0, ..., 3] > 127
            share = np.ptp(np.flatnonzero(covered.any(axis=axis))) / 200
            assert 0.84 < share < 0.9
            left, right = stage.truth(moment, "front").cameras
            assert abs(np.linalg.norm(left.position - right.position) - 0.055) < 1e-12


def test_the_truth_is_lit_where_it_is_asked_to_be(people: list[Participant]) -> None:
    mesh, note = people[0].mesh, people[0].light
    drawn = {}
    for light in ("none", "capture"):
        protocol = Protocol(size=96, tasks=("standing",), light=light)
        with Stage(mesh, perform(mesh, protocol.tasks), protocol, note) as stage:
            drawn[light] = stage.truth(0, "back").pictures[0].astype(int)
    np.testing.assert_array_equal(drawn["none"][..., 3], drawn["capture"][..., 3])
    inside = drawn["none"][..., 3] == 255
    assert drawn["capture"][inside, :3].mean() < 0.9 * drawn["none"][inside, :3].mean()  # the lamp is before them
    with pytest.raises(FormatError, match="light of the photograph is not known"):
        Stage(mesh, perform(mesh, ("standing",)), Protocol(size=96, light="capture"))
