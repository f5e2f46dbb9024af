"""Archives of arrays by strangers: damaged, hostile, and right."""

from __future__ import annotations

import io
import random
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, GlsplatError, PoseError
from glsplat.extras.formats import npz
from glsplat.extras.formats.npz import array_names, read_arrays
from glsplat.extras.formats.person import read_body
from tests.formats.test_contract import peak_of


def archive(**arrays: object) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def test_what_is_asked_for_and_nothing_else():
    data = archive(a=np.arange(3), b=np.ones((2, 2), np.float32), c=np.array(["x"]))
    assert sorted(read_arrays(io.BytesIO(data), "a body")) == ["a", "b", "c"]
    found = read_arrays(io.BytesIO(data), "a body", ("b",), optional=("c", "d"))
    assert sorted(found) == ["b", "c"] and found["b"].dtype == np.float32
    assert array_names(io.BytesIO(data)) == ["a", "b", "c"] and array_names(io.BytesIO(b"PK")) == []


@pytest.mark.parametrize("error", [FormatError, PoseError])
def test_what_is_missing_is_named(error: type[GlsplatError]):
    with pytest.raises(error, match="a body needs joints; found a, b"):
        read_arrays(io.BytesIO(archive(a=1, b=2)), "a body", ("a", "joints"), error=error)
    with pytest.raises(error, match=r"a body is an \.npz archive, but this is none"):
        read_arrays(io.BytesIO(b"solid cube"), "a body", error=error)


def bomb(size: int, claimed: int) -> bytes:
    """An array of zeros of ``size`` bytes, whose header speaks of ``claimed``."""
    header = io.BytesIO()
    shape = {"descr": "|u1", "fortran_order": False, "shape": (claimed,)}
    np.lib.format.write_array_header_1_0(header, shape)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as zipped:
        zipped.writestr("a.npy", header.getvalue() + bytes(size))
    return file.getvalue()


def test_a_bomb_is_refused_before_it_unpacks(monkeypatch: pytest.MonkeyPatch):
    assert npz._MOST == 1 << 30
    monkeypatch.setattr(npz, "_MOST", 10 << 20)
    data = bomb(11 << 20, 11 << 20)

    def refused():
        with pytest.raises(FormatError, match="unpacks to 10 MiB at most, this one to 11"):
            read_arrays(io.BytesIO(data), "a person")

    assert peak_of(refused) < 1 << 20
    assert read_arrays(io.BytesIO(data), "a person", (), optional=("b",)) == {}  # what nobody asks for, nobody unpacks


@pytest.mark.parametrize("claimed", [1 << 20, 1 << 45, 1 << 62])
def test_an_array_that_claims_more_than_it_has(claimed: int):
    with pytest.raises(FormatError, match=r"a person is an \.npz of numbers, but"):
        read_arrays(io.BytesIO(bomb(100, claimed)), "a person")


def test_pickles_passwords_and_other_packings():
    pickled = io.BytesIO()
    np.savez(pickled, a=np.array([{}], object))
    plain = archive(a=np.arange(1000))
    locked = bytearray(plain)
    for place in (6, plain.rindex(b"PK\x01\x02") + 8):  # both headers' flags: encrypted
        locked[place] |= 1
    odd = bytearray(plain)
    for place in (8, plain.rindex(b"PK\x01\x02") + 10):  # and their method: none that anybody knows
        odd[place] = 77
    for data in (pickled.getvalue(), bytes(locked), bytes(odd)):
        with pytest.raises(FormatError) as caught:
            read_arrays(io.BytesIO(data), "a person")
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@pytest.mark.filterwarnings("ignore:Reading `.npy`")  # a header of Python 2, where a byte happened to look like one
def test_damage_is_one_line():
    whole = archive(a=np.arange(4000), b=np.random.default_rng(0).normal(size=500))
    rng = random.Random(5)
    refused = set()
    for _ in range(400):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 6)):
            data[rng.randrange(4, len(data))] = rng.randrange(256)
        if rng.random() < 0.2:
            del data[rng.randrange(4, len(data)) :]
        try:
            read_arrays(io.BytesIO(bytes(data)), "a person")
        except FormatError as error:
            assert "\n" not in str(error)
            refused.add(type(error.__cause__ or error.__context__))
    assert {zipfile.BadZipFile, zlib.error} <= refused  # that is, of more kinds than one


def test_an_expression_may_move_nothing(tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    np.savez(
        path,
        v_template=np.eye(3),
        faces=np.array([[0, 1, 2]]),
        joint_names=np.array(["root"]),
        parents=np.array([-1]),
        joints=np.zeros((1, 3)),
        skin_indices=np.zeros((3, 1), int),
        skin_weights=np.ones((3, 1)),
        expr_names=np.array(["jawOpen", "still", "cheekPuff"]),
        expr_ptr=np.array([0, 2, 2, 3]),
        expr_idx=np.array([0, 1, 2]),
        expr_val=np.full((3, 3), 0.01, np.float16),
    )
    morphs = read_body(path).morphs
    assert morphs is not None and morphs.starts.tolist() == [0, 2, 2, 3]
