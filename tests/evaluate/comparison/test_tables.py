"""A wrong picture moves the tables by what it moves when everything is worked out by hand, from the pictures alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from glsplat.evaluate.comparison import tables
from glsplat.evaluate.comparison import work as working
from glsplat.evaluate.comparison.method import method_of
from glsplat.evaluate.comparison.participant import Participant
from glsplat.evaluate.comparison.protocol import Protocol
from glsplat.evaluate.comparison.stage import Stage, StageTruth
from glsplat.evaluate.comparison.work import Result, Task, work

Pictures = dict[tuple[str, int, str], np.ndarray]
"""Participant, moment, view -> what both eyes should see, [2, H, W, 4]."""
Wrong = Callable[[Pictures, tuple[str, int, str]], np.ndarray]

PROTOCOL = Protocol(tasks=("standing", "turning"), views=("front", "left"), size=64, light="none")
MEASURED = ("l1", "psnr", "ssim", "lpips")
WRONG: dict[str, Wrong] = {
    "the other person": lambda pictures, key: pictures[{"p01": "p02", "p02": "p01"}[key[0]], *key[1:]],
    "one eye of one view": lambda pictures, key: (
        pictures[key] * np.array([1, key[2] != "left"], np.uint8)[:, None, None, None]
    ),
}


def by_hand(one: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Of two pictures [H, W, 4]; scikit-image's SSIM, and the mean square that stands in for LPIPS."""
    a, b = one[..., :3] / 255, truth[..., :3] / 255
    square = ((a - b) ** 2).mean()
    similar = structural_similarity(
        a, b, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    psnr = -10 * np.log10(square) if square else 120.0
    return {"l1": np.abs(a - b).mean(), "psnr": psnr, "ssim": similar, "lpips": square}


@pytest.fixture(scope="module")
def pictures() -> Pictures:
    """Filled by the first comparison."""
    return {}


def compare(
    wrong: Wrong, pictures: Pictures, people: list[Participant], out: Path, monkeypatch: pytest.MonkeyPatch
) -> list[Result]:
    """The comparison of a method that sees what is ``wrong`` with the truth."""

    class Told(Stage):
        def truth(self, moment: int, view: str) -> StageTruth:
            found = super().truth(moment, view)
            self.key = current, moment, view
            pictures[self.key] = found.pictures
            return found

        def draw(self, *_: object) -> np.ndarray:
            return wrong(pictures, self.key)

    monkeypatch.setattr(working, "Stage", Told)
    results = []
    for one in people:
        current = one.name
        task = Task(one, dict([method_of("itself")]), PROTOCOL, out, {"seed": 0})
        results += work(task, lambda *said: None)
    return results


@pytest.mark.check
@pytest.mark.usefixtures("no_lpips", "strangers")
@pytest.mark.parametrize("name", WRONG)
def test_tables_are_those_by_hand(people, pictures, tmp_path, monkeypatch, name) -> None:
    if not pictures:  # the other person's are needed before that person's turn
        compare(lambda pictures, key: pictures[key], pictures, people[:2], tmp_path / "first", monkeypatch)
    results = compare(WRONG[name], pictures, people[:2], tmp_path / "out", monkeypatch)
    assert not [one.failed for one in results if one.failed] and len(pictures) == 8
    hand = {
        key: [by_hand(*pair) for pair in zip(WRONG[name](pictures, key), truth, strict=True)]
        for key, truth in pictures.items()
    }

    def mean(measure: str, *parts: object) -> list[float]:
        """Of each participant, over the pictures whose key has all the ``parts``."""
        return [
            float(np.mean([e[measure] for key, eyes in hand.items() if {person, *parts} <= set(key) for e in eyes]))
            for person in ("p01", "p02")
        ]

    for row in tables.summary(results, ("itself",), 2):
        for measure in MEASURED:
            values = mean(measure)
            assert row[measure]["mean"] == pytest.approx(np.mean(values), abs=2e-6)
            assert row[measure]["sd"] == pytest.approx(np.std(values, ddof=1), abs=2e-6)
    for row in tables.by_participant(results, ("itself",)):
        for measure in MEASURED:
            wanted = mean(measure)[("p01", "p02").index(row["participant"])]
            assert row["pose"][measure] == row["tracking"][measure] == pytest.approx(wanted, abs=2e-6)
    for row in tables.by_view(results, ("itself",)):
        for measure in MEASURED:
            assert row[measure]["mean"] == pytest.approx(np.mean(mean(measure, row["view"])), abs=2e-6)
    for row in tables.by_moment(results, ("itself",)):
        place = ("standing", "turning").index(row["moment"])
        for measure in MEASURED:
            wanted = [
                float(np.mean([e[measure] for key, eyes in hand.items() if key[:2] == (person, place) for e in eyes]))
                for person in ("p01", "p02")
            ]
            assert row[measure]["mean"] == pytest.approx(np.mean(wanted), abs=2e-6)
    assert np.mean(mean("l1")) > 0
    if name == "one eye of one view":
        rows = {row["view"]: row for row in tables.by_view(results, ("itself",)) if row["control"] == "pose"}
        assert rows["front"]["l1"]["mean"] == 0 and rows["left"]["l1"]["mean"] > 0
