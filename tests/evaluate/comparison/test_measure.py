"""The table's figures against figures by hand: shifted, brightened, swapped pictures."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from glsplat.evaluate.comparison.measure import Reference, Scores
from glsplat.evaluate.comparison.participant import Participant
from glsplat.evaluate.comparison.parts import PARTS
from glsplat.evaluate.comparison.performance import perform
from glsplat.evaluate.comparison.protocol import Protocol
from glsplat.evaluate.comparison.stage import Stage, StageTruth

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
