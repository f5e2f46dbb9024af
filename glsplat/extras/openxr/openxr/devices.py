"""Tracked devices of a runtime: actions (grips, buttons, gaze) and the trackers of available extensions."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from glsplat.errors import ContextError
from glsplat.extras.openxr.openxr.calls import called, function, pyopenxr, quietly
from glsplat.extras.openxr.runtime import Devices
from glsplat.tracking.sample import Transform

HANDS, GAZE = "XR_EXT_hand_tracking", "XR_EXT_eye_gaze_interaction"
BODY, FULL_BODY = "XR_FB_body_tracking", "XR_META_body_tracking_full_body"
FACE, FACE_HTC = "XR_FB_face_tracking2", "XR_HTC_facial_tracking"
WANTED = (HANDS, GAZE, BODY, FULL_BODY, FACE, FACE_HTC)
"""Extensions requested if the runtime has them."""

_SIDES = ("left", "right")
_VALID = 3  # XR_SPACE_LOCATION_ORIENTATION_VALID_BIT | POSITION_VALID_BIT
_JOINTS = 26
_LOCATION = [("flags", "<u8"), ("q", "<f4", 4), ("p", "<f4", 3)]
_HAND = np.dtype([*_LOCATION, ("radius", "<f4")])  # XrHandJointLocationEXT
_BODY = np.dtype([*_LOCATION, ("pad", "<u4")])  # XrBodyJointLocationFB, aligned to its 64-bit flags

# profile -> squeeze, trigger, next view (left, right) below /user/hand/SIDE/input
_PROFILES = {
    "khr/simple_controller": (None, "select/click", ("menu/click", "menu/click")),
    "oculus/touch_controller": ("squeeze/value", "trigger/value", ("x/click", "a/click")),
    "valve/index_controller": ("squeeze/value", "trigger/value", ("a/click", "a/click")),
    "htc/vive_controller": ("squeeze/click", "trigger/value", ("menu/click", "menu/click")),
    "microsoft/motion_controller": ("squeeze/click", "trigger/value", ("menu/click", "menu/click")),
}


def transform_of(pose: Any) -> Transform:
    """Convert an XrPosef."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w)


