"""Test trackers that Monado lacks through pyopenxr's own structures, with fake C functions of a runtime.

Run within the chroot by test_monado.py; prints the values that were read as JSON.
"""

from __future__ import annotations

import ctypes
import json
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import xr

from glsplat.extras.openxr.eyes import DepthRange
from glsplat.extras.openxr.openxr import devices
from glsplat.extras.openxr.openxr.devices import DeviceReader
from glsplat.extras.openxr.openxr.runtime import DEPTH, OpenXrRuntime
from glsplat.extras.openxr.runtime import Fov, Projection, ViewPose

CALLS: list[str] = []


def floats(address: Any, count: int) -> Any:
    return ctypes.cast(address, ctypes.POINTER(ctypes.c_float * count)).contents


def function(_: Any, name: str) -> Any:
    """Return a fake of a runtime's function, by the layouts of openxr.h."""

    def call(*arguments: Any) -> None:
        CALLS.append(name)
        found = arguments[-1]._obj
        if name == "xrGetFaceExpressionWeights2FB":
            assert arguments[1]._obj.time == 5 and (found.weight_count, found.confidence_count) == (70, 2)
            floats(found._weights, 70)[:] = [i / 100 for i in range(70)]
            found.is_valid = 1
        elif name == "xrGetFacialExpressionsHTC":
            count = found.expression_count
            floats(found._expression_weightings, count)[:] = [i / 50 for i in range(count)]
            found.is_active = 1
        else:
            joints = 84 if name == "xrLocateBodyJointsFB" else 26
            assert arguments[1]._obj.time == 5 and found.joint_count == joints
            kind = xr.BodyJointLocationFB if joints == 84 else xr.HandJointLocationEXT
            rows = ctypes.cast(found._joint_locations, ctypes.POINTER(kind * joints)).contents
            for i, row in enumerate(rows):
                row._location_flags = 0 if joints == 84 and i == 70 else 15
                row.pose = xr.Posef(xr.Quaternionf(0, 0, 0.6, 0.8), xr.Vector3f(i, 2 * i, 3 * i))
            found.is_active = 1

    return call


def main() -> dict[str, Any]:
    devices.function = function
    made: list[Any] = []
    for name in (
        "create_hand_tracker_ext",
        "create_body_tracker_fb",
        "create_face_tracker2_fb",
        "create_facial_tracker_htc",
    ):
        setattr(xr, name, lambda session, info: made.append(info) or len(made))
    for name in ("destroy_hand_tracker_ext", "destroy_body_tracker_fb", "destroy_face_tracker2_fb"):
        setattr(xr, name, lambda tracker: CALLS.append("destroyed"))
    xr.destroy_facial_tracker_htc = lambda tracker: CALLS.append("destroyed")
    reader: Any = object.__new__(DeviceReader)
    reader._xr, reader._instance, reader._session = xr, None, None
    with ExitStack() as stack:
        space = xr.Space()
        body = reader._body_tracker(frozenset({devices.BODY, devices.FULL_BODY}), stack)(space, 5)
        hand = reader._hand("right", stack)(space, 5)
        face = reader._face_tracker(stack)(5)
        eyes, lips = (reader._htc_tracker(kind, stack)() for kind in (1, 2))
    through = passthrough()
    kinds = [int(made[0]._body_joint_set), int(made[1]._hand), made[2].requested_data_source_count]
    kinds += [int(info._facial_tracking_type) for info in made[3:]]
    return {
        "body": body,
        "hand": hand,
        "face": face,
        "eyes": eyes,
        "lips": lips,
        "asked": kinds,
        "calls": CALLS,
    } | through


def passthrough() -> dict[str, Any]:
    """Return the layers of a frame over the picture of the headset's cameras."""
    asked: list[Any] = []
    xr.create_passthrough_fb = lambda session, info: asked.append(info) or xr.PassthroughFB()
    xr.create_passthrough_layer_fb = lambda session, info: asked.append(info) or xr.PassthroughLayerFB()
    for name in ("destroy_passthrough_fb", "destroy_passthrough_layer_fb"):
        setattr(xr, name, lambda handle: None)
    ended: list[Any] = []

    def end_frame(session: Any, info: Any) -> None:
        heads = [layer.contents for layer in info.layers]
        ended.append([int(info._environment_blend_mode), [int(head._type) for head in heads]])
        if len(heads) == 2:
            layer = ctypes.cast(info.layers[1], ctypes.POINTER(xr.CompositionLayerProjection)).contents
            views = ctypes.cast(layer._views, ctypes.POINTER(xr.CompositionLayerProjectionView * 2)).contents
            depth = ctypes.cast(views[1]._next, ctypes.POINTER(xr.CompositionLayerDepthInfoKHR)).contents
            ended.append([int(layer._layer_flags), views[1].pose.position.x, views[1].fov.angle_left, depth.near_z])
            ended.append([view.sub_image.image_array_index for view in views])

    xr.end_frame = end_frame
    runtime: Any = object.__new__(OpenXrRuntime)
    runtime._xr, runtime._session, runtime._instance, runtime._stack = xr, None, None, ExitStack()
    runtime._space, runtime._made, runtime.extensions = xr.Space(), None, frozenset({DEPTH})
    runtime._see_through()
    chain = SimpleNamespace(size=(8, 6), handle=xr.Swapchain())
    for shift in (0.0, 1.0):  # the second frame reuses the first one's structures with other poses
        views = [
            ViewPose((shift + x, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0), Fov(-0.5 - x, 0.5, 0.5, -0.5)) for x in (0.0, 0.25)
        ]
        runtime.end_frame(7, Projection(views, (chain,), (chain,), DepthRange(0.05, 100.0), True), "alpha")
    runtime.end_frame(7, None, "alpha")
    return {"running": [int(info._flags) for info in asked], "ended": ended}


if __name__ == "__main__":
    print(json.dumps(main()))
