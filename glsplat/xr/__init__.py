"""OpenXR: a native client on the PC that runs the headset (docs/openxr.md). Importing it imports no pyopenxr."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.xr.local import LocalShow
    from glsplat.xr.openxr.runtime import OpenXrRuntime
    from glsplat.xr.runtime import Runtime
    from glsplat.xr.session import Session
    from glsplat.xr.wearer import Wearer

__all__ = ["LocalShow", "OpenXrRuntime", "Runtime", "Session", "Wearer"]

_HOME = {
    "LocalShow": "local",
    "OpenXrRuntime": "openxr.runtime",
    "Runtime": "runtime",
    "Session": "session",
    "Wearer": "wearer",
}

__getattr__ = on_demand(__name__, _HOME)
