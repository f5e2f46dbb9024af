"""OpenXrRuntime: instance, system, session, spaces, swapchains and frames, by pyopenxr."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from typing import Any

from glsplat.errors import ContextError, ContextLostError
from glsplat.extras.openxr.openxr.calls import Swapchain, called, function, pyopenxr, quietly
from glsplat.extras.openxr.openxr.devices import WANTED, DeviceReader, transform_of
from glsplat.extras.openxr.openxr.graphics import EGL_ENABLE, OPENGL_ENABLE, api_in_use, graphics_binding
from glsplat.extras.openxr.runtime import Blend, Devices, Event, Fov, FrameTiming, Projection, State, ViewPose
from glsplat.gl.context import Context
from glsplat.tracking.sample import Transform

DEPTH, LOCAL_FLOOR, PASSTHROUGH = "XR_KHR_composition_layer_depth", "XR_EXT_local_floor", "XR_FB_passthrough"
EYES = 1.6  # assumed eye height if the device has no floor, metres

START = "start SteamVR, the Meta Quest Link app, WiVRn or Monado (XR_RUNTIME_JSON names another one)"
_BLENDS: dict[int, Blend] = {1: "opaque", 2: "additive", 3: "alpha"}
_VALID = 3  # XR_VIEW_STATE_ORIENTATION_VALID_BIT | POSITION_VALID_BIT


def offered() -> frozenset[str]:
    """Return the active runtime's extensions. Raises ContextError, one line, without a runtime."""
    xr = pyopenxr()
    try:
        return frozenset(found.extension_name.decode() for found in xr.enumerate_instance_extension_properties())
    except xr.exception.XrException as error:
        raise ContextError(f"no OpenXR runtime is active ({type(error).__name__}): {START}") from None


