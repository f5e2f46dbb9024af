"""Untrusted NumPy archives (.npz): every failure is one line, and nothing is unpacked without a limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, GlsplatError

_MOST = 1 << 30  # most unpacked bytes of the arrays; the body models in use take a tenth of it


def array_names(file: BinaryIO) -> list[str]:
    """Return the names of the archive's arrays; [] for another file."""
    try:
        with np.load(file, allow_pickle=False) as archive:
            return list(archive.files)
    except OSError:
        raise
    except Exception:  # the reader reports the mistake
        return []


def read_arrays(
    file: BinaryIO,
    what: str,
    keys: Sequence[str] | None = None,
    *,
    optional: Sequence[str] = (),
    error: type[GlsplatError] = FormatError,
) -> dict[str, NDArray[Any]]:
    """Read arrays by name: all of the archive ``file``, or ``keys`` and the present ones of ``optional``.

    Nothing else is unpacked, and no pickle is read. Raises ``error``, whose message begins with ``what`` ("a person"),
    for a file that is no archive, is damaged, lacks one of the ``keys`` or holds more than a gigabyte. OSError is
    passed to the caller, who knows the file's name.
    """
    if file.read(2) != b"PK":
        raise error(f"{what} is an .npz archive, but this is none")
    file.seek(0)
    try:
        with np.load(file, allow_pickle=False) as archive:
            inside = archive.files
            missing = [key for key in keys or () if key not in inside]
            if missing:
                raise error(f"{what} needs {missing[0]}; found {', '.join(inside[:8]) or 'nothing'}")
            wanted = inside if keys is None else [*keys, *(key for key in optional if key in inside)]
            names = {name for key in wanted for name in (key, f"{key}.npy")}
            size = sum(info.file_size for info in archive.zip.infolist() if info.filename in names)
            if size > _MOST:
                raise error(f"{what} unpacks to {_MOST >> 20} MiB at most, this one to {size >> 20}")
            return {key: np.asarray(archive[key]) for key in wanted}
    except (GlsplatError, OSError):
        raise
    except Exception as failed:  # zlib.error, BadZipFile, SyntaxError of a header, MemoryError
        raise error(f"{what} is an .npz of numbers, but {' '.join(str(failed).split())[:120]}") from None
