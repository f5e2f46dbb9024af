"""The network of hair: its file is read without PyTorch, its layers are those of ONNX, and it sees hair and hats."""

from __future__ import annotations

import os
import pickle
import sys
import types
from collections import OrderedDict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.head_parts import HeadPart, available, head_parts
from glsplat.extras.authoring.networks.onnx import Graph
from glsplat.extras.authoring.networks.people import find_person
from glsplat.extras.authoring.networks.torch_file import read_tensors
from glsplat.extras.authoring.segment.mask import with_head
from tests.extras.authoring.captures import needs_networks

TENSORS = {"conv.weight": np.arange(24, dtype="<f4").reshape(2, 3, 2, 2), "bn.batches": np.array([7], "<i8")}


class Stored:
    """A tensor as PyTorch pickles it."""

    def __init__(self, kind: type, key: str, values: np.ndarray) -> None:
        self.storage, self.values = (kind, key), values

    def __reduce__(self) -> tuple[Any, ...]:
        shape = self.values.shape
        steps = tuple(step // self.values.itemsize for step in self.values.strides)
        rebuild = sys.modules["torch._utils"]._rebuild_tensor_v2  # type: ignore[attr-defined]
        return rebuild, (Handle(*self.storage, self.values.size), 0, shape, steps, False, OrderedDict())


class Handle:
    """Values that follow behind the pickles."""

    def __init__(self, kind: type, key: str, count: int) -> None:
        self.pid = "storage", kind, key, "cpu", count, None


class Writer(pickle.Pickler):
    def persistent_id(self, obj: Any) -> Any:
        return obj.pid if isinstance(obj, Handle) else None


@pytest.fixture
def checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkpoint of PyTorch 1.5, written without it."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")
    kinds = {
        dtype: type(name, (), {"__module__": "torch"}) for dtype, name in (("f", "FloatStorage"), ("i", "LongStorage"))
    }
    for kind in kinds.values():
        setattr(torch, kind.__name__, kind)

    def rebuild(*_: Any) -> None: ...

    rebuild.__module__, rebuild.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = rebuild  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "torch._utils", utils)
    path = tmp_path / "made.pth"
    with path.open("wb") as file:
        tree = OrderedDict(
            (name, Stored(kinds[values.dtype.kind], str(key), values))
            for key, (name, values) in enumerate(TENSORS.items())
        )
        for part in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}, tree, ["0", "1"]):
            Writer(file, 2).dump(part)
        for values in TENSORS.values():
            file.write(np.int64(values.size).tobytes() + values.tobytes())
    return path


def test_a_checkpoint_is_read_without_torch(checkpoint: Path) -> None:
    found = read_tensors(checkpoint)
    assert list(found) == list(TENSORS)
    for name, values in TENSORS.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_checkpoint_runs_nothing(checkpoint: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.pth"
    cut.write_bytes(checkpoint.read_bytes()[:-8])
    with pytest.raises(FormatError, match=r"cut\.pth: not a PyTorch checkpoint"):
        read_tensors(cut)

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "owned"),)

    evil = tmp_path / "evil.pth"
    evil.write_bytes(pickle.dumps(Evil()))
    with pytest.raises(FormatError, match=r"it names \w+\.mkdir"):
        read_tensors(evil)
    assert not (tmp_path / "owned").exists()
    with pytest.raises(FormatError, match="cannot be read"):
        read_tensors(tmp_path / "none.pth")


def test_layers_compute_what_their_names_say() -> None:
    graph = Graph()
    mean = graph.add("GlobalAveragePool", ["picture"])
    how = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
    large = graph.add("Resize", [graph.max_pool("picture", 2), "", graph.tensor(np.array([1, 1, 2, 2]))], **how)
    both = graph.add("Concat", [graph.add("Mul", [large, graph.add("Sigmoid", [mean])]), "picture"], axis=1)
    network = graph.network((4, 6), [both])
    picture = np.random.default_rng(0).normal(size=(1, 3, 4, 6)).astype(np.float32)
    network.setInput(picture)
    pooled = picture.reshape(1, 3, 2, 2, 3, 2).max(axis=(3, 5)).repeat(2, axis=2).repeat(2, axis=3)
    weight = 1 / (1 + np.exp(-picture.mean(axis=(2, 3), keepdims=True)))
    np.testing.assert_allclose(network.forward(), np.concatenate([pooled * weight, picture], axis=1), atol=1e-6)


@pytest.mark.shared
@pytest.mark.skipif(not available(), reason="needs the network of 'glsplat models get hair'")
@pytest.mark.parametrize(("name", "hat"), [("000057.jpg", True), ("teaserc.jpg", False), ("c85463b5.jpg", False)])
def test_hair_and_hats_are_seen(shared_data: Path, name: str, hat: bool) -> None:
    needs_networks()
    picture = np.ascontiguousarray(cv2.imread(str(shared_data / "photos" / name))[..., ::-1])
    person = find_person(picture)
    assert person is not None
    face = person.face.points[:, :2]
    middle = (face.min(axis=0) + face.max(axis=0)) / 2
    high = float(np.ptp(face[:, 1]))
    parts = head_parts(picture, person.face)
    assert parts is not None and parts.shape == picture.shape[:2]
    x, y = middle.astype(int)
    assert parts[y : y + int(high / 10), x].min() > HeadPart.BACKGROUND  # the nose
    assert (parts == HeadPart.HAIR).sum() > 0.1 * high**2 and ((parts == HeadPart.HAT).sum() > 0.1 * high**2) == hat
    top = HeadPart.HAT if hat else HeadPart.HAIR
    assert parts[max(int(y - 1.3 * high), 0) : int(y - 0.5 * high), x].max() == top
    assert (parts[int(y + 0.6 * high) :, x] == HeadPart.CLOTH).any()


def test_a_mask_is_extended_by_what_the_head_wears() -> None:
    mask, parts = np.zeros((40, 40), bool), np.zeros((40, 40), np.uint8)
    mask[10:, 10:30] = True
    parts[5:12, 10:20], parts[5:12, 20:30] = HeadPart.HAIR, HeadPart.HAT
    parts[:, 35:] = HeadPart.HAIR  # of somebody behind
    parts[20:30, :10] = HeadPart.CLOTH
    expected = mask.copy()
    expected[5:10, 10:30] = True
    np.testing.assert_array_equal(with_head(mask, parts), expected)
    np.testing.assert_array_equal(with_head(mask, None), mask)
