from .file import OnFile, on_file
from .policy import ConsentPolicy

__all__ = ["ConsentPolicy", "OnFile", "on_file"]