class DeviceReader:
    """Reads a session's devices; call ``read`` once a frame."""

    def __init__(self, instance: Any, session: Any, extensions: frozenset[str]) -> None:
        self._xr, self._instance, self._session = pyopenxr(), instance, session
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._actions(extensions, stack)
            self._hands = [self._hand(side, stack) for side in _SIDES] if HANDS in extensions else []
            self._body = self._body_tracker(extensions, stack) if BODY in extensions else None
            self._face = self._face_tracker(stack) if FACE in extensions else None
            self._htc = [self._htc_tracker(kind, stack) for kind in (1, 2)] if FACE_HTC in extensions else [None, None]
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Destroy actions, spaces and trackers."""
        self._stack.close()

    def read(self, view: Any, space: Any, time: int, active: bool) -> Devices:
        """Return all devices at ``time`` in ``space``; ``view`` is the head's space."""
        if active:
            with called("xrSyncActions"):
                self._xr.sync_actions(self._session, self._sync)
        grips, squeezes, triggers, pressed = [], [], [], False
        for index, path in enumerate(self._paths):
            grips.append(self._located(self._grips[index], space, time) if active else None)
            squeezes.append(self._state("float", self._squeeze, path) if active else 0.0)
            triggers.append(self._state("float", self._trigger, path) if active else 0.0)
            pressed |= active and self._state("boolean", self._next, path) > 0
        hands = [None if read is None else read(space, time) for read in self._hands] or [None, None]
        return Devices(
            head=self._located(view, space, time),
            grips=(grips[0], grips[1]),
            squeezes=(squeezes[0], squeezes[1]),
            triggers=(triggers[0], triggers[1]),
            hands=(hands[0], hands[1]),
            body=None if self._body is None else self._body(space, time),
            face=None if self._face is None else self._face(time),
            eyes_htc=None if self._htc[0] is None else self._htc[0](),
            lips_htc=None if self._htc[1] is None else self._htc[1](),
            gaze=None if self._gaze is None or not active else self._located(self._gaze, space, time),
            next_view=pressed,
        )

    # ---------------------------------------------------------------------------------------------------- actions

    def _actions(self, extensions: frozenset[str], stack: ExitStack) -> None:
        xr, instance = self._xr, self._instance
        with called("actions"):
            made = xr.create_action_set(
                instance, xr.ActionSetCreateInfo(action_set_name="wearer", localized_action_set_name="Wearer")
            )
            stack.callback(quietly, xr.destroy_action_set, made)
            self._paths = [xr.string_to_path(instance, f"/user/hand/{side}") for side in _SIDES]
            kinds = xr.ActionType

            def action(name: str, words: str, kind: Any, paths: list[Any]) -> Any:
                info = xr.ActionCreateInfo(
                    action_name=name, localized_action_name=words, action_type=kind, subaction_paths=paths
                )
                return xr.create_action(made, info)

            self._grip = action("grip", "Hand", kinds.POSE_INPUT, self._paths)
            self._squeeze = action("squeeze", "Close the hand", kinds.FLOAT_INPUT, self._paths)
            self._trigger = action("trigger", "Close a finger", kinds.FLOAT_INPUT, self._paths)
            self._next = action("next_view", "Next view", kinds.BOOLEAN_INPUT, self._paths)
            for profile, (squeeze, trigger, following) in _PROFILES.items():
                pairs = []
                for side, button in zip(_SIDES, following, strict=True):
                    below = f"/user/hand/{side}/input"
                    pairs += [(self._grip, f"{below}/grip/pose"), (self._next, f"{below}/{button}")]
                    pairs += [(self._trigger, f"{below}/{trigger}")]
                    pairs += [(self._squeeze, f"{below}/{squeeze}")] if squeeze is not None else []
                self._suggest(profile, pairs)
            self._gaze = None
            looked = None
            if GAZE in extensions:
                eyes = xr.string_to_path(instance, "/user/eyes_ext")
                looked = action("gaze", "Gaze", kinds.POSE_INPUT, [eyes])
                self._suggest("ext/eye_gaze_interaction", [(looked, "/user/eyes_ext/input/gaze_ext/pose")])
            xr.attach_session_action_sets(self._session, xr.SessionActionSetsAttachInfo(action_sets=[made]))
            self._grips = [self._action_space(self._grip, path, stack) for path in self._paths]
            if looked is not None:
                self._gaze = self._action_space(looked, xr.string_to_path(instance, "/user/eyes_ext"), stack)
            self._sync = xr.ActionsSyncInfo(active_action_sets=[xr.ActiveActionSet(made, 0)])

    def _suggest(self, profile: str, pairs: list[tuple[Any, str]]) -> None:
        """Suggest bindings for a controller; ignore one that the runtime does not know."""
        xr, instance = self._xr, self._instance
        try:
            found = [xr.ActionSuggestedBinding(action, xr.string_to_path(instance, path)) for action, path in pairs]
            xr.suggest_interaction_profile_bindings(
                instance,
                xr.InteractionProfileSuggestedBinding(
                    interaction_profile=xr.string_to_path(instance, f"/interaction_profiles/{profile}"),
                    suggested_bindings=found,
                ),
            )
        except xr.PathUnsupportedError:
            pass

    def _action_space(self, action: Any, path: Any, stack: ExitStack) -> Any:
        xr = self._xr
        space = xr.create_action_space(self._session, xr.ActionSpaceCreateInfo(action=action, subaction_path=path))
        stack.callback(quietly, xr.destroy_space, space)
        return space

    def _located(self, what: Any, space: Any, time: int) -> Transform | None:
        with called("xrLocateSpace"):
            found = self._xr.locate_space(what, space, time)
            return transform_of(found.pose) if found._location_flags & _VALID == _VALID else None
        return None

    def _state(self, kind: str, action: Any, path: Any) -> float:
        """Return the state of a "float" or "boolean" action; 0 while it is not active."""
        with called(f"xrGetActionState{kind.capitalize()}"):
            read = getattr(self._xr, f"get_action_state_{kind}")
            state = read(self._session, self._xr.ActionStateGetInfo(action, path))
            return float(state.current_state) if state.is_active else 0.0
        return 0.0

    # --------------------------------------------------------------------------------------------------- extensions

    def _hand(self, side: str, stack: ExitStack) -> Callable[[Any, int], tuple[Transform, ...] | None] | None:
        """Return a reader of a hand's 26 joints: pyopenxr's own call allocates none for the runtime."""
        xr = self._xr
        hand = xr.HandEXT.LEFT if side == "left" else xr.HandEXT.RIGHT
        info = xr.HandTrackerCreateInfoEXT(hand=hand, hand_joint_set=xr.HandJointSetEXT.DEFAULT)
        tracker = self._tracker("hand_tracker_ext", info, stack)
        if tracker is None:
            return None
        locate = function(self._instance, "xrLocateHandJointsEXT")
        room = (xr.HandJointLocationEXT * _JOINTS)()
        joints = np.frombuffer(room, _HAND)
        locations = xr.HandJointLocationsEXT(joint_locations=room)

        def read(space: Any, time: int) -> tuple[Transform, ...] | None:
            with called("xrLocateHandJointsEXT"):
                locate(tracker, ctypes.byref(xr.HandJointsLocateInfoEXT(space, time)), ctypes.byref(locations))
            if not locations.is_active or not np.all(joints["flags"] & _VALID == _VALID):
                return None
            return tuple(map(tuple, np.hstack([joints["p"], joints["q"]]).astype(np.float64).tolist()))

        return read

    def _body_tracker(
        self, extensions: frozenset[str], stack: ExitStack
    ) -> Callable[[Any, int], list[Transform | None] | None] | None:
        xr, full = self._xr, FULL_BODY in extensions
        count = 84 if full else 70  # XR_FULL_BODY_JOINT_COUNT_META, XR_BODY_JOINT_COUNT_FB
        info = xr.BodyTrackerCreateInfoFB(body_joint_set=xr.BodyJointSetFB(1000274000 if full else 0))
        tracker = self._tracker("body_tracker_fb", info, stack)
        if tracker is None:
            return None
        locate = function(self._instance, "xrLocateBodyJointsFB")
        room = (xr.BodyJointLocationFB * count)()
        joints = np.frombuffer(room, _BODY)
        locations = xr.BodyJointLocationsFB(joint_locations=room)

        def read(space: Any, time: int) -> list[Transform | None] | None:
            with called("xrLocateBodyJointsFB"):
                locate(tracker, ctypes.byref(xr.BodyJointsLocateInfoFB(space, time)), ctypes.byref(locations))
            if not locations.is_active:
                return None
            rows = map(tuple, np.hstack([joints["p"], joints["q"]]).astype(np.float64).tolist())
            valid = (joints["flags"] & _VALID == _VALID).tolist()
            return [row if known else None for row, known in zip(rows, valid, strict=True)]

        return read

    def _face_tracker(self, stack: ExitStack) -> Callable[[int], list[float] | None] | None:
        xr = self._xr
        info = xr.FaceTrackerCreateInfo2FB(requested_data_sources=[xr.FaceTrackingDataSource2FB.VISUAL.value])
        tracker = self._tracker("face_tracker2_fb", info, stack)
        if tracker is None:
            return None
        weigh = function(self._instance, "xrGetFaceExpressionWeights2FB")
        weights, sure = (ctypes.c_float * 70)(), (ctypes.c_float * 2)()
        found = xr.FaceExpressionWeights2FB(weights=weights, confidences=sure)

        def read(time: int) -> list[float] | None:
            with called("xrGetFaceExpressionWeights2FB"):
                weigh(tracker, ctypes.byref(xr.FaceExpressionInfo2FB(time)), ctypes.byref(found))
            return list(weights) if found.is_valid else None

        return read

    def _htc_tracker(self, kind: int, stack: ExitStack) -> Callable[[], list[float] | None] | None:
        """Return a reader of the eyes (1) or lips (2)."""
        xr = self._xr
        info = xr.FacialTrackerCreateInfoHTC(facial_tracking_type=xr.FacialTrackingTypeHTC(kind))
        tracker = self._tracker("facial_tracker_htc", info, stack)
        if tracker is None:
            return None
        express = function(self._instance, "xrGetFacialExpressionsHTC")
        weights = (ctypes.c_float * (14 if kind == 1 else 37))()
        found = xr.FacialExpressionsHTC(expression_weightings=weights)

        def read() -> list[float] | None:
            with called("xrGetFacialExpressionsHTC"):
                express(tracker, ctypes.byref(found))
            return list(weights) if found.is_active else None

        return read

    def _tracker(self, kind: str, info: Any, stack: ExitStack) -> Any:
        """Return a tracker, which ``stack`` destroys; None if the extension exists but not the device."""
        try:
            with called("a tracker"):
                tracker = getattr(self._xr, f"create_{kind}")(self._session, info)
                stack.callback(quietly, getattr(self._xr, f"destroy_{kind}"), tracker)
                return tracker
        except ContextError as error:
            if type(error) is not ContextError:  # the runtime is gone
                raise
        return None
