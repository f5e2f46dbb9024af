"""Writes docs/images/evaluation.jpg: the person of an evaluation whose avatar of one photograph is the median one.

    glsplat evaluate --participants DIR -o OUT
    python -m tools.docs.evaluation_row DIR OUT

From left to right: the photograph, the participant, and the avatars of all methods, driven by the true pose; below, the
same from behind. Methods have to be the project's own.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.evaluate.comparison.control import true_poses
from glsplat.extras.evaluate.comparison.participant import participants_in
from glsplat.extras.evaluate.comparison.performance import perform
from glsplat.extras.evaluate.comparison.protocol import Protocol
from glsplat.extras.evaluate.comparison.stage import Stage
from glsplat.formats import load
from glsplat.scene import is_rigged

ROOT = Path(__file__).resolve().parents[2]
METHODS = {"photo": "photo (splats)", "mesh-image": "mesh-image", "mesh-video": "mesh-video", "scan": "scan (splats)"}
TASK, PIXELS = "waving", 512


def median_person(out: Path) -> tuple[str, dict[str, float]]:
    """Who is in the middle by PSNR of ``photo`` under the true pose, and that of each method."""
    rows = [row for row in json.loads((out / "evaluation.json").read_text())["participants"] if "pose" in row]
    photo = sorted((row["pose"]["psnr"], row["participant"]) for row in rows if row["method"] == "photo")
    name = photo[len(photo) // 2][1]
    return name, {row["method"]: row["pose"]["psnr"] for row in rows if row["participant"] == name}


def cut(picture: NDArray[np.uint8], columns: slice) -> NDArray[np.uint8]:
    """Over mid grey, so that dark clothes are seen; RGBA to BGR."""
    alpha = picture[..., 3:] / 255.0
    return np.rint(picture[..., 2::-1] + (1 - alpha) * 96).astype(np.uint8)[:, columns]


def main() -> None:
    """Draw and write."""
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    name, psnr = median_person(out)
    one = next(one for one in participants_in(folder) if one.name == name)
    protocol = Protocol(tasks=(TASK,), size=PIXELS)
    performance = perform(one.mesh, protocol.tasks)
    columns = slice(PIXELS // 2 - 150, PIXELS // 2 + 150)
    rows = []
    with Stage(one.mesh, performance, protocol) as stage:
        figures = {}
        for method in METHODS:
            figure = load(out / "avatars" / method / f"{name}.glb")
            assert is_rigged(figure)
            pose = true_poses(performance, one.mesh.skeleton, figure.skeleton)[0]
            figures[method] = stage.add(figure), pose
        for view in ("front", "back"):
            truth = stage.truth(0, view)
            tiles = [cut(truth.pictures[0], columns)]
            for place, pose in figures.values():
                tiles.append(cut(stage.draw(place, truth.cameras, pose)[0], columns))
            rows.append(np.hstack(tiles))
    photo = cv2.imread(str(one.photo))
    height = rows[0].shape[0]
    small = cv2.resize(photo, (round(photo.shape[1] * height / photo.shape[0]), height), interpolation=cv2.INTER_AREA)
    empty = np.full_like(small, 255)
    page = np.vstack([np.hstack([small, rows[0]]), np.hstack([empty, rows[1]])])
    words = ["photograph", "participant", *(f"{word} {psnr[method]:.1f} dB" for method, word in METHODS.items())]
    at = [4, *(small.shape[1] + 4 + 300 * place for place in range(len(METHODS) + 1))]
    band = np.full((24, page.shape[1], 3), 40, np.uint8)
    for word, x in zip(words, at, strict=True):
        cv2.putText(band, word, (x, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
    page = np.vstack([band, page])
    target = ROOT / "docs" / "images" / "evaluation.jpg"
    cv2.imwrite(str(target), page, [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(f"{target}: {name}, {page.shape[1]} x {page.shape[0]}")


if __name__ == "__main__":
    main()
