from .local import LocalShow as LocalShow
from .openxr.runtime import OpenXrRuntime as OpenXrRuntime
from .session import Session as Session
from .wearer import Wearer as Wearer
