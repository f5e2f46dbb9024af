"""Mutated SOG files, the parts mutated before they are packed: a zip's checksums would hide most of it."""

from __future__ import annotations

import json
import zipfile
from functools import lru_cache
from io import BytesIO
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from glsplat.formats import load, load_sog, save
from tests.formats.scenes import SHARED_DATA, random_splats
from tests.formats.sog_files import by_hand, pack, zipped
from tests.formats.test_fuzz import fuzz, mutated, only_format_errors

REAL = SHARED_DATA / "real" / "splats" / "playbot_5_sog"


@lru_cache(maxsize=1)
def seeds() -> list[dict[str, bytes]]:
    """Files by name: both versions by hand, one as we write it, one of another maker where it is there."""
    packed = BytesIO()
    save(random_splats(9, 2), packed, format="sog")
    found = [pack(*by_hand(1)), pack(*by_hand(2)), packed.getvalue()]
    out = []
    for data in found:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            out.append({name: archive.read(name) for name in archive.namelist()})
    if REAL.is_dir():
        out.append({path.name: path.read_bytes() for path in sorted(REAL.iterdir())})
    return out


def tried(folder: Path, files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    """As a zip, and unpacked."""
    (folder / "fuzz.sog").write_bytes(zipped(files, method))
    only_format_errors(folder / "fuzz.sog", load)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    only_format_errors(folder / "meta.json", load_sog)


@fuzz
@given(data=st.data())
def test_mutated_meta(tmp_path: Path, data: st.DataObject) -> None:
    files = dict(data.draw(st.sampled_from(seeds())))
    # of the codebooks, the first few numbers
    meta = mutated(data, json.loads(files["meta.json"]), lambda path: len(path) < 3 or path[2] in range(4))
    tried(tmp_path, files | {"meta.json": json.dumps(meta).encode()})


@fuzz
@given(data=st.data())
def test_mutated_images(tmp_path: Path, data: st.DataObject) -> None:
    files = dict(data.draw(st.sampled_from(seeds())))
    for _ in range(data.draw(st.integers(1, 3))):
        name = data.draw(st.sampled_from(sorted(files)))
        content = bytearray(files[name])
        kind = data.draw(st.sampled_from(["set", "head", "head", "cut", "swap"]))
        some = data.draw(st.binary(min_size=1, max_size=8))
        if kind == "swap":
            content = bytearray(files[data.draw(st.sampled_from(sorted(files)))])
        elif kind == "cut":
            del content[data.draw(st.integers(0, len(content))) :]
        else:
            at = data.draw(st.integers(0, min(len(content), 40 if kind == "head" else 5000)))
            content[at : at + len(some)] = some
        files[name] = bytes(content)
    tried(tmp_path, files, data.draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])))


@fuzz
@given(data=st.data())
def test_mutated_zip(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(zipped(data.draw(st.sampled_from(seeds()[:3])), zipfile.ZIP_STORED))
    directory = content.index(b"PK\1\2")
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(directory, len(content)) | st.integers(0, len(content)))
        content[at : at + 2] = data.draw(st.binary(min_size=1, max_size=4))
    (tmp_path / "fuzz.sog").write_bytes(content)
    only_format_errors(tmp_path / "fuzz.sog", load)
