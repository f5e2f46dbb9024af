"""The serve command: its options, and a real process with a real renderer."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps import cli
from apps.serve import command as serve
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.formats import save
from glsplat.net.backend import RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import Client
from glsplat.net.codec.encode import encode_picture
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import Decoder, eye_fields
from glsplat.net.reply import decode_picture
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.skinning.pose import Pose
from tests.apps.cli import mistake, serving
from tests.scenes import limb

ROOT = Path(__file__).parents[3]


def test_options_are_settings_and_defaults_are_loopback_and_the_papers():
    config = serve.server_config(serving())
    assert (config.access.host, config.port, config.max_clients) == ("127.0.0.1", 8000, 8)
    assert (config.wire.size, config.wire.quality, config.wire.ipd, config.wire.fov) == ((1024, 1024), 80, 0.055, 65)
    assert not config.wire.mirror and config.tls is None and config.access.token is None
    assert config.limits == Limits() and config.access.hosts == () and not config.video and not config.webtransport
    assert config.session.adapt and config.session.bitrate is None  # pictures fit links unless they are fixed
    words = ("max-per-address=3", "max-waiting=9", "allow-host=a.example", "allow-host=*.b.example")
    config = serve.server_config(serving(*words, "max-size=256", "bitrate=8", "video=true", "webtransport=true"))
    assert config.limits == Limits(per_address=3, waiting=9) and config.access.hosts == ("a.example", "*.b.example")
    assert (config.wire.size, config.session.bitrate, config.video, config.webtransport) == (
        (256,) * 2,
        8e6,
        True,
        True,
    )
    for fixed in ("fixed=true", "study=plan.toml"):
        assert not serve.server_config(serving(fixed)).session.adapt


def test_further_avatars_are_called_like_their_files(tmp_path):
    for name in ("ann.glb", "ben.glb"):
        save(limb(20), tmp_path / name)
    args = serving("--avatar", tmp_path / "ann.glb", "--avatar", tmp_path / "ben.glb")
    assert list(serve.other_avatars(args)) == ["ann", "ben"] and serve.scene_name(args) == "default"
    assert serve.scene_name(serving(tmp_path / "ben.glb")) == "ben" and serve.other_avatars(serving()) == {}


def start(*words):
    command = [sys.executable, "-m", "apps.cli", "serve", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.extra(name="consent")
@pytest.mark.gl
def test_a_server_process_draws_and_ends_with_zero(capsys):
    process = start("--port", 0, "--size", 64, "--json")
    try:
        ready = json.loads(process.stdout.readline())
        taken = mistake(capsys, "serve", "--port", ready["port"])
        assert f"glsplat serve: port {ready['port']} is in use; choose another with --port" in taken
        eyes = stereo_cameras(head_matrix((0, 1.0, 2.0), (0, 0, 0, 1)), size=(96, 96))

        async def main():
            async with Client(ready["url"]) as client:
                first = await client.render(eyes, pose=Pose.zero(), crop=True)
                return first, await client.render(eyes[:1], pose=Pose.zero())

        pair, single = asyncio.run(main())
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out) == (0, "")
    assert re.fullmatch(r"\S+ INFO glsplat\.net\.session: client 1 at \S+ is marked as session [0-9a-f]{8}\n", err)
    left, right = pair.images()
    assert left.shape == (96, 96, 3) and left[48, 48].max() > 40 and left[:, 0].max() < 16
    assert not np.array_equal(left, right)
    assert list(single.pictures) == [0] and pair.info["driver"] == ready["driver"]
    assert {"pose", "draw", "render", "encode", "total"} <= set(pair.info["times"])


@pytest.mark.gl
def test_the_mirror_image_is_the_picture_of_the_mirrored_view():
    """Seen from straight ahead, mirroring the world equals flipping the picture and exchanging the eyes."""
    from glsplat.net.messages import WireOptions

    pose = np.zeros((55, 3))
    pose[16, 2], pose[17, 2] = -1.0, 0.4  # arms at different heights
    eyes = stereo_cameras(head_matrix((0, 1.0, 2.2), (0, 0, 0, 1)), size=(128, 128))
    text = json.dumps({"v": 1, "frame_id": 1, "size": [128, 128], "eyes": [eye_fields(eye) for eye in eyes]})
    backend = RendererBackend(default_avatar(), (128, 128))
    backend.open()
    try:
        images = {}
        for mirror in (False, True):
            request = Decoder(WireOptions(mirror=mirror)).decode(text)
            job = RenderJob(cameras=request.cameras, pose=Pose(pose, np.zeros(3)))
            images[mirror] = backend.render(job).images[..., :3].astype(int)
    finally:
        backend.close()
    flipped = images[False][::-1, :, ::-1]
    assert np.abs(images[True] - flipped).mean() < 0.5
    assert np.abs(images[True] - images[False]).mean() > 2


@pytest.mark.gl
def test_the_whole_pipe_equals_glsplat_render(tmp_path):
    """Request, server, renderer, JPEG, client: the same as JPEG of the picture that `glsplat render` writes."""
    eyes = stereo_cameras(head_matrix((0.1, 1.2, 2.0), (0, 0.05, 0, 0.9987)), size=(256, 192))
    rotations = np.random.default_rng(3).normal(0, 0.12, (55, 3))
    pose = Pose(rotations, np.array([0.05, 0, 0.1]))
    cameras, posed, target = tmp_path / "eyes.json", tmp_path / "pose.json", tmp_path / "direct.png"
    fields = [
        {"width": 256, "height": 192, "w2c": eye.viewmat.tolist()}
        | dict(zip(("fx", "fy", "cx", "cy"), (eye.K[0, 0], eye.K[1, 1], eye.K[0, 2], eye.K[1, 2]), strict=True))
        for eye in eyes
    ]
    cameras.write_text(json.dumps(fields))
    posed.write_text(json.dumps(pose.to_smplx()))
    assert cli.main(["render", "--cameras", str(cameras), "--pose", str(posed), "-o", str(target)]) == 0
    direct = cv2.cvtColor(cv2.imread(str(target)), cv2.COLOR_BGR2RGB)
    assert direct.shape == (192, 512, 3) and (direct.max(axis=2) > 40).mean() > 0.05

    async def main():
        server = gl_server(default_avatar(), ServerConfig(port=0))
        await server.start()
        try:
            async with Client(server.url) as client:
                kinds = ({"quality": 80}, {"quality": 97}, {"quality": 80, "crop": True})
                return [(kind, await client.render(eyes, pose=pose, **kind)) for kind in kinds]
        finally:
            await server.stop()

    for kind, reply in asyncio.run(main()):
        got = np.concatenate(reply.images(), axis=1)
        halves = np.split(direct, 2, axis=1)
        expected = [decode_picture(encode_picture(half, kind["quality"])) for half in halves]
        assert psnr(got, np.concatenate(expected, axis=1)) >= 50
        assert psnr(got, direct) > 30  # and it is the picture


def psnr(a, b):
    return 10 * np.log10(255**2 / max(np.mean((a.astype(float) - b) ** 2), 1e-9))
