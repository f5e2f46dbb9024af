"""Read the tensors of a PyTorch checkpoint of before version 1.6, without PyTorch; no other object is made."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, one_line

_TYPES: dict[str, np.dtype[Any]] = {"FloatStorage": np.dtype("<f4"), "LongStorage": np.dtype("<i8")}


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


class _Tensor(NamedTuple):
    storage: tuple[Any, ...]  # "storage", type, key, device, number of values
    offset: int
    shape: tuple[int, ...]


_KNOWN: dict[tuple[str, str], Any] = {("torch", name): name for name in _TYPES} | {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor_v2"): lambda storage, offset, shape, *_: _Tensor(storage, offset, shape),
}


def read_tensors(path: Path) -> dict[str, NDArray[Any]]:
    """Return the tensors by name. Raises FormatError, one line, for another file, or one that holds more."""
    try:
        with path.open("rb") as file:
            _magic, _protocol, _system, tensors, keys = [ListedUnpickler(file, _KNOWN).load() for _ in range(5)]
            types = {tensor.storage[2]: _TYPES[tensor.storage[1]] for tensor in tensors.values()}
            storages = {key: _values(file, types[key]) for key in keys}
            return {
                name: storages[one.storage[2]][one.offset : one.offset + int(np.prod(one.shape))].reshape(one.shape)
                for name, one in tensors.items()
            }
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from None
    except Exception as error:  # a damaged pickle raises whatever its bytes happen to mean
        raise FormatError(f"{path}: not a PyTorch checkpoint ({one_line(error)})") from None


def _values(file: BinaryIO, dtype: np.dtype[Any]) -> NDArray[Any]:
    count = int(np.frombuffer(file.read(8), "<i8")[0])
    return np.frombuffer(file.read(count * dtype.itemsize), dtype, count)
