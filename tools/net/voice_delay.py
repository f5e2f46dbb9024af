"""How far the picture of a mouth is behind the sound, in Chromium with a microphone that plays a file.

    python -m tools.net.voice_delay             # pictures of the server's
    python -m tools.net.voice_delay --here      # drawn by the page from poses

The microphone says "aa" for half a second, then nothing for a second, again and again. A listener of its own in the
page, which hears nothing but how loud a piece of 128 samples is, notes when each begins; what is sent is looked at for
a jaw that opens, and the page's own numbers for the picture of that request, or of a newer one that was drawn instead.

Told are also the parts of the way, and the whole in times of a picture (from one to the next): what is many pictures
long waits in a queue, what is one or two and long in milliseconds waits for a slow renderer.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.data import default_avatar
from glsplat.net.backends.server import make_server
from glsplat.net.options import ServerConfig
from glsplat.speech.sound import Sound, wav_bytes
from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.served import Served
from tests.speech.sounds import vowels

WATCH = """
(() => {
  const seen = (window.delays = { sounds: [], sent: [], shown: [] });
  const ask = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
  const code = `registerProcessor('loud', class extends AudioWorkletProcessor {
    process([[samples]]) {
      const loud = samples && samples.some((v) => Math.abs(v) > 0.02);
      if (loud && currentTime - (this.last ?? -9) > 0.4) this.port.postMessage(0);
      if (loud) this.last = currentTime;
      return true;
    }
  });`;
  navigator.mediaDevices.getUserMedia = async (wanted) => {
    const stream = await ask({ audio: true });
    const context = new AudioContext({ latencyHint: 'interactive' });
    await context.audioWorklet.addModule(URL.createObjectURL(new Blob([code], { type: 'text/javascript' })));
    const node = new AudioWorkletNode(context, 'loud', { numberOfOutputs: 0 });
    node.port.onmessage = () => seen.sounds.push(performance.now());
    context.createMediaStreamSource(stream).connect(node);
    return stream;
  };
  let open = false;
  const at = new Map(); // when a request was sent, by its number
  seen.came = []; // [number, ms after it was sent, its server's times]
  const reading = import('/vr/stream/reply.js');
  window.Worker = class extends Worker { // the page's socket is in one (stream/socket.js)
    constructor(...what) {
      super(...what);
      this.addEventListener('message', ({ data: { message } }) => {
        const now = performance.now();
        if (!(message instanceof ArrayBuffer) || new DataView(message).getUint8(8) === 0) return;
        const copy = message.slice(0); // the page gives it away
        reading.then(({ parseReply }) => {
          const { id, info } = parseReply(copy);
          seen.came.push([id, now, at.get(id), info.times]);
        });
      });
    }

    postMessage(told, ...rest) {
      const found = told?.text && JSON.parse(told.text);
      if (found?.frame_id) {
        at.set(found.frame_id, performance.now());
        const jaw = (found.pose ?? found.tracking)?.expression?.jawOpen ?? 0;
        if (jaw > 0.06 && !open) seen.sent.push([performance.now(), found.frame_id]);
        open = jaw > 0.03 && (open || jaw > 0.06);
      }
      super.postMessage(told, ...rest);
    }
  };
  const look = (now) => {
    const id = window.glsplat?.stats().shownId ?? 0;
    if (id !== seen.shown.at(-1)?.[1]) seen.shown.push([performance.now(), id]);
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""


def measured(here: bool, seconds: float, size: int) -> dict[str, Any]:
    """Milliseconds behind the beginning of each sound, of what was sent and of its picture."""
    from playwright.sync_api import sync_playwright

    rate = 48000
    said = np.concatenate([np.zeros(rate // 2), vowels(0.5, rate, each=9), np.zeros(rate // 2)]).astype(np.float32)
    serving = Served(make=lambda config: make_server(default_avatar(), config), config=ServerConfig(port=0))
    with tempfile.TemporaryDirectory() as folder, serving as served, sync_playwright() as play:
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
        page.goto(served.page)
        page.wait_for_function("window.glsplat && glsplat.stats().shownId > 3", timeout=120_000)
        page.evaluate("document.querySelector('#voice-talk').click()")  # it is behind the drawer
        page.wait_for_timeout(1000 * seconds)
        found = page.evaluate("delays")
        stats = page.evaluate("glsplat.stats()")
        browser.close()
    sent, shown, parts = [], [], []
    came = {number: (arrived, asked, times) for number, arrived, asked, times in found["came"]}
    for begin in found["sounds"][1:]:
        after = next(((t, frame) for t, frame in found["sent"] if t >= begin), None)
        if after is None or after[0] - begin > 700:
            continue
        picture, number = next(((t, frame) for t, frame in found["shown"] if frame >= after[1]), (None, 0))
        sent.append(after[0] - begin)
        if picture is None:
            continue
        shown.append(picture - begin)
        if number in came:
            arrived, asked, times = came[number]
            server = sum(times[name] for name in ("wait", "render", "encode"))
            parts.append([
                *(after[0] - begin, asked - after[0], times["wait"], times["render"], times["encode"]),
                *(arrived - asked - server, picture - arrived),
            ])  # fmt: skip
    drawn_by = stats["drawn"]["by"]
    return {"sent": sent, "shown": shown, "parts": parts, "stats": stats, "by": drawn_by}


PARTS = (
    "heard, and sent with the next frame of the page",
    "another picture is drawn: a newer request took its place",
    "waits at the server",
    "drawn",
    "encoded",
    "on the way, both",
    "decoded, and shown with the next frame of the page",
)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--here", action="store_true")
    parser.add_argument("--seconds", type=float, default=40)
    parser.add_argument("--size", type=int, default=512, help="of the window, pixels")
    args = parser.parse_args()
    began = time.monotonic()
    result = measured(args.here, args.seconds, args.size)
    for what in ("sent", "shown"):
        values = result[what]
        spread = np.percentile(values, [10, 50, 90]).round().tolist() if values else []
        print(f"{what}: {len(values)} times, ms at 10, 50, 90 %: {spread}")
    stats = result["stats"]
    print(f"drawn by {result['by']}, {stats['fps']} pictures and {stats['frameRate']} frames of the page a second")
    for what, values in zip(PARTS, zip(*result["parts"], strict=True), strict=False):
        print(f"{statistics.median(values):7.0f} ms  {what}")
    if result["shown"]:
        median = statistics.median(result["shown"])
        print(f"median: {median:.0f} ms, {median * stats['fps'] / 1000:.2f} pictures; {time.monotonic() - began:.0f} s")