class OpenXrRuntime:
    """An instance, its system and session for the current context, which has to stay current in every call.

    Raises ContextError if it cannot be created. After ContextLostError from any call, only ``close`` may be called.

    ``layers``: API layers to enable, as "XR_APILAYER_LUNARG_core_validation".
    """

    def __init__(self, context: Context, passthrough: bool = False, layers: Sequence[str] = ()) -> None:
        self._xr = pyopenxr()
        self._stack = ExitStack()
        self._space: Any = None
        self._made: Any = None  # the previous frame's layer
        self._passthrough: Any = None
        known, api = offered(), api_in_use()
        needed = EGL_ENABLE if api == "egl" else OPENGL_ENABLE
        if OPENGL_ENABLE not in known or needed not in known:
            raise ContextError(f"the OpenXR runtime takes no pictures of OpenGL by {api.upper()}: it lacks {needed}")
        wanted = {OPENGL_ENABLE, needed, DEPTH, LOCAL_FLOOR, *WANTED} | ({PASSTHROUGH} if passthrough else set())
        self.extensions: frozenset[str] = frozenset(wanted & known)
        try:
            self._instance = self._made_instance(layers)
            self._system = self._found_system()
            self._describe(context)
            self._session = self._made_session(api)
            self._spaces()
            self._devices = DeviceReader(self._instance, self._session, self.extensions)
            self._stack.callback(self._devices.close)
            if PASSTHROUGH in self.extensions:
                self._see_through()
        except BaseException:
            self.close()
            raise

    # ------------------------------------------------------------------------------------------------------- states

    def poll(self) -> Event | None:
        """Return the next event that is used here; None if there is none."""
        xr, kinds = self._xr, self._xr.StructureType
        while True:
            data = None
            with called("xrPollEvent"):
                data = xr.poll_event(self._instance)
            if data is None:  # XR_EVENT_UNAVAILABLE
                return None
            kind = data._type
            if kind == kinds.EVENT_DATA_INSTANCE_LOSS_PENDING.value:
                return Event("lost")
            if kind == kinds.EVENT_DATA_SESSION_STATE_CHANGED.value:
                changed = _as(data, xr.EventDataSessionStateChanged)
                return Event("state", State(int(changed._state)), int(changed.time))
            if kind == kinds.EVENT_DATA_REFERENCE_SPACE_CHANGE_PENDING.value:
                # of any space: a reset view is placed again, even if the floor stays
                pending = _as(data, xr.EventDataReferenceSpaceChangePending)
                return Event("recentred", time=int(pending.change_time))

    def begin(self) -> None:
        """Call xrBeginSession, in the state READY."""
        xr = self._xr
        info = xr.SessionBeginInfo(primary_view_configuration_type=xr.ViewConfigurationType.PRIMARY_STEREO)
        with called("xrBeginSession"):
            xr.begin_session(self._session, info)

    def end(self) -> None:
        """Call xrEndSession, in the state STOPPING."""
        with called("xrEndSession"):
            self._xr.end_session(self._session)

    def request_exit(self) -> None:
        """Call xrRequestExitSession; STOPPING follows."""
        with called("xrRequestExitSession"):
            self._xr.request_exit_session(self._session)

    # ------------------------------------------------------------------------------------------------------- frames

    def wait_frame(self) -> FrameTiming:
        """Call xrWaitFrame, which returns when the next frame should begin."""
        with called("xrWaitFrame"):
            state = self._xr.wait_frame(self._session)
            return FrameTiming(
                int(state.predicted_display_time), int(state.predicted_display_period), bool(state.should_render)
            )
        raise ContextLostError("xrWaitFrame gave no frame")

    def begin_frame(self) -> None:
        """Call xrBeginFrame."""
        with called("xrBeginFrame"):
            self._xr.begin_frame(self._session)

    def end_frame(self, display_time: int, projection: Projection | None, blend: Blend) -> None:
        """Call xrEndFrame; with XR_FB_passthrough the cameras' layer comes first."""
        xr = self._xr
        layers: list[Any] = []
        if projection is not None:
            if self._passthrough is not None:
                layers.append(xr.CompositionLayerPassthroughFB(layer_handle=self._passthrough))
            layers.append(self._layer(projection))
        number = next((n for n, name in _BLENDS.items() if name == blend), 1)
        if self._passthrough is not None:
            number = 1  # the passthrough layer replaces the display's blending
        info = xr.FrameEndInfo(
            display_time=display_time, environment_blend_mode=number, layers=[ctypes.byref(layer) for layer in layers]
        )
        with called("xrEndFrame"):
            xr.end_frame(self._session, info)

    def views(self, time: int) -> tuple[ViewPose, ViewPose] | None:
        """Return both eyes at ``time`` (xrLocateViews); None while the head's pose is unknown."""
        xr = self._xr
        kind = xr.ViewConfigurationType.PRIMARY_STEREO
        with called("xrLocateViews"):
            state, views = xr.locate_views(self._session, xr.ViewLocateInfo(kind, time, self._space))
            if int(state._view_state_flags) & _VALID != _VALID or len(views) != 2:
                return None
            angles = ("angle_left", "angle_right", "angle_up", "angle_down")
            left, right = (
                ViewPose(transform_of(view.pose), Fov(*(getattr(view.fov, name) for name in angles))) for view in views
            )
            return left, right
        return None

    def devices(self, time: int, active: bool) -> Devices:
        """Return all devices at ``time``; actions are read while ``active`` (FOCUSED)."""
        return self._devices.read(self._view, self._space, time, active)

    def move(self, place: Transform) -> None:
        """Move the session's space to a pose in its initial space."""
        old, self._space = self._space, self._reference(self._kind, place, self._base)
        with called("xrDestroySpace"):
            self._xr.destroy_space(old)

    def swapchain(self, internal_format: int, size: tuple[int, int], layers: int, depth: bool) -> Swapchain:
        """Return a new swapchain (xrCreateSwapchain)."""
        xr, uses = self._xr, self._xr.SwapchainUsageFlags
        use = uses.DEPTH_STENCIL_ATTACHMENT_BIT if depth else uses.COLOR_ATTACHMENT_BIT
        info = xr.SwapchainCreateInfo(
            usage_flags=use | uses.SAMPLED_BIT,
            format=internal_format,
            sample_count=1,
            width=size[0],
            height=size[1],
            face_count=1,
            array_size=layers,
            mip_count=1,
        )
        with called("xrCreateSwapchain"):
            made = xr.create_swapchain(self._session, info)
            images = xr.enumerate_swapchain_images(made, xr.SwapchainImageOpenGLKHR)
            return Swapchain(xr, made, size, layers, [int(image.image) for image in images])
        raise ContextLostError("xrCreateSwapchain gave none")

    def close(self) -> None:
        """Destroy session and instance, in any state."""
        with suppress(self._xr.exception.XrException):
            self._stack.close()

    # -------------------------------------------------------------------------------------------------------- parts

    def _made_instance(self, layers: Sequence[str]) -> Any:
        xr = self._xr
        info = xr.InstanceCreateInfo(
            application_info=xr.ApplicationInfo("glsplat", 1, "glsplat", 1, xr.Version(1, 0, 0)),
            enabled_api_layer_names=list(layers),
            enabled_extension_names=sorted(self.extensions),
        )
        try:
            instance = xr.create_instance(info)
        except xr.ApiLayerNotPresentError:
            raise ContextError(f"the OpenXR loader knows no API layer {', '.join(layers)}") from None
        except xr.exception.XrException as error:
            raise ContextError(f"the OpenXR runtime does not answer ({type(error).__name__}): {START}") from None
        self._stack.callback(quietly, xr.destroy_instance, instance)
        self.name = ""
        with called("xrGetInstanceProperties"):
            self.name = xr.get_instance_properties(instance).runtime_name.decode(errors="replace")
        return instance

    def _found_system(self) -> Any:
        xr = self._xr
        try:
            return xr.get_system(self._instance, xr.SystemGetInfo(xr.FormFactor.HEAD_MOUNTED_DISPLAY))
        except (xr.FormFactorUnavailableError, xr.FormFactorUnsupportedError):
            raise ContextError(f"{self.name} sees no headset: connect it, switch it on, and try again") from None
        except xr.exception.XrException as error:
            raise ContextError(f"{self.name} has no system ({type(error).__name__}): {START}") from None

    def _describe(self, context: Context) -> None:
        """Read sizes and blend modes. Raises ContextError if the runtime needs a newer OpenGL."""
        xr, kind = self._xr, self._xr.ViewConfigurationType.PRIMARY_STEREO
        with called("xrEnumerateViewConfigurationViews"):
            views = xr.enumerate_view_configuration_views(self._instance, self._system, kind)
            self.size: tuple[int, int] = (
                max(view.recommended_image_rect_width for view in views),
                max(view.recommended_image_rect_height for view in views),
            )
            self.max_size: tuple[int, int] = (
                min(view.max_image_rect_width for view in views),
                min(view.max_image_rect_height for view in views),
            )
            modes = xr.enumerate_environment_blend_modes(self._instance, self._system, kind)
        found: list[Blend] = [_BLENDS[int(mode)] for mode in modes if int(mode) in _BLENDS]
        if PASSTHROUGH in self.extensions and "alpha" not in found:
            found.append("alpha")
        self.blends: tuple[Blend, ...] = tuple(found)
        needs = xr.GraphicsRequirementsOpenGLKHR()
        with called("xrGetOpenGLGraphicsRequirementsKHR"):
            ask = function(self._instance, "xrGetOpenGLGraphicsRequirementsKHR")
            ask(self._instance, self._system, ctypes.byref(needs))
        least = (int(needs.min_api_version_supported) >> 48, int(needs.min_api_version_supported) >> 32 & 0xFFFF)
        have = divmod(context.ctx.version_code // 10, 10)
        if have < least:
            raise ContextError(f"{self.name} needs OpenGL {least[0]}.{least[1]}, {context.driver} has {have}")

    def _made_session(self, api: str) -> Any:
        xr = self._xr
        with called("xrCreateSession"):
            session = xr.create_session(
                self._instance, xr.SessionCreateInfo(system_id=self._system, next=graphics_binding(api))
            )
            self._stack.callback(quietly, xr.destroy_session, session)
            self.formats: tuple[int, ...] = tuple(map(int, xr.enumerate_swapchain_formats(session)))
        return session

    def _spaces(self) -> None:
        """Create the head's space and the session's, whose floor is at y = 0 if the device knows it."""
        xr, kinds = self._xr, self._xr.ReferenceSpaceType
        self._view = self._reference(kinds.VIEW, None)
        with called("xrEnumerateReferenceSpaces"):
            known = set(map(int, xr.enumerate_reference_spaces(self._session)))
        if LOCAL_FLOOR in self.extensions and kinds.LOCAL_FLOOR.value in known:
            self._kind, self._base = kinds.LOCAL_FLOOR, 0.0
        elif kinds.STAGE.value in known:
            self._kind, self._base = kinds.STAGE, 0.0
        else:
            self._kind, self._base = kinds.LOCAL, -EYES
        self._space = self._reference(self._kind, None, self._base)
        self._stack.callback(lambda: quietly(xr.destroy_space, self._space))
        self._stack.callback(quietly, xr.destroy_space, self._view)

    def _reference(self, kind: Any, place: Transform | None, raised: float = 0.0) -> Any:
        xr = self._xr
        x, y, z, *turn = place or (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        pose = xr.Posef(xr.Quaternionf(*turn), xr.Vector3f(x, y + raised, z))
        info = xr.ReferenceSpaceCreateInfo(reference_space_type=kind, pose_in_reference_space=pose)
        with called("xrCreateReferenceSpace"):
            return xr.create_reference_space(self._session, info)

    def _see_through(self) -> None:
        """Create the layer of the headset's cameras below ours (XR_FB_passthrough)."""
        xr, flags = self._xr, self._xr.PassthroughFlagsFB.IS_RUNNING_AT_CREATION_BIT
        with called("XR_FB_passthrough"):
            made = xr.create_passthrough_fb(self._session, xr.PassthroughCreateInfoFB(flags=flags))
            self._stack.callback(quietly, xr.destroy_passthrough_fb, made)
            info = xr.PassthroughLayerCreateInfoFB(passthrough=made, flags=flags)
            self._passthrough = xr.create_passthrough_layer_fb(self._session, info)
            self._stack.callback(quietly, xr.destroy_passthrough_layer_fb, self._passthrough)

    def _layer(self, projection: Projection) -> Any:
        """Return the layer's structures, cached for the same images: pyopenxr is slow and a frame waits for it."""
        key = (tuple(projection.colour), tuple(projection.depth), projection.depth_range, projection.transparent)
        if self._made is None or self._made[0] != key or self._made[1] is not self._space:
            self._made = (key, self._space, *self._new_layer(projection))
        layer, views = self._made[2:4]
        for one, view in zip(views, projection.views, strict=True):
            p, q, fov = one.pose.position, one.pose.orientation, one.fov
            p.x, p.y, p.z, q.x, q.y, q.z, q.w = view.pose
            fov.angle_left, fov.angle_right = view.fov.left, view.fov.right
            fov.angle_up, fov.angle_down = view.fov.up, view.fov.down
        return layer

    def _new_layer(self, projection: Projection) -> tuple[Any, Any, list[Any]]:
        """Return the layer, its views, and the structures that they point at."""
        xr, kept = self._xr, []
        views = (xr.CompositionLayerProjectionView * 2)()
        for eye in (0, 1):
            following = None
            if projection.depth and projection.depth_range is not None and DEPTH in self.extensions:
                reach = projection.depth_range
                following = xr.CompositionLayerDepthInfoKHR(
                    sub_image=self._sub_image(projection.depth, eye),
                    min_depth=0.0,
                    max_depth=1.0,
                    near_z=reach.near,
                    far_z=reach.far,
                )
                kept.append(following)
            views[eye] = xr.CompositionLayerProjectionView(
                sub_image=self._sub_image(projection.colour, eye), next=following
            )
        seen = xr.CompositionLayerFlags.BLEND_TEXTURE_SOURCE_ALPHA_BIT if projection.transparent else 0
        return xr.CompositionLayerProjection(layer_flags=seen, space=self._space, views=views), views, kept

    def _sub_image(self, chains: Sequence[Any], eye: int) -> Any:
        xr = self._xr
        chain = chains[0] if len(chains) == 1 else chains[eye]
        rect = xr.Rect2Di(offset=xr.Offset2Di(0, 0), extent=xr.Extent2Di(*chain.size))
        index = eye if len(chains) == 1 else 0
        return xr.SwapchainSubImage(swapchain=chain.handle, image_rect=rect, image_array_index=index)


def _as(data: Any, kind: Any) -> Any:
    """Cast an event's buffer to its type."""
    return ctypes.cast(ctypes.byref(data), ctypes.POINTER(kind)).contents
