"""LPIPS: PyPI's own program on torch says the same; its formula holds without it; weights are not believed."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.models.catalogue import LPIPS
from glsplat.extras.authoring.models.store import state_of
from glsplat.extras.evaluate.lpips import BACKBONES, Backbone, Lpips, read_weights
from tests.extras.evaluate.lpips_pairs import DATA, small_pairs

Tree = dict[str, dict[str, dict[str, Any]]]


def made_up(backbone: Backbone) -> Tree:
    """Weights of the right shapes, as the package lays them out."""
    rng = np.random.default_rng(5)
    convolutions = {
        f"Conv_{index}": {
            "kernel": rng.normal(0, 1 / np.sqrt(side * side * inside), (side, side, inside, outside)).astype("f4"),
            "bias": rng.normal(0, 0.1, outside).astype("f4"),
        }
        for index, (side, inside, outside) in enumerate(backbone.kernels)
    }
    heads = {
        f"NetLinLayer_{index}": {"Conv_0": {"kernel": rng.random((1, 1, backbone.kernels[layer][2], 1)).astype("f4")}}
        for index, layer in enumerate(backbone.seen)
    }
    return {backbone.key: convolutions, **heads}


def correlated(picture: np.ndarray, kernel: np.ndarray, bias: np.ndarray, stride: int, padding: int) -> np.ndarray:
    """A convolution as it is written in books, in float64."""
    padded = np.pad(picture.astype(np.float64), ((padding,) * 2, (padding,) * 2, (0, 0)))
    windows = sliding_window_view(padded, kernel.shape[:2], axis=(0, 1))[::stride, ::stride]
    return np.maximum(np.einsum("hwcij,ijco->hwo", windows, kernel.astype(np.float64), optimize=True) + bias, 0)


@pytest.fixture(scope="module")
def alex(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "alex.ckpt"
    path.write_bytes(pickle.dumps(made_up(BACKBONES["alex"]), protocol=3))
    return path


# stride and padding of each convolution; before which of them the maximum is taken, over how many pixels; which count
BOOKS: dict[Any, Any] = {
    "alex": ([(4, 2), (1, 2), (1, 1), (1, 1), (1, 1)], (1, 2), 3, (0, 1, 2, 3, 4)),
    "vgg": ([(1, 1)] * 13, (2, 4, 7, 10), 2, (1, 3, 6, 9, 12)),
}


@pytest.mark.parametrize("kind", ["alex", pytest.param("vgg", marks=pytest.mark.check)])
def test_the_distance_written_out(kind: Any, tmp_path: Path, rng: np.random.Generator) -> None:
    """Without the store: the publication's formula on made-up weights, in float64."""
    tree, (convolutions, pooled, side, seen) = made_up(BACKBONES[kind]), BOOKS[kind]
    (tmp_path / "w.ckpt").write_bytes(pickle.dumps(tree, protocol=3))
    pair = rng.random((2, 47, 40, 3))

    def layers(picture: np.ndarray) -> list[np.ndarray]:
        values = (2 * picture - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
        found = []
        for index, (stride, padding) in enumerate(convolutions):
            if index in pooled:
                values = sliding_window_view(values, (side, side), axis=(0, 1))[::2, ::2].max(axis=(3, 4))
            weights = tree[BACKBONES[kind].key][f"Conv_{index}"]
            values = correlated(values, weights["kernel"], weights["bias"], stride, padding)
            if index in seen:
                found.append(values / np.linalg.norm(values, axis=2, keepdims=True))
        return found

    heads = [tree[f"NetLinLayer_{index}"]["Conv_0"]["kernel"].ravel() for index in range(5)]
    right = sum(((a - b) ** 2 @ head).mean() for a, b, head in zip(*map(layers, pair), heads, strict=True))
    lpips = Lpips(kind, tmp_path / "w.ckpt")
    first, second = (lpips.features(picture) for picture in pair)
    assert lpips.distance(first, second) == pytest.approx(right, abs=1e-6) and right > 0.01
    assert lpips.distance(second, first) == lpips.distance(first, second) and lpips.distance(first, first) == 0
    assert lpips.distance(lpips.features(pair[0].astype(np.float32)), second) == pytest.approx(right, abs=1e-5)


@pytest.mark.skipif(
    any(state_of(model) != "here" for model in LPIPS.models), reason="needs the weights of 'glsplat models get lpips'"
)
@pytest.mark.parametrize("kind", ["alex", "vgg"])
def test_it_is_what_the_reference_says(kind: Any) -> None:
    expected = json.loads((DATA / "lpips.json").read_text())[kind]
    lpips = Lpips(kind)
    pairs = small_pairs()
    assert set(pairs) == set(expected)
    for name, (picture, truth) in pairs.items():
        found = lpips.distance(lpips.features(picture), lpips.features(truth))
        assert found == pytest.approx(expected[name], abs=2e-6), name


def test_pictures_it_cannot_compare(alex: Path, rng: np.random.Generator) -> None:
    lpips = Lpips("alex", alex)
    small = rng.random((31, 31, 3))
    assert [layer.shape[:2] for layer in lpips.features(small)] == [(7, 7), (3, 3), (1, 1), (1, 1), (1, 1)]
    with pytest.raises(GlsplatError, match=r"LPIPS \(alex\) needs 31 pixels each way, not 31 x 30"):
        lpips.features(small[:30])
    with pytest.raises(GlsplatError, match="compares pictures of one size"):
        lpips.distance(lpips.features(small), lpips.features(rng.random((31, 35, 3))))
    with pytest.raises(GlsplatError, match=r"expected a picture in \[0, 1\]"):
        lpips.features(small * 255)


def test_without_weights_it_says_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path))
    with pytest.raises(GlsplatError, match=r"vgg16\.ckpt: .* not on this machine; run: glsplat models get lpips$"):
        Lpips("vgg")
    with pytest.raises(GlsplatError, match="squeeze: no such network of LPIPS; there are alex, vgg"):
        Lpips("squeeze")  # type: ignore[arg-type]


