"""Run one scenario against Monado, within the chroot, for test_monado.py; print the results as JSON."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import glsplat
from glsplat.config import RenderConfig
from glsplat.extras.openxr import LocalShow, OpenXrRuntime, Session, Wearer
from glsplat.extras.openxr.eyes import EyeImages
from glsplat.extras.openxr.runtime import State
from glsplat.gl.context import Context, create_context
from glsplat.gl.functions import gl_functions
from tools.peers.monado.remote import Script, Sender

VALIDATION = "XR_APILAYER_LUNARG_core_validation"
RECORD = Path("/tmp/validation.txt")
TURNED = (0.04, 0.3, -0.02, 0.9529)  # looks left, a little down and aside; not of unit length


class Service:
    """monado-service with the null compositor and the remote driver."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        socket = Path(os.environ["XDG_RUNTIME_DIR"]) / "monado_comp_ipc"
        socket.unlink(missing_ok=True)
        environment = os.environ | {"XRT_COMPOSITOR_NULL": "1", "XRT_NO_STDIN": "1"}
        with open("/tmp/monado.txt", "a") as log:
            self._process = subprocess.Popen(["monado-service"], env=environment, stdout=log, stderr=log)
        limit = time.monotonic() + 60
        while not socket.exists():
            assert time.monotonic() < limit and self._process.poll() is None, Path("/tmp/monado.txt").read_text()
            time.sleep(0.05)

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()


