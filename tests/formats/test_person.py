"""Bodies in archives (.npz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glsplat.formats.person import read_body


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
