"""The serve command: its options, and a real process with a real renderer."""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from apps import serve
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import GlsplatError
from glsplat.net.client import Client
from glsplat.skinning.pose import Pose

ROOT = Path(__file__).parents[2]


def arguments(*words):
    parser = argparse.ArgumentParser()
    serve.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def test_defaults_are_loopback_and_the_papers_setting():
    config = serve.server_config(arguments())
    assert (config.access.host, config.port, config.max_clients) == ("127.0.0.1", 8000, 8)
    assert (config.wire.size, config.wire.quality, config.wire.ipd, config.wire.fov) == ((1024, 1024), 80, 0.055, 65)
    assert not config.wire.mirror and config.tls is None and config.access.token is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--host", "0.0.0.0"], "--tls-cert, --tls-key and --token-file"),
        (["--port", 70000], "--port needs 0 to 65535, not 70000"),
        (["--quality", 0], "--quality needs 1 to 100"),
        (["--max-clients", 0], "--max-clients needs 1 to 256"),
        (["--window", 0], "--window needs 1 to 8"),
        (["--size", 4096], "raise --max-size"),
        (["--fov", 180], "--fov 1 to 170"),
        (["--tls-cert", "a.pem"], "TLS needs both --tls-cert and --tls-key"),
        (["--token-file", "nowhere"], "nowhere: cannot read the token"),
    ],
)
def test_options_are_checked(words, message):
    with pytest.raises(GlsplatError, match=message):
        serve.server_config(arguments(*words))


def start(*words):
    command = [sys.executable, "-m", "apps.cli", "serve", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere.glb"], "glsplat serve: nowhere.glb: no such file"),
        (["--tls-cert", "nowhere.pem", "--tls-key", "nokey.pem"], "nowhere.pem: expected a PEM file for TLS"),
        (["--port", "TAKEN"], "glsplat serve: port TAKEN is in use; choose another with --port"),
    ],
)
def test_mistakes_of_a_first_user_are_one_line(words, message):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        process = start(*(word.replace("TAKEN", port) for word in words))
        out, err = process.communicate(timeout=60)
    assert process.returncode == 1 and out == ""
    assert err.count("\n") == 1 and message.replace("TAKEN", port) in err


@pytest.mark.gl
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_server_process_draws_and_ends_with_zero(end):
    process = start("--port", 0, "--size", 64, "--json")
    try:
        ready = json.loads(process.stdout.readline())
        eyes = stereo_cameras(head_matrix((0, 1.0, 2.0), (0, 0, 0, 1)), size=(96, 96))

        async def main():
            async with Client(ready["url"]) as client:
                first = await client.render(eyes, pose=Pose.zero(), crop=True)
                return first, await client.render(eyes[:1], pose=Pose.zero())

        pair, single = asyncio.run(main())
        process.send_signal(end)
        out, err = process.communicate(timeout=20)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (0, "", "")
    left, right = pair.images()
    assert left.shape == (96, 96, 3) and left[48, 48].max() > 40 and left[:, 0].max() < 16
    assert not np.array_equal(left, right)
    assert list(single.pictures) == [0] and pair.info["driver"] == ready["driver"]
    assert {"pose", "draw", "render", "encode", "total"} <= set(pair.info["times"])


@pytest.mark.gl
def test_the_mirror_image_is_the_picture_of_the_mirrored_view():
    """Seen from straight ahead, mirroring the world equals flipping the picture and exchanging the eyes."""
    from glsplat.avatar import default_avatar
    from glsplat.net.messages import Decoder, WireOptions, eye_fields

    pose = np.zeros((55, 3))
    pose[16, 2], pose[17, 2] = -1.0, 0.4  # arms at different heights
    eyes = stereo_cameras(head_matrix((0, 1.0, 2.2), (0, 0, 0, 1)), size=(128, 128))
    text = json.dumps({"v": 1, "frame_id": 1, "size": [128, 128], "eyes": [eye_fields(eye) for eye in eyes]})
    backend = serve.RendererBackend(default_avatar(), (128, 128))
    backend.open()
    try:
        images = {}
        for mirror in (False, True):
            request = Decoder(WireOptions(mirror=mirror)).decode(text)
            object.__setattr__(request, "pose", Pose(pose, np.zeros(3)))
            images[mirror] = backend.render(request).images[..., :3].astype(int)
    finally:
        backend.close()
    flipped = images[False][::-1, :, ::-1]
    assert np.abs(images[True] - flipped).mean() < 0.5
    assert np.abs(images[True] - images[False]).mean() > 2


def tracked(frame_id, x, **more):
    tracking = {"head": [x, 1.55, 0.1, 0, 0, 0, 1], "left": None, "right": [x + 0.3, 1.2, -0.3, 0, 0, 0, 1]}
    return {"v": 1, "frame_id": frame_id, "t": frame_id * 14.0, "size": [64, 64], "tracking": tracking, **more}


def test_tracking_becomes_a_pose_in_the_avatars_space():
    from glsplat.avatar import default_avatar
    from glsplat.net.messages import Decoder
    from glsplat.tracking.calibration import Calibration
    from glsplat.tracking.sample import Sample
    from glsplat.tracking.tracker import Tracker

    skeleton = default_avatar().skeleton
    calibration = Calibration(scale=1.25, floor=0.1)
    solver, alone = serve.TrackingSolver(skeleton, calibration), Tracker(skeleton, calibration)
    decoder = Decoder()
    requests = [decoder.decode(json.dumps(tracked(i, i * 0.005))) for i in range(20)]
    for request in requests:
        expected = alone.update(Sample.from_json(request.tracking, request.t / 1e3))
    solver.solve(requests[0], 0.0)
    earlier = tuple((request.t, request.tracking) for request in requests[1:19])
    object.__setattr__(requests[19], "earlier", earlier)
    solved = solver.solve(requests[19], 0.0)  # one drawn request after eighteen dropped ones: the same pose
    np.testing.assert_array_equal(solved.pose.rotations, expected.rotations)
    np.testing.assert_array_equal(solved.pose.trans, expected.trans)
    assert "left_lost" in solved.notes
    for mine, theirs in zip(solved.cameras, requests[19].cameras, strict=True):
        np.testing.assert_allclose(mine.position, (theirs.position - (0, 0.1, 0)) / 1.25)
        np.testing.assert_array_equal(mine.viewmat[:3, :3], theirs.viewmat[:3, :3])


@pytest.mark.gl
def test_a_recording_of_head_and_hands_moves_the_avatar():
    from glsplat.avatar import default_avatar
    from glsplat.net.server import ServerConfig

    async def main():
        server = serve.make_server(default_avatar(), ServerConfig(port=0))
        await server.start()
        try:
            async with Client(server.url, height=1.8) as client:
                eyes = stereo_cameras(head_matrix((0, 1.2, 2.5), (0, 0, 0, 1)), size=(64, 64))
                first = await client.render(eyes, tracking=tracked(1, 0.0)["tracking"])
                for x in np.linspace(0, 0.3, 12):
                    reply = await client.render(eyes, tracking=tracked(1, x)["tracking"])
                return first, reply
        finally:
            await server.stop()

    first, last = asyncio.run(main())
    assert last.info["times"]["ik"] > 0 and "left_lost" in last.info["tracking"]
    columns = [np.flatnonzero(reply.images()[0].max(axis=(0, 2)) > 40).mean() for reply in (first, last)]
    assert columns[1] > columns[0] + 2  # the head moved to +x, the picture to the right
