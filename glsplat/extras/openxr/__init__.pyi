from .local import LocalShow as LocalShow
from .openxr.runtime import OpenXrRuntime as OpenXrRuntime
from .runtime import Runtime as Runtime
from .session import Session as Session
from .wearer import Wearer as Wearer
