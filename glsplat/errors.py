"""The errors that glsplat raises on purpose.

::

    GlsplatError
    ├── FormatError      a file or array is invalid (names the file, the expected and the found content)
    │   └── CaptureError     a photograph is unsuitable for an avatar; ``findings`` lists the reasons
    ├── BudgetError      a picture exceeds its limit of cost or time
    ├── ContextError     there is no OpenGL context, or it lacks a feature
    │   └── ContextLostError    the context was lost
    ├── ShaderError      a shader does not compile (names file and line of the chunk)
    ├── PoseError        a pose or motion does not fit the skeleton
    └── ProtocolError    a message breaks the wire protocol

Commands print the message of a GlsplatError as one line and exit with 1; anything else is a bug.
"""

__all__ = [
    "BudgetError",
    "CaptureError",
    "ContextError",
    "ContextLostError",
    "FormatError",
    "GlsplatError",
    "PoseError",
    "ProtocolError",
    "ShaderError",
]


class GlsplatError(Exception):
    """Base of all errors raised on purpose. The message is one line: expected, found, what to do.

    >>> try:
    ...     glsplat.pinhole(640, 480, fov=200)
    ... except glsplat.GlsplatError as error:
    ...     print(error)
    the field of view needs to lie between 0 and 180 degrees, not 200
    """


class FormatError(GlsplatError):
    """A file or an array does not follow its format."""


class CaptureError(FormatError):
    """Photographs are unsuitable for an avatar. ``findings``: (side, code, text) of each fault.

    Sides are front, back, left and right; codes are those of docs/photo.md.
    """

    def __init__(self, message: str, findings: tuple[tuple[str, str, str], ...] = ()) -> None:
        super().__init__(message)
        self.findings = findings


class ContextError(GlsplatError):
    """No OpenGL context could be made, or it lacks something the renderer needs."""


class ContextLostError(ContextError):
    """The context was lost; make a new one. ``blames``: the picture that was drawn is likely to be at fault."""

    blames: bool = True


class BudgetError(GlsplatError):
    """A picture was aborted. ``code`` is the reason: too_costly, too_slow or abandoned."""

    def __init__(self, message: str, code: str = "too_costly") -> None:
        super().__init__(message)
        self.code = code


class ShaderError(GlsplatError):
    """A shader failed to compile or link; the message points at the chunk, not the flattened text."""


class PoseError(GlsplatError):
    """A pose, motion or tracking sample does not fit the skeleton or is not finite."""


class ProtocolError(GlsplatError):
    """A message breaks the wire protocol. ``code`` is the machine-readable reason sent to the peer."""

    def __init__(self, message: str, code: str = "bad_request", frame_id: int | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.frame_id = frame_id


def one_line(error: BaseException) -> str:
    """Return the type and the text of a foreign exception, shortened to one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
