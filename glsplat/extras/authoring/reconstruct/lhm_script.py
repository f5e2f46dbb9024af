"""Dump LHM's Gaussians for one picture. Run by the interpreter of LHM's environment, in the folder of its checkout.

lhm.py copies and starts this script, which imports nothing of glsplat and writes the file that
``authoring.importers.lhm_dump`` reads. Modules and attributes are those of LHM's public code of 2025; the script was
never run against an installation.
"""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

_MODEL = "human_lrm_sapdino_bh_sd3_5"
_WIDTH, _PATCH, _ASPECT = 1024, 14, 5 / 3  # of the encoder's picture
_HEAD_PX = 112  # side of the head's picture
_POSE = {"root_pose": (3,), "body_pose": (21, 3), "jaw_pose": (3,), "leye_pose": (3,), "reye_pose": (3,)}
_POSE |= {"lhand_pose": (15, 3), "rhand_pose": (15, 3), "expr": (100,), "trans": (3,)}


def main() -> None:
    """Read picture.png and mask.png in a folder and write dump.npz there."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", required=True)
    parser.add_argument("--model", required=True)
    parser.add_argument("--head", type=int, nargs=4, default=(0, 0, 0, 0))
    args = parser.parse_args()
    sys.argv = sys.argv[:1]  # LHM's modules read the command line, too
    sys.path.insert(0, os.getcwd())

    print_progress(0.0, "loading LHM")
    import cv2
    import numpy as np
    import torch
    from engine.pose_estimation.pose_estimator import PoseEstimator
    from LHM.models import model_dict
    from LHM.utils.hf_hub import wrap_model_hub

    device = "cuda" if torch.cuda.is_available() else "cpu"
    path = os.path.join(args.folder, "picture.png")
    picture = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
    mask = cv2.imread(os.path.join(args.folder, "mask.png"), cv2.IMREAD_GRAYSCALE) > 127

    print_progress(0.1, "LHM estimates the body")
    body = PoseEstimator("./pretrained_models/human_model_files/", device=device)(path)
    if not body.is_full_body:
        sys.exit(f"LHM finds no whole body: {body.msg}")
    betas = torch.as_tensor(np.asarray(body.beta, np.float32).reshape(1, -1)[:, :10], device=device)

    print_progress(0.3, "LHM loads its weights")
    model = wrap_model_hub(model_dict[_MODEL]).from_pretrained(weights_of(args.model)).to(device).float().eval()

    print_progress(0.6, "LHM makes the avatar")
    pose = {key: torch.zeros((1, 1, *shape), device=device) for key, shape in _POSE.items()} | {"betas": betas}
    left, top, right, bottom = args.head
    head = np.zeros((_HEAD_PX, _HEAD_PX, 3), np.uint8)
    if right > left and bottom > top:
        head = cv2.resize(picture[top:bottom, left:right], (_HEAD_PX, _HEAD_PX), interpolation=cv2.INTER_AREA)
    with torch.no_grad():
        gaussians, query, neutral = model.infer_single_view(
            as_tensor(framed(picture, mask), device),
            as_tensor(head, device),
            None,
            None,
            render_c2ws=None,
            render_intrs=None,
            render_bg_colors=None,
            smplx_params=pose,
        )
        rig = model.renderer.smplx_model
        joints = rig.get_zero_pose_human(shape_param=betas, device=device, face_offset=None, joint_offset=None)

    print_progress(0.95, "LHM is done")
    made = gaussians[0]
    count = len(made.offset_xyz)
    arrays = {
        "query_points": query[0],
        "offset_xyz": made.offset_xyz,
        "opacity": made.opacity.reshape(count, 1),
        "rotation_wxyz": made.rotation,
        "scaling": made.scaling,
        "rgb": made.shs.reshape(count, -1)[:, :3],
        "skinning_weight": rig.skinning_weight,
        "transform_mat_neutral_pose": neutral.reshape(-1, 4, 4)[:55],
        "betas": betas[0],
        "shape_dirs": rig.shape_dirs[..., :10],
        "joints_zero": joints.reshape(-1, 3)[:55],
        "parents": rig.smplx_layer.parents,
        "is_constrain_body": rig.is_constrain_body,
    }
    plain = {key: torch.as_tensor(value).detach().float().cpu().numpy() for key, value in arrays.items()}
    np.savez(os.path.join(args.folder, "dump.npz"), **plain)


def print_progress(done: float, step: str) -> None:
    """Print the progress line that lhm.py parses."""
    print(f"glsplat: {done:.2f} {step}", flush=True)


def weights_of(model: str) -> str:
    """Return the folder of a model's weights: ``model`` itself, or that of LHM's table."""
    if os.path.isdir(model):
        return model
    from LHM.utils.model_card import MODEL_PATH

    if model not in MODEL_PATH:
        sys.exit(f"LHM knows no model {model}; there are {', '.join(MODEL_PATH)}")
    if not os.path.isdir(MODEL_PATH[model]):
        sys.exit(f"the weights of {model} are not in {MODEL_PATH[model]}; download them as LHM's page says")
    return str(MODEL_PATH[model])


def framed(picture: Any, mask: Any) -> Any:
    """Return the person before white in a picture of 5 to 3, with a margin of a tenth; RGB uint8."""
    import cv2
    import numpy as np

    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    high = max(1.1 * (rows[-1] - rows[0] + 1), 1.1 * (columns[-1] - columns[0] + 1) * _ASPECT)
    wide = high / _ASPECT
    size = int(_WIDTH / _PATCH) * _PATCH, int(_WIDTH * _ASPECT / _PATCH) * _PATCH
    x, y = (columns[0] + columns[-1] + 1) / 2 - wide / 2, (rows[0] + rows[-1] + 1) / 2 - high / 2
    white = np.where(mask[..., None], picture, 255).astype(np.uint8)
    grow = np.array([[size[0] / wide, 0, -x * size[0] / wide], [0, size[1] / high, -y * size[1] / high]])
    return cv2.warpAffine(white, grow, size, flags=cv2.INTER_LINEAR, borderValue=(255, 255, 255))


def as_tensor(picture: Any, device: str) -> Any:
    """Return the picture as [1, 1, 3, H, W], 0 to 1."""
    import torch

    return torch.as_tensor(picture, device=device).permute(2, 0, 1)[None, None].float() / 255


if __name__ == "__main__":
    main()
