"""Read pickles that strangers wrote: only listed objects are made."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from typing import Any, BinaryIO


class ListedUnpickler(pickle.Unpickler):
    """Makes what ``known`` holds by (module, name), and refuses other objects by name; persistent ids are kept."""

    def __init__(self, file: BinaryIO, known: Mapping[tuple[str, str], Any]) -> None:
        super().__init__(file)
        self._known = known

    def find_class(self, module: str, name: str) -> Any:
        """Return the object of that name. Raises UnpicklingError for others."""
        if (module, name) not in self._known:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return self._known[module, name]

    def persistent_load(self, pid: Any) -> Any:
        """Return the id itself."""
        return pid
