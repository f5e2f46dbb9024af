"""Where joints were when several skins were bound."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.extras.rigs.gltf import bound_of
from glsplat.formats.gltf.container import parse
from glsplat.formats.gltf.nodes import graph_of


def test_a_second_skin_may_have_one_joint_of_its_own() -> None:
    """It is stored half a metre aside of the first one's space, and shown where its node is."""
    inverse = np.tile(np.eye(4, dtype="<f4"), (3, 1, 1))  # columns, as files have them
    inverse[2, 3, 0] = -0.5
    data = inverse.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [{"children": [1]}, {}, {"translation": [2.0, 0, 0]}],
        "buffers": [{"byteLength": 192, "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 128}, {"buffer": 0, "byteOffset": 128, "byteLength": 64}],
        "accessors": [
            {"bufferView": view, "componentType": 5126, "count": count, "type": "MAT4"}
            for view, count in ((0, 2), (1, 1))
        ],
        "skins": [{"joints": [0, 1], "inverseBindMatrices": 0}, {"joints": [2], "inverseBindMatrices": 1}],
    }
    container = parse(json.dumps(document).encode(), Path())
    bound = bound_of(container, graph_of(container.gltf), [0, 1])
    assert bound.frames[:2, :3, 3] == pytest.approx(np.zeros((2, 3)))
    assert bound.frames[2, :3, 3] == pytest.approx([2, 0, 0])
