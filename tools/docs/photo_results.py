"""Makes an avatar of each participant's capture and holds it against the participant, for docs/photo-results.md.

    python -m tools.docs.photo_results OUT [--avatars DIR] [--steps N] [p01 p02 ...]

With --avatars, DIR/p01.glb ... are shown instead of made; --steps are those of fitting splats, 0 for none.
OUT gets photo-results-1.jpg and -2.jpg (of everybody the photograph, then the avatar from the front, the left and the
back, and the participant below) and photo-worst.jpg (those that are farthest from the truth); tables are printed: of
each person PSNR by side and overlap, then the four figures over all sides.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from glsplat.avatar import Avatar
from glsplat.extras.authoring.check.capture import check_capture
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.authoring.photo.photo_file import read_photo
from glsplat.extras.authoring.reconstruct.builtin import Builtin
from glsplat.extras.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.extras.evaluate.light import CaptureLight, shade_of
from glsplat.extras.evaluate.metrics.lpips import Lpips
from glsplat.extras.evaluate.metrics.pixels import l1, psnr
from glsplat.extras.evaluate.metrics.structure import ssim
from glsplat.formats import load
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.conftest import SHARED_DATA
from tests.extras.authoring.captures import capture
from tools.docs.filmed import SIZE, VIEWS, views_of

CROP = 0.66  # share of the square's width that the sheets show
SHOWN = ("front", "left", "back")
WORST, DOZEN = 5, 12


@dataclass(frozen=True, eq=False)
class Result:
    """What one photograph gave; the pictures are RGB in [0, 1] by view."""

    name: str
    photograph: np.ndarray
    truth: dict[str, np.ndarray]
    drawn: dict[str, np.ndarray]

    def mean(self, measure: Callable[[np.ndarray, np.ndarray], float], *views: str) -> float:
        """Of these views, over the whole squares."""
        return float(np.mean([measure(self.drawn[view], self.truth[view]) for view in views]))

    def psnr(self, *views: str) -> float:
        """dB."""
        return self.mean(psnr, *views)

    def overlap(self, view: str) -> float:
        """Intersection over union of the two figures."""
        a, b = (pictures[view].max(axis=2) > 0.02 for pictures in (self.truth, self.drawn))
        return float((a & b).sum() / (a | b).sum())


def avatar_of(name: str, steps: int) -> Avatar:
    folder = SHARED_DATA / "participants"
    people = json.loads((folder / "participants.json").read_text())["participants"]
    height = next(float(person["height_m"]) for person in people if person["id"] == name)
    photo = read_photo(folder / "capture" / f"{name}.jpg")
    seen = check_capture(photo.picture)
    if seen.person is None:
        raise SystemExit(f"{name}: {seen.findings[0].text}")
    pictures = {"front": Picture(photo.picture, photo.focal, seen.person)}
    return Builtin().reconstruct(pictures, {"front": seen.mask}, Options(height=height, steps=steps))


def result_of(name: str, avatar: Avatar) -> Result:
    person = capture(name)
    pose = Pose(person.pose)
    vertices = person.mesh.posed(pose)
    cameras = views_of(vertices)
    with Renderer(avatar, size=(SIZE, SIZE), views=len(cameras)) as renderer:
        drawn = renderer.render(list(cameras.values()), pose)[..., :3] / 255.0
    shade = shade_of(person.mesh, vertices, CaptureLight.of_note(person.light))
    with MeshTruth(person.mesh, size=(SIZE, SIZE)) as renderer:
        truth = renderer.render(list(cameras.values()), pose, shade=shade)[..., :3] / 255.0
    by_view = [dict(zip(cameras, pictures, strict=True)) for pictures in (truth, drawn)]
    return Result(name, person.picture / 255.0, *by_view)


def block(result: Result) -> np.ndarray:
    """The photograph, then the views: the avatar above, the participant below."""
    edge = round(SIZE * (1 - CROP) / 2)
    rows = [np.hstack([views[view][:, edge:-edge] for view in SHOWN]) for views in (result.drawn, result.truth)]
    views = np.vstack(rows)
    scale = len(views) / len(result.photograph)
    photograph = cv2.resize(result.photograph, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    whole = np.ascontiguousarray(255 * np.hstack([photograph[: len(views)], views])).astype(np.uint8)
    label = f"{result.name}  {result.psnr(*VIEWS):.1f} dB"
    cv2.putText(whole, label, (10, 34), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (0, 0, 0), 2, cv2.LINE_AA)
    return whole


def sheet(path: Path, results: list[Result], columns: int, scale: float) -> None:
    blocks = [block(result) for result in results]
    width = max(part.shape[1] for part in blocks)
    blocks = [np.pad(part, ((0, 6), (0, width - part.shape[1] + 6), (0, 0)), constant_values=255) for part in blocks]
    blocks += [np.full_like(blocks[0], 255)] * (-len(blocks) % columns)
    rows = [np.hstack(blocks[index : index + columns]) for index in range(0, len(blocks), columns)]
    small = cv2.resize(np.vstack(rows), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])
    print(path, path.stat().st_size // 1024, "kB")


def main(folder: Path, names: list[str], avatars: Path | None, steps: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    results = []
    print("| | front | sides | back | overlap: front | left | back |")
    for name in names:
        avatar = load(str(avatars / f"{name}.glb")) if avatars else avatar_of(name, steps)
        assert isinstance(avatar, Avatar)
        one = result_of(name, avatar)
        results.append(one)
        levels = [one.psnr("front"), one.psnr("left", "right"), one.psnr("back")]
        figures = [*(f"{level:.1f}" for level in levels), *(f"{one.overlap(view):.2f}" for view in SHOWN)]
        print("|", " | ".join([name, *figures]), "|", flush=True)
    for number, first in enumerate(range(0, len(results), DOZEN), 1):
        sheet(folder / f"photo-results-{number}.jpg", results[first : first + DOZEN], 4, 0.32)
    sheet(folder / "photo-worst.jpg", sorted(results, key=lambda one: one.psnr(*VIEWS))[:WORST], 2, 0.56)
    network = Lpips("alex")

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return network.distance(network.features(a), network.features(b))

    print("| | L1 | PSNR dB | SSIM | LPIPS |")
    table = np.array([[one.mean(measure, *VIEWS) for measure in (l1, psnr, ssim, distance)] for one in results])
    for label, row in zip([*names, "mean"], [*table, table.mean(axis=0)], strict=True):
        print(f"| {label} | {row[0]:.4f} | {row[1]:.2f} | {row[2]:.4f} | {row[3]:.4f} |")
    for label, views in (("front", ("front",)), ("sides", ("left", "right")), ("back", ("back",))):
        print(label, round(float(np.mean([one.psnr(*views) for one in results])), 2))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--avatars", type=Path)
    parser.add_argument("--steps", type=int, default=Options().steps)
    parser.add_argument("names", nargs="*", default=[f"p{number:02d}" for number in range(1, 25)])
    given = parser.parse_intermixed_args()
    main(given.out, given.names, given.avatars, given.steps)
