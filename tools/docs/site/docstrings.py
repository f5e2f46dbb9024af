"""A griffe extension that converts the docstrings' examples and literal blocks to Markdown."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

_TABLE = re.compile(r"(?m)^=+(?: +=+)+\n(?:.+\n)*=+(?: +=+)+$")
_EXAMPLE = re.compile(r"(?m)^>>> .*(?:\n(?!\s*$).*)*")


def markdown_of(text: str) -> str:
    """Return a docstring as Markdown: ``>>>`` in a block of its own, tables of reStructuredText verbatim."""
    text = _TABLE.sub(lambda found: f"```text\n{found[0]}\n```", text)
    text = _EXAMPLE.sub(lambda found: f"\n```pycon\n{found[0]}\n```", text)
    return re.sub(r"(?m)^::\n\n|(?<=\w)::$", lambda found: ":" if found[0] == "::" else "", text)


class Docstrings(Extension):
    """Rewrites each docstring once it is loaded."""

    def on_instance(self, *, obj: Object, **_: Any) -> None:
        """Rewrite the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = markdown_of(obj.docstring.value)