class Evil:
    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.trace),)


def test_weights_run_nothing(tmp_path: Path) -> None:
    path = tmp_path / "evil.ckpt"
    for thing in (Evil(tmp_path / "made"), {"AlexNet_0": Evil(tmp_path / "made")}, os.system, np.random.default_rng()):
        path.write_bytes(pickle.dumps(thing, protocol=3))
        message = r"evil.ckpt: not a pickle of arrays \(UnpicklingError: it names "
        with pytest.raises(FormatError, match=message) as refused:
            read_weights(path, BACKBONES["alex"])
        assert "\n" not in str(refused.value)
    assert not (tmp_path / "made").exists()


def test_wrong_weights_are_one_line(tmp_path: Path, alex: Path) -> None:
    def wrong(message: str, change: Any) -> None:
        tree = made_up(BACKBONES["alex"])
        change(tree)
        path = tmp_path / "w.ckpt"
        path.write_bytes(pickle.dumps(tree, protocol=3))
        with pytest.raises(FormatError, match=message):
            read_weights(path, BACKBONES["alex"])

    wrong("found none", lambda tree: tree.pop("NetLinLayer_4"))
    shape = r"expected floats \(11, 11, 3, 64\)"
    wrong(shape, lambda tree: tree["AlexNet_0"]["Conv_0"].update(kernel=np.zeros(3, "f4")))
    wrong("found float64", lambda tree: tree["AlexNet_0"]["Conv_2"].update(bias=np.zeros(384)))
    wrong("not finite", lambda tree: tree["AlexNet_0"]["Conv_2"].update(bias=np.full(384, np.nan, "f4")))
    wrong("negative", lambda tree: np.negative(*[tree["NetLinLayer_1"]["Conv_0"]["kernel"]] * 2))
    with pytest.raises(FormatError, match=r"at VGG16_0/Conv_0/kernel, found none"):
        read_weights(alex, BACKBONES["vgg"])
    (tmp_path / "cut.ckpt").write_bytes(alex.read_bytes()[:1000])
    for name in ("cut.ckpt", "none.ckpt", "."):
        with pytest.raises(FormatError, match="not a pickle of arrays" if name == "cut.ckpt" else "cannot be read"):
            read_weights(tmp_path / name, BACKBONES["alex"])
