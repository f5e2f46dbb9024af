"""How far the picture of a mouth is behind the sound, in Chromium with a microphone that plays a file.

    python -m tools.net.voice_delay                          # pictures of what `glsplat serve` draws
    python -m tools.net.voice_delay --here                   # drawn by the page from poses
    python -m tools.net.voice_delay --beside ../before --turns 4     # another checkout, in turns with this one
    python -m tools.net.voice_delay -- --config exact.toml   # the server's options

The microphone says "aa" for half a second, then nothing for a second, again and again. A listener of its own in the
page, which hears nothing but how loud a piece of 128 samples is, notes when each begins; what is sent is looked at for
a jaw that opens, and the page's own numbers for the picture of that request, or of a newer one that was drawn instead.
Where the page draws by itself, it is the first frame that it draws with a jaw that opens.

Told are also the parts of the way, and the whole in times of a picture (from one to the next): what is many pictures
long waits in a queue, what is one or two and long in milliseconds waits for a slow renderer.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.speech.sound import Sound
from tests import needs
from tests.browser.conftest import _FLAGS
from tests.extras.speech.sounds import vowels, wav_bytes

_HERE = Path(__file__).resolve().parents[2]
_LATEST = 700.0  # ms after a sound in which its jaw opens, or it was not heard

WATCH = """
(() => {
  // [ms] of sounds; [ms, frame_id] of requests with a jaw that opens, of pictures decoded and on the screen;
  // [frame_id, ms, ms it was sent, its server's times] of replies; [ms] of frames drawn here with a jaw that opens
  const seen = (window.delays = { sounds: [], sent: [], came: [], decoded: [], shown: [], drawn: [] });
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  const code = `registerProcessor('loud', class extends AudioWorkletProcessor {
    process([[samples]]) {
      const loud = samples && samples.some((v) => Math.abs(v) > 0.02);
      if (loud && currentTime - (this.last ?? -9) > 0.4) this.port.postMessage(Date.now());
      if (loud) this.last = currentTime;
      return true;
    }
  });`;
  navigator.mediaDevices.getUserMedia = async (wanted) => {
    const stream = await ask({ audio: true });
    const context = new AudioContext({ latencyHint: 'interactive' });
    await context.audioWorklet.addModule(URL.createObjectURL(new Blob([code], { type: 'text/javascript' })));
    const node = new AudioWorkletNode(context, 'loud', { numberOfOutputs: 0 });
    node.port.onmessage = ({ data }) => seen.sounds.push(data - performance.timeOrigin);
    context.createMediaStreamSource(stream).connect(node);
    return stream;
  };
  const opening = (then) => {
    let open = false;
    return (jaw) => {
      if (jaw > 0.06 && !open) then();
      open = jaw > 0.03 && (open || jaw > 0.06);
    };
  };
  const at = new Map(); // when a request was sent, by its number
  let newest = 0;
  const asks = opening(() => seen.sent.push([performance.now(), newest]));
  const draws = opening(() => seen.drawn.push([performance.now(), 0]));
  const reading = import('/vr/stream/reply.js');
  const decoding = []; // numbers of the replies that are with the decoder
  window.Worker = class extends Worker { // the page's socket is in one (stream/socket.js), its decoder in another
    constructor(...what) {
      super(...what);
      this.addEventListener('message', ({ data }) => {
        const now = performance.now();
        if (data.pictures && decoding.length) seen.decoded.push([now, decoding.shift()]);
        if (!(data.message instanceof ArrayBuffer) || new DataView(data.message).getUint8(8) === 0) return;
        const copy = data.message.slice(0); // the page gives it away
        reading.then(({ parseReply }) => {
          const { id, info } = parseReply(copy);
          seen.came.push([id, now, at.get(id), info.times]);
        });
      });
    }

    postMessage(told, ...rest) {
      if (told?.buffer && told.eyes) decoding.push(new DataView(told.buffer).getUint32(4, true));
      const found = told?.text && JSON.parse(told.text);
      if (found?.frame_id) {
        newest = found.frame_id;
        at.set(newest, performance.now());
        asks((found.pose ?? found.tracking)?.expression?.jawOpen ?? 0);
      }
      super.postMessage(told, ...rest);
    }
  };
  const look = () => {
    const { shownId = 0, drawn = {} } = window.glsplat?.stats() ?? {};
    if (shownId !== seen.shown.at(-1)?.[1]) seen.shown.push([performance.now(), shownId]);
    if (drawn.jaw !== undefined) draws(drawn.jaw);
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""


@contextmanager
def serving(tree: Path, options: Sequence[str]) -> Iterator[str]:
    """The address of the page of a server of that checkout, in a process of its own."""
    words = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json", *options]
    where: dict[str, Any] = {"cwd": tree, "env": os.environ | {"PYTHONPATH": str(tree)}}
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, **where) as server:
        try:
            assert server.stdout is not None
            yield json.loads(server.stdout.readline())["page"]
        finally:
            server.terminate()


def watched(address: str, here: bool, seconds: float, size: int) -> dict[str, Any]:
    """What the page was seen to do, and its figures."""
    from playwright.sync_api import sync_playwright

    rate = 48000
    said = np.concatenate([np.zeros(rate // 2), vowels(0.5, rate, each=9), np.zeros(rate // 2)]).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        file = Path(folder) / "said.wav"
        file.write_bytes(wav_bytes(Sound(said, rate)))
        flags = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
        flags += [f"--use-file-for-fake-audio-capture={file}", "--autoplay-policy=no-user-gesture-required"]
        flags += [flag for flag in _FLAGS if not flag.startswith("--js-flags")]
        browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=flags)
        context = browser.new_context(viewport={"width": size, "height": size}, bypass_csp=True)
        context.add_init_script(WATCH)
        drawn = "here" if here else "server"
        kept = f'localStorage.setItem(\'glsplat.settings\', \'{{"size": 512, "drawn": "{drawn}"}}\')'
        context.add_init_script(kept)
        page = context.new_page()
        page.goto(address)
        page.wait_for_function("window.glsplat && glsplat.stats().shownId > 3", timeout=120_000)
        page.evaluate("document.querySelector('#voice-talk').click()")  # it is behind the drawer
        before = page.evaluate("glsplat.stats().shown")
        page.wait_for_timeout(1000 * seconds)
        found: dict[str, Any] = page.evaluate("delays")
        found["stats"] = page.evaluate("glsplat.stats()")
        found["rate"] = (found["stats"]["shown"] - before) / seconds
        browser.close()
    return found


PARTS = (
    "heard, and sent",
    "another picture is drawn: a newer request took its place",
    "waits at the server",
    "drawn",
    "encoded",
    "on the way, both",
    "decoded",
    "shown with the next frame of the page",
)


HERE = ("heard, and sent", "drawn here, and shown with the next frame of the page")


def measured(found: dict[str, Any]) -> tuple[list[float], list[list[float]]]:
    """Milliseconds that each sound's picture is behind it, and the parts of those of which all are known."""
    came = {number: (arrived, asked, times) for number, arrived, asked, times in found["came"]}
    decoded = {number: t for t, number in found["decoded"]}
    local = found["stats"]["drawn"]["by"] == "here" and found["drawn"]
    behind, parts = [], []
    for begin in found["sounds"][1:]:  # the first may have begun before anything listened
        opens, frame = next(((t, frame) for t, frame in found["sent"] if t >= begin), (np.inf, 0))
        if local:
            shows = next((t for t, _ in found["drawn"] if t >= begin), np.inf)
            if shows - begin < _LATEST:
                behind.append(shows - begin)
                parts.append([opens - begin, shows - opens])
            continue
        shows, number = next(((t, shown) for t, shown in found["shown"] if shown >= frame), (None, 0))
        if opens - begin > _LATEST or shows is None:
            continue
        behind.append(shows - begin)
        if number in came and number in decoded:
            arrived, asked, times = came[number]
            server = [times[name] for name in ("wait", "render", "encode")]
            way = arrived - asked - sum(server)
            ready = decoded[number]
            parts.append([opens - begin, asked - opens, *server, way, ready - arrived, shows - ready])
    return behind, parts


def tell(name: str, runs: list[dict[str, Any]]) -> float:
    """Print what all runs of a checkout came to; returns the median."""
    behind, parts = [], []
    for found in runs:
        some, more = measured(found)
        behind += some
        parts += more
    spread = np.percentile(behind, [10, 50, 90]).round().tolist() if behind else []
    fps = statistics.mean(found["rate"] for found in runs)
    frames = statistics.mean(found["stats"]["frameRate"] for found in runs)
    print(f"{name}: {len(behind)} sounds, ms behind at 10, 50, 90 %: {spread}")
    by = runs[-1]["stats"]["drawn"]["by"]
    print(f"drawn by {by}, {fps:.1f} pictures and {frames:.1f} frames of the page a second")
    for what, values in zip(HERE if by == "here" else PARTS, zip(*parts, strict=True), strict=False):
        print(f"{statistics.median(values):7.0f} ms  {what}")
    median = statistics.median(behind) if behind else np.nan
    print(f"median: {median:.0f} ms, {median * fps / 1000:.2f} pictures", flush=True)
    return float(median)


def main() -> None:
    """Runs in turns, then what they came to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--here", action="store_true")
    parser.add_argument("--seconds", type=float, default=40, help="of each turn")
    parser.add_argument("--size", type=int, default=512, help="of the window, pixels")
    parser.add_argument("--beside", type=Path, help="another checkout, whose server and page take turns with these")
    parser.add_argument("--turns", type=int, default=1, help="of each checkout")
    parser.add_argument("options", nargs="*", help="of `glsplat serve`, behind --")
    args = parser.parse_args()
    trees = [_HERE] if args.beside is None else [args.beside.resolve(), _HERE]
    runs: dict[Path, list[dict[str, Any]]] = {tree: [] for tree in trees}
    for turn in range(args.turns):
        for tree in trees if turn % 2 == 0 else trees[::-1]:
            with serving(tree, args.options) as address:
                found = watched(address, args.here, args.seconds, args.size)
            runs[tree].append(found)
            behind, _ = measured(found)
            said = f"{statistics.median(behind or [np.nan]):.0f} ms, {found['rate']:.1f} pictures a second"
            print(f"turn {turn + 1}, {tree.name}: {said}; load {os.getloadavg()[0]:.1f}", flush=True)
    medians = [tell(tree.name, runs[tree]) for tree in trees]
    if len(medians) == 2:
        print(f"{medians[1] / medians[0]:.2f} of the time")


if __name__ == "__main__":
    main()
