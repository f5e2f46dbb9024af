"""Every error glsplat raises on purpose.

::

    GlsplatError
    ├── FormatError      a file is not what it should be (names the file, what was expected, what came)
    │   └── CaptureError     a photograph that no good avatar can be made from; ``findings`` says why
    ├── BudgetError      a picture would cost more, or takes longer, than it may
    ├── ContextError     no OpenGL context, or one that cannot do the work
    │   └── ContextLostError    the context is gone, or does nothing any more
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
    """Base of all errors raised on purpose. The message is one line: expected, came, what to do.

    >>> try:
    ...     glsplat.pinhole(640, 480, fov=200)
    ... except glsplat.GlsplatError as error:
    ...     print(error)
    the field of view needs to lie between 0 and 180 degrees, not 200
    """


class FormatError(GlsplatError):
    """A file or an array does not hold what its format promises."""


class CaptureError(FormatError):
    """Photographs that no good avatar can be made from. ``findings``: (side, code, text), one for each thing wrong.

    Sides are front, back, left and right; codes are those of docs/photo.md.
    """

    def __init__(self, message: str, findings: tuple[tuple[str, str, str], ...] = ()) -> None:
        super().__init__(message)
        self.findings = findings


class ContextError(GlsplatError):
    """No OpenGL context could be made, or it lacks something the renderer needs."""


class ContextLostError(ContextError):
    """The context worked and does not any more; nothing but a new one helps."""


class BudgetError(GlsplatError):
    """A picture was not drawn to its end. ``code`` says why: too_costly, too_slow or abandoned."""

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
