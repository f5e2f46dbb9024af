"""The C# client of docs/examples/unity under Mono: vectors, a real server's pictures, faults, a scene of stubs."""

from __future__ import annotations

import asyncio
import base64
import json
import subprocess
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiohttp import web

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.extras.openxr.placing import ViewName, placing
from glsplat.extras.operations.certificate import kept_certificate
from glsplat.net import ServerConfig
from glsplat.net.client import Client
from glsplat.net.client.client import encoder, request_message
from glsplat.net.client.connection import ClientConnection
from glsplat.net.guard.access import Access
from glsplat.net.messages import Decoder, Request
from glsplat.net.reply import pack_reply
from glsplat.net.served_scene import gl_server
from glsplat.tracking.recording import embedded_recording
from tests.needs import require
from tests.net.client.test_twins import VECTORS
from tests.net.conftest import Serve, eyes
from tests.net.running import running
from tests.net.wire import HANG
from tests.twins import ROOT, check_answers, read_vectors

HERE = Path(__file__).parent
PACKAGE = ROOT / "docs" / "examples" / "unity"
CORE = sorted((PACKAGE / "Runtime" / "Core").glob("*.cs"))
TOKEN = "a-token-for-tests-of-32-characters"
FACING = stereo_cameras(
    head_matrix((0, 1.1, 2.2), (0, 0, 0, 1)), size=(160, 160)
)  # the recording's user looks along +z

pytestmark = pytest.mark.check


def compiled(folder: Path, name: str, *sources: Path, defines: str = "TESTS") -> Path:
    """Compile C# files to a program; fail with the compiler's words, warnings too."""
    require("mono")
    program = folder / f"{name}.exe"
    command = [
        "mcs",
        "-langversion:7",
        "-warnaserror",
        f"-define:{defines}",
        "-r:System.Numerics.dll",
        f"-out:{program}",
    ]
    done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stdout + done.stderr
    return program


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("csharp"), "runner", *CORE, HERE / "Runner.cs")


