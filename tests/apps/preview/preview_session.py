"""What test_preview.py runs under Xvfb: one window led through layouts, sizes and rest; findings as JSON.

A process of its own: a window's GLX context and the EGL context of the other tests do not share a thread.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import glfw
import numpy as np

from apps.preview.cameras import Options
from apps.preview.command import loop
from apps.preview.viewer import Viewer
from apps.preview.window import Window
from glsplat.formats import load


def main(scene_file: str, out: str) -> None:
    found: dict[str, Any] = {"screen is capture": [], "sizes": []}
    with Window((200, 150), "session") as window:
        options = Options(eye=(0.4, 0.3, 3.0), target=(0.7, 0.0, 0.0), background=(0.1, 0.2, 0.3))
        viewer = Viewer(load(scene_file), window.context, window.size, options, "scene")
        window.attach(viewer)
        handle = window._window
        # a callback can be had by setting another one
        key, wheel = glfw.set_key_callback(handle, None), glfw.set_scroll_callback(handle, None)
        errors: list[str] = []

        def press(code: int) -> np.ndarray:
            key(handle, code, 0, glfw.PRESS, 0)
            loop(window, viewer, 1)
            return viewer.capture()

        def screen() -> np.ndarray:
            # the picture that the next swap shows: drawn again, as the last swap left the buffer undefined
            viewer.draw(window.framebuffer)
            errors.append(window.context.ctx.error)
            data = window.framebuffer.read(viewport=(0, 0, *viewer.size), components=3, alignment=1)
            window.context.ctx.error  # noqa: B018  (moderngl names an attachment that a window has not)
            return np.frombuffer(data, np.uint8).reshape(viewer.size[1], viewer.size[0], 3)[::-1]

        for code in (glfw.KEY_2, glfw.KEY_3, glfw.KEY_1):
            first = press(code)
            found["screen is capture"].append(bool(np.array_equal(screen(), first)))
        distance = viewer.view.distance
        wheel(handle, 0.0, 2.0)
        found["zoom"] = viewer.view.distance / distance
        found["reset"] = bool(np.array_equal(press(glfw.KEY_R), first))
        for size in ((1, 1), (201, 151), (200, 150)):
            window.resize(*size)
            end = time.monotonic() + 30
            while viewer.size != size and time.monotonic() < end:
                window.wait(0.01)
            loop(window, viewer, 1)
            found["sizes"].append(list(viewer.capture().shape[1::-1]))
        found["after resizing"] = bool(np.array_equal(viewer.capture(), first))

        # nothing changes: nothing is drawn and no time is spent
        while viewer.overlay.left > 0:
            viewer.advance(1.0)
        draws, turns, draw, wait = [], [], viewer.draw, window.wait
        viewer.draw = lambda *args, **kw: (draws.append(1), draw(*args, **kw))[1]  # type: ignore[method-assign]
        window.wait = lambda seconds: (turns.append(seconds), wait(seconds))[1]  # type: ignore[method-assign]

        def stop() -> None:
            viewer.closing = True
            glfw.post_empty_event()

        threading.Timer(0.6, stop).start()
        loop(window, viewer)
        found |= {"draws": len(draws), "turns": len(turns)}
        viewer.closing = False
        glfw.set_window_should_close(handle, True)
        glfw.post_empty_event()
        loop(window, viewer)  # returns at once
        found["gl errors"] = [*errors, window.context.ctx.error]
        viewer.release()
    (Path(out) / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
