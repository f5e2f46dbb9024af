"""Read the tensors of a PyTorch checkpoint of before version 1.6, without PyTorch; no other object is made."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError

_TYPES: dict[str, np.dtype[Any]] = {"FloatStorage": np.dtype("<f4"), "LongStorage": np.dtype("<i8")}


class _Tensor(NamedTuple):
    storage: tuple[Any, ...]  # "storage", type, key, device, number of values
    offset: int
    shape: tuple[int, ...]


def read_tensors(path: Path) -> dict[str, NDArray[Any]]:
    """Return the tensors by name. Raises FormatError, one line, for another file, or one that holds more."""
    try:
        with path.open("rb") as file:
            _magic, _protocol, _system, tensors, keys = [_Unpickler(file).load() for _ in range(5)]
            types = {tensor.storage[2]: _TYPES[tensor.storage[1]] for tensor in tensors.values()}
            storages = {key: _values(file, types[key]) for key in keys}
            return {
                name: storages[one.storage[2]][one.offset : one.offset + int(np.prod(one.shape))].reshape(one.shape)
                for name, one in tensors.items()
            }
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from None
    except Exception as error:  # a damaged pickle raises whatever its bytes happen to mean
        line = " ".join(str(error).split())[:200]
        raise FormatError(f"{path}: not a PyTorch checkpoint ({type(error).__name__}: {line})") from None


class _Unpickler(pickle.Unpickler):
    """Make tensors and dictionaries, and refuse other objects by name."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda storage, offset, shape, *_: _Tensor(storage, offset, shape)
        if module == "torch" and name in _TYPES:
            return name
        raise pickle.UnpicklingError(f"it names {module}.{name}")

    def persistent_load(self, pid: Any) -> Any:
        return pid


def _values(file: BinaryIO, dtype: np.dtype[Any]) -> NDArray[Any]:
    count = int(np.frombuffer(file.read(8), "<i8")[0])
    return np.frombuffer(file.read(count * dtype.itemsize), dtype, count)
