"""The replay client: what it reports, what it saves, and its errors."""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import socket
from pathlib import Path
from random import Random
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import simplejpeg

from apps.replay import command as replay
from apps.replay import latency
from apps.replay import link as link_module
from apps.replay.link import Link, link, over
from apps.replay.stage_table import comparison_markdown, table_text
from apps.replay.streaming import STAGES, Result, observer
from glsplat.errors import GlsplatError
from glsplat.net.flow import POLICIES
from glsplat.net.reply import pack_reply, parse_reply
from tests.apps.cli import parsed


def recording(path, count=10):
    lines = [json.dumps({"t": i / 30, "head": [0, 1.6, 0, 0, 0, 0, 1], "left": None}) for i in range(count)]
    path.write_text("\n".join([*lines, ""]))
    return path


def test_the_report_adds_up(stripes, capsys):
    url, backend = stripes
    args = parsed(replay, "walk", "--url", url, "--frames", 40, "--fps", 60, "--size", "64x64", "--json")
    assert replay.run(args) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["sent"] == 40 and out["received"] + out["dropped"] == 40 and out["errors"] == 0
    assert out["shown"] + out["late"] == out["received"] > 1
    assert out["driver"] == "numpy" and out["bytes_per_frame"] > 500
    stages = {name: row["median"] for name, row in out["stages_ms"].items()}
    assert set(stages) == {key for key, _, _ in STAGES} | {"render/skin", "render/draw"}
    assert 0 < stages["render"] < stages["end_to_end"]
    assert out["age_ms"]["median"] >= stages["end_to_end"] - 1
    poses = [request.pose for request in backend.requests]
    assert not np.array_equal(poses[0].rotations, poses[-1].rotations)  # the motion moves
    spots = [request.cameras[0].position for request in backend.requests]
    assert 0 < np.linalg.norm(spots[-1] - spots[0]) < 1  # the observer sways


def test_pictures_are_saved(stripes, tmp_path):
    words = ("walk", "--url", stripes[0], "--frames", 8, "--fps", 20, "--size", 64)
    for name in ("sheet.png", "clip.mp4", "pairs/"):
        assert replay.run(parsed(replay, *words, "--save", f"{tmp_path}/{name}")) == 0
    files = sorted((tmp_path / "pairs").glob("*.png"))
    assert 1 <= len(files) <= 8
    image = cv2.imread(str(files[0]))
    assert image.shape == (64, 128, 3) and image[32, 32, 2] > 180 and image[32, 96, 2] > 180
    clip = cv2.VideoCapture(str(tmp_path / "clip.mp4"))
    assert clip.get(cv2.CAP_PROP_FRAME_WIDTH) == 128 and clip.get(cv2.CAP_PROP_FRAME_COUNT) >= 1
    clip.release()
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] == 2 * 128 + 4
    assert {p.name for p in tmp_path.iterdir()} == {"sheet.png", "clip.mp4", "pairs"}


def test_a_recording_is_sent_as_tracking(stripes, tmp_path):
    url, backend = stripes
    path = recording(tmp_path / "head.jsonl")
    with pytest.raises(GlsplatError, match=r"^this server has no tracking solver: send pose instead of tracking$"):
        replay.run(parsed(replay, path, "--url", url, "--frames", 3, "--size", 64))
    assert not backend.requests
    drive, seconds = replay.load_drive(str(path))
    assert seconds == pytest.approx(0.3)
    assert drive.at(0.1).tracking["head"] == [0, 1.6, 0, 0, 0, 0, 1] and drive.at(99.0).pose is None
    for text in ("", "{", '{"t": 0}', '{"head": [1]}', "[" * 5000):
        path.write_text(text)
        with pytest.raises(GlsplatError, match=r"head\.jsonl"):
            replay.load_drive(str(path))


def test_the_observer_sees_the_whole_avatar():
    for seconds in np.linspace(0, 60, 40):
        for camera in observer(seconds, np.array([0.5, 0.1, -0.2]), (400, 300)):
            for point in ((0.5, 0.0, -0.2), (0.5, 1.85, -0.2), (0.0, 1.2, -0.2), (1.0, 1.2, -0.2)):
                x, y, z = camera.K @ (camera.viewmat @ (*point, 1))[:3]
                assert z > 1 and 0 < x / z < 400 and 0 < y / z < 300


