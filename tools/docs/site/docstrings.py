"""A griffe extension: the docstrings' examples and literal blocks as Markdown has them."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

_TABLE = re.compile(r"(?m)^=+(?: +=+)+\n(?:.+\n)*=+(?: +=+)+$")
_EXAMPLE = re.compile(r"(?m)^>>> .*(?:\n(?!\s*$).*)*")


def markdown_of(text: str) -> str:
    """A docstring as Markdown: ``>>>`` in a block of its own, tables of reStructuredText as they are."""
    text = _TABLE.sub(lambda found: f"```text\n{found[0]}\n```", text)
    text = _EXAMPLE.sub(lambda found: f"\n```pycon\n{found[0]}\n```", text)
    return re.sub(r"(?m)^::\n\n|(?<=\w)::$", lambda found: ":" if found[0] == "::" else "", text)


class Docstrings(Extension):
    """Rewrites each docstring once it is read."""

    def on_instance(self, *, obj: Object, **_: Any) -> None:
        """Called for modules, classes, functions and attributes alike."""
        if obj.docstring is not None:
            obj.docstring.value = markdown_of(obj.docstring.value)