def windowed(stack: ExitStack) -> Context:
    """Return the GLX context of a hidden window on a virtual screen."""
    from apps.preview.window import Window

    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24", "+extension", "GLX", "-nolisten", "tcp"]
    os.makedirs("/tmp/.X11-unix", exist_ok=True)
    screen = subprocess.Popen(words, pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stack.callback(screen.wait)
    stack.callback(screen.terminate)
    with os.fdopen(read) as pipe:
        os.environ["DISPLAY"] = f":{pipe.readline().strip()}"
    return stack.enter_context(Window((320, 240), "hidden", visible=False)).context


def frames(session: Session, count: int, seconds: float = 240) -> None:
    """Step the session until ``count`` more frames were rendered."""
    until, limit = session.rendered + count, time.monotonic() + seconds
    while session.rendered < until and session.step():
        assert time.monotonic() < limit, f"{session.rendered} of {until} frames"


def reader(ctx: Any) -> Any:
    """Return a function that reads an array texture as bytes [2, H, W, 4] or depth [2, H, W], row 0 first."""
    function = gl_functions(ctx)
    bind = function("BindTexture", None, ctypes.c_uint, ctypes.c_uint)
    get = function("GetTexImage", None, *[ctypes.c_uint] * 2, ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p)

    def read(texture: int, size: tuple[int, int], deep: bool = False) -> np.ndarray:
        shape = (2, size[1], size[0])
        out = np.empty(shape, np.float32) if deep else np.empty((*shape, 4), np.uint8)
        bind(0x8C1A, texture)
        get(0x8C1A, 0, *((0x1902, 0x1406) if deep else (0x1908, 0x1401)), out.ctypes.data)
        bind(0x8C1A, 0)
        return out

    return read


def main(scenario: str) -> dict[str, Any]:
    service, sender, heard, said = Service(), Sender(), [], []
    with ExitStack() as stack:
        context = windowed(stack) if scenario == "window" else create_context()
        out: dict[str, Any] = {"driver": context.driver}
        stack.enter_context(context)
        compared = scenario in ("pictures", "window")
        wearer = Wearer("facing" if compared else "mirror", heard=heard.append)
        timed = scenario == "time"
        show = LocalShow(glsplat.default_avatar(), context, wearer, floor=timed, timed=timed)
        layers = () if timed else (VALIDATION,)
        session = Session(lambda: OpenXrRuntime(context, layers=layers), show, say=said.append)
        assert session.runtime is not None and show.eyes is not None
        out |= {"runtime": session.runtime.name, "extensions": sorted(session.runtime.extensions)}
        out |= {"layers": show.eyes.layers, "depth": show.eyes.depth, "size": show.eyes.size}
        frames(session, 3)
        if compared:
            out |= pictures(session, show, sender, heard, reader(context.ctx))
        elif scenario == "frames":
            for k in range(30):
                sender.script = replace(
                    Script(), head=((0, 0.01 * k, 0, 1), (0.01 * k, 1.6, 0)), curls=((k / 30,) * 5,) * 2
                )
                frames(session, 100)
                if k % 5 == 4:
                    wearer.next_view()
        elif scenario == "wrong":
            runtime: Any = session.runtime
            try:
                runtime._xr.destroy_space(runtime._space)
                frames(session, 1)
            except glsplat.GlsplatError as error:
                out["refused"] = str(error)
        elif scenario == "restart":
            frames(session, 10)
            service.kill()
            limit = time.monotonic() + 60
            while session.losses == 0 and session.step():
                assert time.monotonic() < limit
            before = session.rendered
            service.start()
            frames(session, 20)
            out |= {"losses": session.losses, "after": session.rendered - before}
        else:
            frames(session, 300)
            out |= {"overhead_ms": session.overhead_ms, "copy_ms": show.copy_ms}
        out |= {"frames": session.frames, "rendered": session.rendered, "focused": session.state is State.FOCUSED}
        session.quit()
        while session.step():
            pass
        out["left"] = session.state is State.EXITING
        session.close()
        show.release()
    sender.close()
    service.kill()
    return out | {"said": said}


def pictures(session: Session, show: LocalShow, sender: Sender, heard: list[Any], read: Any) -> dict[str, Any]:
    """Compare images before their release to OpenXR with those of a plain Renderer, and samples with the script."""
    config = RenderConfig(output="uint8")
    differing, most, joints, deeper, finger = [], 0.0, 0, 0.0, 0.0
    raw = Fingers(session.runtime)
    assert show.eyes is not None
    taken: list[np.ndarray] = []
    deep: list[np.ndarray] = []
    ranges: list[Any] = []
    run = show.eyes._pass.run

    def watched(target: Any, images: EyeImages, *rest: Any) -> None:
        run(target, images, *rest)
        taken[:] = [read(images.colour[0], show.eyes.size)[:, ::-1]]
        deep[:] = [read(images.depth[0], show.eyes.size, True)[:, ::-1]]
        ranges[:] = rest[:1]

    show.eyes._pass.run = watched  # type: ignore[method-assign]
    for k in range(6):
        angle = 0.2 * k
        script = Script(
            head=(TURNED if k % 2 else (0.0, 0.0, 0.0, 1.0), (0.1 * k, 1.5 + 0.05 * k, 0.1)),
            fovs=((-0.9 + 0.03 * k, 0.6, 0.7, -0.9), (-0.5, 0.8 + 0.03 * k, 0.75, -0.85)),
            eyes=((-0.03, 0.001 * k, 0.0), (0.034, 0.0, 0.002 * k)),
            hands=(((0, np.sin(angle), 0, np.cos(angle)), (-0.3, 1.1, -0.3)), ((0, 0, 0, 1), (0.2, 1.3, -0.4))),
            curls=((k / 5,) * 5, (1 - k / 5, 0.5, 0.2, 0.9, 0.0)),
        )
        sender.script = script
        frames(session, 12)  # until predictions settle
        sample = heard[-1]
        quat = np.array(script.head[0]) / np.linalg.norm(script.head[0])
        most = max(most, float(np.abs(np.array(sample.head) - [*script.head[1], *quat]).max()))
        for side, (_, place) in zip((sample.left, sample.right), script.hands, strict=True):
            most = max(most, float(np.abs(np.array(side[:3]) - place).max()))
        views = show.views
        for view, fov in zip(views, script.fovs, strict=True):
            got = (view.fov.left, view.fov.right, view.fov.up, view.fov.down)
            most = max(most, float(np.abs(np.array(got) - fov).max()))
        joints = max(joints, len(sample.left_joints or ()))
        for index, mine in enumerate((sample.left_joints, sample.right_joints)):
            finger = max(finger, float(np.abs(np.array(mine) - raw.read(index, int(sample.t * 1e9))[1:]).max()))
        with glsplat.Renderer(show.scene, size=show.eyes.size, views=2, config=config, context=show.context) as plain:
            picture = plain.render(show.cameras)
        differing.append(int((picture != taken[-1]).sum()))
        exact = replace(config, output="float32")
        with glsplat.Renderer(show.scene, size=show.eyes.size, config=exact, context=show.context) as plain:
            colour, z = plain.render(show.cameras, depth=True)
        near, far, unit = ranges[0].near, ranges[0].far, ranges[0].unit
        metres = near * far / (far - deep[0] * (far - near))
        solid = colour[..., 3] > 0.5
        deeper = max(deeper, float(np.abs(metres[solid] / (unit * z[solid]) - 1).max()))
        if k == 5:
            np.save("/tmp/pictures.npy", taken[-1])
    covered = float((taken[-1][..., 3] > 0).mean())
    found = {"differing": differing, "most": most, "joints": joints, "finger": finger, "deeper": deeper}
    return found | {"covered": covered}


class Fingers:
    """The 26 joints of each hand, located by pyopenxr's structures alone."""

    def __init__(self, runtime: Any) -> None:
        self._xr, self._space = runtime._xr, runtime._space
        xr = self._xr
        self._locate = ctypes.cast(
            xr.get_instance_proc_addr(runtime._instance, "xrLocateHandJointsEXT"), xr.PFN_xrLocateHandJointsEXT
        )
        self._trackers = [
            xr.create_hand_tracker_ext(runtime._session, xr.HandTrackerCreateInfoEXT(hand=hand))
            for hand in (xr.HandEXT.LEFT, xr.HandEXT.RIGHT)
        ]

    def read(self, hand: int, time: int) -> np.ndarray:
        xr, room = self._xr, (self._xr.HandJointLocationEXT * 26)()
        found = xr.HandJointLocationsEXT(joint_locations=room)
        info = xr.HandJointsLocateInfoEXT(self._space, time)
        assert self._locate(self._trackers[hand], ctypes.byref(info), ctypes.byref(found)) == 0 and found.is_active
        return np.array([(j.pose.position.x, j.pose.position.y, j.pose.position.z) for j in room])


if __name__ == "__main__":
    RECORD.unlink(missing_ok=True)
    os.environ |= {"XR_CORE_VALIDATION_EXPORT_TYPE": "text", "XR_CORE_VALIDATION_FILE_NAME": str(RECORD)}
    result = main(sys.argv[1])
    text = RECORD.read_text(errors="replace") if RECORD.exists() else ""
    print(json.dumps(result | {"validation": text.splitlines()[:40]}))