def test_tables_of_runs_have_medians_and_say_where_they_were_measured():
    result = Result(sent=2, received=2, shown=2, seconds=0.5, driver="llvmpipe", nbytes=[1000, 3000], ages=[10.0, 12.0])
    result.times = {"render": [20.0, 30.0], "render/draw": [15.0, 16.0], "end_to_end": [40.0, 41.0]}
    stages = [line.split() for line in table_text(result).splitlines()]
    assert ["stereo", "rendering", "server", "25.00", "29.50"] in stages
    result.replies, result.waits = [24.0, 35.0], [1.0, 2.0]
    text = comparison_markdown([("loopback", "newest", result), ("20 ms", "newest", result)])
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1 and len(rows) == 4
    assert rows[2].startswith("| loopback | newest | 4.0 | 25.0 | 0.10 | 4.5 |")
    assert "llvmpipe" in text and "simplejpeg" in text


def test_smaller_pictures_between_are_enlarged(tmp_path: Path) -> None:
    """A server that holds a rate sends them; a clip and a sheet have one size."""
    kept = []
    for i, side in enumerate((64, 32, 64, 40)):
        image = np.full((side, side, 3), 50 * i, np.uint8)
        jpeg = simplejpeg.encode_jpeg(image)
        kept.append((0.1 * i, parse_reply(pack_reply(i, (0, 1), [jpeg, jpeg], {"size": [side, side]}))))
    replay.save_sheet(tmp_path / "sheet.png", kept)
    assert "4 pictures" in replay.save_clip(tmp_path / "clip.webm", kept)
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] >= 2 * 128


def test_policies_are_compared_and_a_loop_ends_by_its_time(stripes, capsys):
    url, backend = stripes
    words = ("walk", "--url", url, "--fps", 60, "--size", "64x64", "--json")
    assert replay.run(parsed(replay, *words, "--seconds", 0.5)) == 0
    assert json.loads(capsys.readouterr().out)["sent"] == 30
    backend.delay = 0.01
    assert replay.run(parsed(replay, *words, "--frames", 20, "--compare", "--link", "0,1000", "--link", "30,50")) == 0
    runs = json.loads(capsys.readouterr().out)
    places = ("0 ms, 1000 Mbit/s", "30 ms, 50 Mbit/s")
    assert [(run["link"], run["policy"]) for run in runs] == [(place, how) for place in places for how in POLICIES]
    for run in runs:
        assert run["received"] + run["dropped"] == run["sent"] and run["errors"] == 0
    assert all(run["beyond_render_ms"]["median"] >= 29 for run in runs[3:])  # the round trip


class Hours(asyncio.SelectorEventLoop):
    """Time passes at once where everybody waits for it: what a link takes is what it says, on any machine."""

    def __init__(self):
        super().__init__()
        self.passed, self._servers = 0.0, {}
        select = self._selector.select

        def jump(timeout=None):
            ready = select(timeout and 0)
            if not ready and timeout:
                self.passed += timeout
            return ready

        self._selector.select = jump

    def time(self):
        return self.passed

    async def create_server(self, factory, host, port):
        """Its connections are pairs of sockets, which hand over at once: loopback may be late."""
        port = len(self._servers) + 1
        self._servers[port] = factory
        return SimpleNamespace(sockets=[SimpleNamespace(getsockname=lambda: (host, port))], close=lambda: None)

    async def create_connection(self, factory, host, port):
        near, far = socket.socketpair()
        await self.connect_accepted_socket(self._servers[port], far)
        return await super().create_connection(factory, sock=near)


def now():
    return asyncio.get_running_loop().time()


@pytest.fixture
def hours(monkeypatch):
    monkeypatch.setattr(link_module, "time", SimpleNamespace(perf_counter=now))

    def run(coroutine):
        with asyncio.Runner(loop_factory=Hours) as runner:
            return runner.run(coroutine)

    return run


async def far(answer, simulated, use):
    """``use(reader, writer)`` at the near end of a link to a server that runs ``answer`` for each connection."""
    tasks = []

    async def connected(reader, writer):
        tasks.append(asyncio.current_task())
        try:
            await answer(reader, writer)
        except ConnectionError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(connected, "127.0.0.1", 0)
    try:
        async with over(simulated, f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}/ws") as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                return await use(reader, writer)
            finally:
                writer.close()
                await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        server.close()


