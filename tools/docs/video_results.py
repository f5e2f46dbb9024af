"""Makes a mesh of each participant's turntable, and an avatar of their photograph, and holds both against them.

    python -m tools.docs.video_results OUT [p13 p14 ...]

OUT gets p13.png ...: two poses that no frame shows, from the front, the left and the back, of the participant, the mesh
and the photograph's avatar. A table is printed: PSNR and overlap of eight poses, the frames' overlap, joints.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from tools.docs.filmed import SHOWN, cameras_of, compared, drawn, filmed
from tools.docs.photo_results import avatar_of

POSES = "T-pose", "stride"


def main(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    print("| | video: dB front, left, back | overlap | photo: dB front, left, back | overlap | frames | joints mm |")
    for name in names:
        filming = filmed(name)
        cameras = cameras_of(filming.person.mesh)
        truth, rows, cells = list(drawn(filming.person.mesh, cameras)), [], []
        for thing in (filming.made.thing, avatar_of(name)):
            pictures = list(drawn(thing, cameras))
            rows.append(pictures)
            levels = []
            for view in SHOWN:
                mine = [index for index, key in enumerate(cameras) if key[1] == view]
                levels.append(compared([truth[index] for index in mine], [pictures[index] for index in mine])[0])
            cells += [", ".join(f"{level:.1f}" for level in levels), f"{compared(truth, pictures)[1]:.3f}"]
        print("|", " | ".join([name, *cells, f"{filming.overlap():.3f}", f"{filming.joints():.0f}"]), "|", flush=True)
        chosen = [index for index, key in enumerate(cameras) if key[0] in POSES]
        sheet = np.vstack([np.hstack([each[index][..., :3] for index in chosen]) for each in (truth, *rows)])
        cv2.imwrite(str(folder / f"{name}.png"), (255 * sheet.clip(0, 1)).astype(np.uint8)[..., ::-1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", default=["p13", "p14", "p15", "p16"])
    given = parser.parse_args()
    main(given.out, given.names)
