"""Draws the README's pictures anew: the clip, a photograph beside its avatar, people in a room.

    python -m tools.docs.readme_pictures [clip] [photo] [room]        # into docs/images

The photograph is of a participant that comes with glsplat. Look at every picture.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

import glsplat
from apps.serve.wiring import assemble
from glsplat.data import participants_folder, person
from glsplat.formats.motion_files import load_motion
from glsplat.formats.scene_file import SceneFile
from glsplat.io.files import replace_file
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import ServedScene
from glsplat.net.server import Server
from glsplat.rotations import FLIP_YZ
from tests.browser.served import Served
from tests.browser.vr import settings
from tools.docs.chromium import chromium, page_of

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
SIDE, ACROSS = 768, 800  # pixels an eye as drawn; of the clip, both eyes
RATE, SECONDS = 12, 6.0  # of the clip
LIMIT = 2_000_000  # bytes of the clip
WALL = (0.82, 0.84, 0.87)
WHO = "p05"  # of the participants


def smaller(image: np.ndarray, across: int) -> np.ndarray:
    """So many pixels wide."""
    return cv2.resize(image, (across, round(image.shape[0] * across / image.shape[1])), interpolation=cv2.INTER_AREA)


def clip() -> None:
    """readme-clip.webp: both eyes of somebody who stands before ben, forth and back: its end meets its beginning."""
    avatar = person("ben")
    motion = load_motion("wave-and-turn", avatar.skeleton)
    head = np.linalg.inv(FLIP_YZ @ glsplat.look_at((-0.2, 1.6, 1.5), (-0.2, 1.46, 0.0)))
    eyes = glsplat.stereo_cameras(head, ipd=0.063, fov=50, size=(SIDE, SIDE), background=WALL)
    frames = []
    with glsplat.Renderer(avatar, size=(SIDE, SIDE), views=2) as renderer:
        for i in range(round(RATE * SECONDS / 2)):
            smile = {name: 0.6 * np.sin(np.pi * i / 36) for name in ("mouthSmileLeft", "mouthSmileRight")}
            blink = {name: float(i % 24 in (11, 12)) for name in ("eyeBlinkLeft", "eyeBlinkRight")}
            pair = renderer.render(eyes, replace(motion.at(i / RATE), expression=smile | blink))
            frames.append(Image.fromarray(smaller(np.hstack([pair[0], pair[1]])[..., :3], ACROSS)))
    frames += frames[-2:0:-1]
    for quality in range(80, 20, -10):
        out = io.BytesIO()
        pace = {"duration": 1000 // RATE, "loop": 0}
        frames[0].save(out, "WEBP", save_all=True, append_images=frames[1:], quality=quality, **pace)
        if out.tell() <= LIMIT:
            break
    write("readme-clip.webp", out.getvalue())


def photo() -> None:
    """readme-photo.jpg: the photograph, and the avatar from three sides."""
    with tempfile.TemporaryDirectory() as made:
        picture, avatar = participants_folder() / "capture" / f"{WHO}.jpg", Path(made) / "me.glb"
        pose = Path(made) / "pose.json"  # the photograph's own
        turns = np.array(json.loads(picture.with_suffix(".json").read_bytes())["pose"])
        pose.write_text(json.dumps({k: np.asarray(v).tolist() for k, v in glsplat.Pose(turns).to_smplx().items()}))
        run("avatar", "photo", str(picture), "-o", str(avatar))
        row = [read(picture)]
        for i, eye in zip(count(), ((0.0, 1.0, 2.9), (2.1, 1.0, 2.1), (-2.4, 1.0, -1.7))):
            shot = Path(made) / f"{i}.png"
            place = ",".join(map(str, eye))
            run("render", str(avatar), "--eye", place, "--target", "0,0.92,0", "--background", "0.86,0.86,0.88",
                "--size", "600x900", "--fov", "40", "--pose", str(pose), "-o", str(shot))  # fmt: skip
            row.append(read(shot))
    height = 520
    tiles = [
        cv2.resize(t, (round(t.shape[1] * height / t.shape[0]), height), interpolation=cv2.INTER_AREA) for t in row
    ]
    write_jpeg("readme-photo", np.hstack(tiles)[..., ::-1])


def room() -> None:
    """readme-room.jpg: three people of one room, as one of them sees them on the flat page."""
    config = ServerConfig(port=0, rooms={"lab": 3})
    who = {"Anna": "anna", "Mei": "mei", "Ben": "default"}
    others = {name: person(name) for name in ("anna", "mei")}

    def made(config: ServerConfig) -> Server:
        scene, rooms = SceneFile.of(glsplat.default_avatar()), {"lab": SceneFile.of(glsplat.Scene([]))}
        return assemble(ServedScene(file=scene, title="ben", avatars=others, rooms=rooms), config)

    with Served(make=made, config=config) as served, chromium() as browser, ExitStack() as stack:
        for name, avatar in who.items():
            init = settings(size=768, room="lab", name=name, avatar=avatar, driver="motion:idle")
            page = stack.enter_context(page_of(browser, served.page, init, (960, 600), xr=False))
        page.until("window.glsplat.stats().shown > 12", 240)
        shot = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
    write_jpeg("readme-room", np.asarray(shot))


def read(path: Path) -> np.ndarray:
    """A picture as OpenCV has it."""
    image = cv2.imread(str(path))
    assert image is not None
    return image


def run(*words: str) -> None:
    """A command of glsplat."""
    subprocess.run([sys.executable, "-m", "apps.cli", *words], check=True)


def write(name: str, data: bytes) -> None:
    replace_file(IMAGES / name, [data])
    print(IMAGES / name, len(data) // 1000, "kB")


def write_jpeg(name: str, image: np.ndarray) -> None:
    encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 86])[1]
    write(f"{name}.jpg", encoded.tobytes())


if __name__ == "__main__":
    for kind in sys.argv[1:] or ("clip", "photo", "room"):
        {"clip": clip, "photo": photo, "room": room}[kind]()