async def echo(reader, writer):
    while data := await reader.read(65536):
        writer.write(data)
        await writer.drain()


def test_the_round_trip_takes_as_long_as_the_link_says(hours):
    async def use(reader, writer):
        times = []
        for _ in range(8):
            start = now()
            writer.write(b"ping")
            assert await reader.readexactly(4) == b"ping"
            times.append((now() - start) * 1e3)
        return times

    assert hours(far(echo, Link(40, 100), use)) == pytest.approx([40] * 8, abs=0.1)
    assert hours(far(echo, Link(0, 1000), use)) == pytest.approx([0] * 8, abs=0.1)


def test_a_megabyte_takes_its_time_and_arrives_whole(hours):
    data = np.random.default_rng(0).bytes(500_000)

    async def send(reader, writer):
        writer.write(data)
        await writer.drain()

    async def use(reader, writer):
        start = now()
        assert await reader.read(-1) == data  # to the end: that the server closed comes through
        return now() - start

    took = hours(far(send, Link(20, 20), use))
    assert took == pytest.approx(0.21, abs=0.001)  # 4 Mbit at 20 Mbit/s, and 10 ms one way


def test_a_fast_sender_is_held_back(hours):
    """The link takes what it can deliver and a queue; more stays with the sender, as with TCP."""
    state = {"written": 0}

    async def send(reader, writer):
        writer.transport.set_write_buffer_limits(high=16384)
        for _ in range(1000):
            writer.write(b"\0" * 16384)
            await writer.drain()
            state["written"] += 16384

    async def use(reader, writer):
        await asyncio.sleep(0.5)
        return state["written"]

    # 8 Mbit/s pass 0.5 MB in that time; the queue is 128 kB; the sockets' own buffers hold a few hundred kB
    assert hours(far(send, Link(10, 8), use)) < 4e6


def test_links_are_checked():
    assert str(link("20,100")) == "20 ms, 100 Mbit/s" and str(link("20,100,1.5")) == "20 ms, 100 Mbit/s, 1.5 % lost"
    for text in ("", "20", "20,", "a,b", "-1,10", "10,0", "nan,10", "10,inf", "1,2,-1", "1,2,51", "1,2,3,4", "1,2,"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"a link is RTT,MBIT\[,LOSS\], for example 20,100"):
            link(text)


def test_a_lost_packet_comes_a_round_trip_later():
    """One in ten of 5,000, and of those one in ten twice; without loss none."""
    chance = Random(4)
    late = np.array([Link(40, 10, 10).loss_delay(1448, chance) for _ in range(5000)])
    assert set(np.round(late / 0.04).tolist()) <= {0, 1, 2, 3, 4, 5}
    assert abs(np.mean(late >= 0.04) - 0.1) < 0.02 and abs(np.mean(late >= 0.08) - 0.01) < 0.006
    assert np.mean([Link(40, 10, 10).loss_delay(4096, chance) > 0 for _ in range(2000)]) > 0.2  # three packets
    assert not any(Link(40, 10).loss_delay(10**6, chance) for _ in range(20))


@pytest.mark.check
@pytest.mark.gl
def test_a_short_stream_is_measured_stage_by_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "_SIZES", ((64, 64), (96, 96)))
    monkeypatch.setattr(latency, "_SECONDS", (0.5, 0.6))
    result = latency.measure(quick=False)
    assert json.loads(json.dumps(result)) == result and not multiprocessing.active_children()
    assert [run["size"] for run in result["runs"]] == [[64, 64], [96, 96]] and result["driver"]
    for run in result["runs"]:
        stages = run["stages"]
        assert list(stages) == [key for key, _, _ in STAGES] and run["pictures_a_second"] > 0
        assert all(0 <= stage["median"] <= stage["p95"] for stage in stages.values())
        assert min(stages[key]["median"] for key in ("ik", "render", "encode", "decode")) > 0
        assert stages["end_to_end"]["p95"] >= max(stage["median"] for stage in stages.values())
    table = latency.rows(result)
    assert table[0] == ["stage", "where", "paper", "2 x 64x64: median", "p95", "2 x 96x96: median", "p95"]
    assert [row[:3] for row in table[1:]] == [[name, place, latency.PAPER[key]] for key, name, place in STAGES]
    assert all(len(row) == 7 and float(row[3]) >= 0 for row in table[1:])