def answers(runner: Path, name: str, inputs: list[Any]) -> list[Any]:
    """Return what the C# client makes of a vector's inputs."""
    command = ["mono", str(runner), "vectors", name]
    done = subprocess.run(command, input=json.dumps(inputs), capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


Ask = Callable[[dict[str, Any]], Coroutine[Any, Any, Any]]


@asynccontextmanager
async def streaming(
    runner: Path, url: str, options: dict[str, Any] | None = None, token: str = "", fingerprint: str = ""
) -> AsyncIterator[Ask]:
    """Run the C# client; what it yields sends a request, or waits for a {"state"}, and returns the answer."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        "mono", str(runner), "stream", stdin=pipe, stdout=pipe, limit=1 << 24
    )
    assert process.stdin and process.stdout
    write, read = process.stdin.write, process.stdout.readline

    async def ask(message: dict[str, Any]) -> Any:
        write(encoder.encode(message) + b"\n")
        return json.loads(await asyncio.wait_for(read(), HANG))

    write(encoder.encode({"url": url, "options": options or {}, "token": token, "fingerprint": fingerprint}) + b"\n")
    try:
        yield ask
        process.stdin.close()
        assert await asyncio.wait_for(process.wait(), HANG) == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def uncounted(message: dict[str, Any]) -> dict[str, Any]:
    """Return a request without the fields that a client adds."""
    return {key: value for key, value in message.items() if key not in ("v", "frame_id", "ack")}


def test_the_package_has_at_most_900_lines_of_csharp() -> None:
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in PACKAGE.rglob("*.cs")) <= 900


def test_the_csharp_client_gives_the_vectors(runner: Path) -> None:
    vectors = read_vectors(VECTORS)
    for name, vector in vectors.items():
        found = answers(runner, name, [case["in"] for case in vector["cases"]])
        for answer, case in zip(found, vector["cases"], strict=True):
            if name == "reply" and answer and case["out"]:
                answer["depth"] = case["out"]["depth"]  # it asks for none, and reads none
        check_answers(vectors, name, found)


def test_the_csharp_client_places_views_as_the_page_does(runner: Path) -> None:
    cases = read_vectors(ROOT / "tests" / "extras" / "openxr" / "vectors.json")["views"]["cases"]
    for found, case in zip(answers(runner, "views", [case["in"] for case in cases]), cases, strict=True):
        for one, other in zip(found, case["out"], strict=True):
            assert np.abs(np.subtract(one["shown"], other["shown"])).max() < 1e-5
            assert np.abs(np.subtract(one["server"], other["server"])).max() < 1e-5


@pytest.mark.gl
async def test_a_recording_gets_the_pictures_that_python_gets(runner: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each client has its own connection, so its own solver: they send the same samples with the same times."""
    sent: list[dict[str, Any]] = []
    send = ClientConnection.send_text

    async def sending(connection: ClientConnection, text: str) -> None:
        sent.append(json.loads(text))
        await send(connection, text)

    monkeypatch.setattr(ClientConnection, "send_text", sending)
    samples = [sample.to_json() for sample in embedded_recording()[:240:20]]
    async with running(gl_server(default_avatar(), ServerConfig(port=0), own_process=False)) as server:
        async with Client(server.url) as client:
            wanted = [await client.render(FACING, tracking=one, alpha="straight", crop=True) for one in samples]
        async with streaming(runner, server.url) as ask:
            found = [await ask(uncounted(message)) for message in sent]
    for one, reply in zip(found, wanted, strict=True):
        assert [(eye, base64.b64decode(colour), base64.b64decode(alpha)) for eye, colour, alpha in one["eyes"]] == [
            (eye, reply.pictures[eye], reply.alphas[eye]) for eye in (0, 1)
        ]
    assert len({one["eyes"][0][1] for one in found}) == len(found) == 12  # the person moves


async def test_token_certificate_and_refusals(runner: Path, serve: Serve, tmp_path: Path) -> None:
    kept = kept_certificate(tmp_path, ())
    config = ServerConfig(port=0, tls=(kept.path, kept.path), access=Access(tls=True, token=TOKEN))
    request = uncounted(request_message(1, eyes()))
    async with serve(config=config) as server:
        async with streaming(runner, server.url, token=TOKEN, fingerprint=kept.fingerprint) as ask:
            assert (await ask(request))["id"] == 1
            assert await ask(request | {"quality": 1000}) == {"code": "bad_request", "frame_id": 2}
            assert (await ask(request))["id"] == 3
        for fingerprint in ("", kept.fingerprint.translate(str.maketrans("0123456789", "1234567890"))):
            async with streaming(runner, server.url, token=TOKEN, fingerprint=fingerprint) as ask:
                assert "no connection (" in (await ask({"state": "Waiting"}))["reason"]
        async with streaming(runner, server.url, token="wrong", fingerprint=kept.fingerprint) as ask:
            assert (await ask({"state": "Off"}))["reason"].startswith("the server refuses (401): ")  # and never again
        async with streaming(runner, server.url.replace("wss:", "ws:"), token=TOKEN) as ask:
            assert "does it want wss://?" in (await ask({"state": "Waiting"}))["reason"]
        async with streaming(runner, server.url, {"avatar": "nobody"}, TOKEN, kept.fingerprint) as ask:
            assert "(400): " in (reason := (await ask({"state": "Waiting"}))["reason"]) and "default" in reason


Handle = Callable[[web.Request], Coroutine[Any, Any, web.StreamResponse]]


@asynccontextmanager
async def scripted(handle: Handle) -> AsyncIterator[str]:
    """Run a server of a test's own; yield its address."""
    app = web.Application()
    app.router.add_get("/ws", handle)
    served = web.AppRunner(app, shutdown_timeout=1)
    await served.setup()
    await web.TCPSite(served, "127.0.0.1", 0).start()
    try:
        yield f"ws://127.0.0.1:{served.addresses[0][1]}"
    finally:
        await served.cleanup()


async def test_a_broken_connection_comes_back_as_the_same_person(runner: Path) -> None:
    """A server that is full at first, then drops a connection within a picture, and answers the next one."""
    queries: list[dict[str, str]] = []
    requests: list[dict[str, Any]] = []

    async def handle(request: web.Request) -> web.StreamResponse:
        queries.append(dict(request.query))
        if len(queries) == 1:
            return web.Response(status=503, headers={"Retry-After": "1"}, text="the server is full\n")
        socket = web.WebSocketResponse(compress=False)
        await socket.prepare(request)
        async for message in socket:
            requests.append(json.loads(message.data))
            number = requests[-1]["frame_id"]
            info = {"size": [8, 8], "room": {"resume": "again"}}
            picture = pack_reply(number, [0], [b"\xff\xd8" + bytes(300_000)], info)
            if len(queries) == 2 and number == 2:
                assert request.transport is not None
                request.transport.write(b"\x82\x7f" + len(picture).to_bytes(8, "big") + picture[:200_000])
                await asyncio.sleep(0.05)
                request.transport.abort()
                break
            await socket.send_bytes(picture)
        return socket

    person = {"room": "lab", "name": "Jürgen B."}
    async with scripted(handle) as url, streaming(runner, url, dict(person)) as ask:
        waiting = await ask({"state": "Waiting"})
        assert waiting["reason"] == "the server refuses (503): the server is full; trying again"
        assert (await ask({"size": [8, 8]}))["id"] == 1
        assert (await ask({"size": [9, 9], "lost": True}))["reason"].startswith("no connection (")
        assert (await ask({"size": [8, 8]}))["id"] == 1
    assert queries == [person, person, person | {"resume": "again"}]
    assert [(one["frame_id"], one["ack"]) for one in requests] == [(1, 0), (2, 1), (1, 0)]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole package with stubs of Unity's types; without XR Hands it compiles, too."""
    sources = [*sorted(PACKAGE.rglob("*.cs")), HERE / "UnityStubs.cs", HERE / "Scene.cs"]
    folder = tmp_path_factory.mktemp("scene")
    compiled(folder, "without", *sources)
    return compiled(folder, "scene", *sources, defines="GLSPLAT_HANDS")


@pytest.mark.parametrize("view", ["Mirror", "Facing", "Own", "Room", "Desktop"])
async def test_a_scene_requests_and_shows_pictures_where_their_eyes_saw_them(
    scene: Path, tmp_path: Path, view: str
) -> None:
    """Unity's axes are left-handed: a picture's corner lies where the server's camera projects to that pixel."""
    sent: list[dict[str, Any]] = []
    count = 1 if view == "Desktop" else 2
    crops = [[16, 0, 32, 48], [0, 16, 64, 32]][:count]
    jpegs, alphas = ([b"\xff\xd8" + name + bytes([eye]) for eye in range(count)] for name in (b"colour", b"alpha"))

    async def handle(request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(compress=False)
        await socket.prepare(request)
        async for message in socket:
            asked = json.loads(message.data)
            if "frame_id" not in asked:
                continue
            sent.append(asked)
            info = {"size": [64, 64], "crop": crops, "times": {"total": 5}}
            with suppress(ConnectionError):  # it has seen enough
                await socket.send_bytes(pack_reply(asked["frame_id"], range(count), jpegs, info, alphas))
        return socket

    async with scripted(handle) as url:
        command = ["mono", str(scene), url, view, str(tmp_path)]
        done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    shown = [jpegs[0], alphas[0], jpegs[-1], alphas[-1]]
    assert [base64.b64decode(one) for one in found["pictures"]] == shown and found["opaque"] == 0
    assert "fps, " in found["label"] and "(5 at the server)" in found["label"]
    hidden = sent[0].pop("hide", None)
    request = Decoder().decode(json.dumps(sent[0]))  # as the server does; a mirrored camera reflects
    assert isinstance(request, Request) and len(request.cameras) == count
    place = np.eye(4)
    if view == "Desktop":
        assert "tracking" not in sent[0]
    else:
        tracking = sent[0]["tracking"]
        head = head_matrix(tracking["head"][:3], tracking["head"][3:])
        name: ViewName = {"Facing": "facing", "Own": "own"}.get(view, "mirror")
        place = placing(name, head).shown
        assert sent[0].get("mirror", False) == (name == "mirror") and hidden == (["head"] if name == "own" else None)
        assert len(tracking["right_joints"]) == 75 and tracking["left_curl"] == 0.625 and "right_grip" not in tracking
        np.testing.assert_allclose(tracking["leftEye"], (0, 0, -1), atol=1e-5)
        if view == "Room":  # over the origin, looking along +z
            assert np.abs(head[[0, 2], 3]).max() < 1e-5 and abs(head[0, 2]) < 1e-5 and head[2, 2] < -0.9
        else:  # the poses of Scene.cs
            np.testing.assert_allclose(tracking["head"], (0.2, 1.6, -0.1, -0.1, -0.5, 0, 0.860233), atol=1e-5)
            np.testing.assert_allclose(tracking["left_grip"], (-0.3, 1, -0.4, 0, 0, 0, 1), atol=1e-5)
            np.testing.assert_allclose(tracking["right"], (0.01, 1, -0.5, 0, 0, 0, 1), atol=1e-5)
            np.testing.assert_allclose(tracking["right_joints"][3:6], (0.03, 1, -0.5), atol=1e-5)  # without the palm
    for eye, camera in enumerate(request.cameras):
        x, y, width, height = crops[eye]
        pixels = [(x + i % 2 * width, y + (1 - i // 2) * height) for i in range(4)]  # from the lower left, row by row
        points = np.array(found["corners"][4 * eye : 4 * eye + 4]) * (1, 1, -1)
        own = (points - place[:3, 3]) @ place[:3, :3]  # the shown space to the user's
        seen = own @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        np.testing.assert_allclose(seen[:, 2], seen[0, 2], atol=1e-4)  # a plane across the eye's axis
        assert seen[0, 2] >= 0.3
        projected = seen @ camera.K.T
        np.testing.assert_allclose(projected[:, :2] / projected[:, 2:], pixels, atol=0.02)
