"""LHM as a process, and the script that runs in it; stand-ins for LHM, which needs a large graphics card."""

from __future__ import annotations

import os
import stat
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.authoring.reconstruct.lhm import Lhm, from_environment
from glsplat.extras.authoring.reconstruct.reconstructor import Options, Picture
from glsplat.skinning.smplx import PARENTS

PICTURE = np.full((60, 40, 3), (200, 100, 50), np.uint8)
MASK = np.zeros((60, 40), bool)
MASK[5:55, 10:30] = True

DUMP = """
import argparse, os, sys, time
import numpy as np
parser = argparse.ArgumentParser()
parser.add_argument("script")
parser.add_argument("--folder")
parser.add_argument("--model")
parser.add_argument("--head", nargs=4)
args = parser.parse_args()
n = 150
rng = np.random.default_rng(0)
data = dict(
    query_points=rng.normal(0, 0.5, (n, 3)), offset_xyz=np.zeros((n, 3)), opacity=np.ones((n, 1)),
    rotation_wxyz=np.tile([1.0, 0, 0, 0], (n, 1)), scaling=np.full((n, 3), 0.01), rgb=rng.random((n, 3)),
    skinning_weight=np.eye(55)[rng.integers(0, 55, n)], transform_mat_neutral_pose=np.tile(np.eye(4), (55, 1, 1)),
    betas=np.zeros(10), shape_dirs=np.zeros((n, 3, 10)), joints_zero=rng.normal(0, 0.3, (55, 3)),
    parents=np.array(PARENTS), is_constrain_body=np.zeros(n))
out = os.path.join(args.folder, "dump.npz")
"""


@pytest.fixture
def installation(tmp_path, monkeypatch):
    """Makes an installation whose interpreter does what the given lines say, whatever it is asked to run."""

    def make(lines: str, timeout: float = 250.0) -> Lhm:
        folder = tmp_path / "installed"
        (folder / "LHM").mkdir(parents=True)
        python = folder / "python"
        dump = DUMP.replace("PARENTS", repr([int(parent) for parent in PARENTS]))
        python.write_text(f"#!{sys.executable}\n{dump}\n{lines}\n")
        python.chmod(python.stat().st_mode | stat.S_IXUSR)
        temporary = tmp_path / "tmp"
        temporary.mkdir()
        monkeypatch.setattr("tempfile.tempdir", str(temporary))
        return Lhm(folder, python, timeout)

    yield make
    left = tmp_path / "tmp"
    assert not left.exists() or not list(left.iterdir())  # the picture is gone, whatever happened


def run(lhm: Lhm, **wishes):
    return lhm.reconstruct({"front": Picture(PICTURE)}, {"front": MASK}, Options(**wishes))


def test_lhm_runs_in_its_own_process_and_its_dump_is_read(installation, monkeypatch, tmp_path) -> None:
    heard = tmp_path / "heard"
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    lhm = installation(
        "assert os.getcwd() == os.path.dirname(os.path.abspath(sys.argv[0]))\n"
        "assert 'PYTHONPATH' not in os.environ and not sys.stdin.read()\n"
        "names = sorted(os.listdir(args.folder))\n"
        "assert names == ['errors.txt', 'lhm_script.py', 'mask.png', 'output.txt', 'picture.png']\n"
        "assert args.model == 'LHM-500M' and args.head == ['0', '0', '0', '0']\n"
        "import cv2\n"
        "assert cv2.imread(args.folder + '/picture.png')[0, 0].tolist() == [50, 100, 200]\n"
        "assert (cv2.imread(args.folder + '/mask.png', 0) > 127).sum() == 1000\n"
        "print('glsplat: 0.60 LHM makes the avatar', flush=True)\n"
        f"while not os.path.exists({str(heard)!r}): time.sleep(0.01)\n"
        "np.savez(out, **data)"
    )
    steps = []

    def progress(step: str, done: float) -> None:
        steps.append((step, done))
        if done:
            heard.touch()

    avatar = run(lhm, progress=progress)
    assert len(avatar.splats) == 150 and len(avatar.skeleton) == 55
    assert ("LHM makes the avatar", 0.6) in steps
    assert str(lhm.folder) not in str(avatar.meta) and "CC BY-NC" in avatar.meta["licence"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            "print('loading', file=sys.stderr); raise MemoryError('CUDA out of memory')",
            "exit code 1.*: MemoryError: CUDA",
        ),
        (
            "sys.stderr.write('50%\\r100%\\r\\x1b[31mno weights\\n\\n'); sys.exit(3)",
            r"exit code 3\): \?\[31mno weights$",
        ),
        ("sys.exit(2)", "it said nothing"),
        ("os.kill(os.getpid(), 9)", "signal 9"),
        ("sys.stderr.write('x' * 3000000 + 'end of it'); sys.exit(1)", "x{200}"),
        ("pass", "ended without a result"),
        ("open(out, 'wb').write(b'PK' + bytes(500))", "what LHM wrote: an LHM dump is an .npz of numbers"),
    ],
)
def test_failures_are_one_line(installation, lines, message) -> None:
    with pytest.raises(GlsplatError, match=message) as caught:
        run(installation(lines))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_a_timeout_kills_the_process_group(installation, tmp_path, monkeypatch) -> None:
    mark = tmp_path / "pid"
    hours = SimpleNamespace(monotonic=lambda: 4.0 if mark.exists() else 0.0)  # which are over once it has begun
    monkeypatch.setattr("glsplat.extras.authoring.reconstruct.lhm.time", hours)
    lhm = installation(
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        f"open({str(mark) + '.new'!r}, 'w').write(str(child.pid))\n"
        f"os.replace({str(mark) + '.new'!r}, {str(mark)!r})\n"
        "time.sleep(600)",
        timeout=3.0,
    )
    with pytest.raises(GlsplatError, match="not done after 3 s; set GLSPLAT_LHM_TIMEOUT"):
        run(lhm)
    deadline = time.monotonic() + 60
    while _alive(int(mark.read_text())):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_an_interrupt_kills_the_process(installation) -> None:
    def interrupt(step: str, done: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(installation("time.sleep(600)"), progress=interrupt)


def test_unsupported_inputs_are_refused(installation) -> None:
    lhm = installation("pass")
    pictures = {"front": Picture(PICTURE), "back": Picture(PICTURE)}
    with pytest.raises(GlsplatError, match="front picture alone, not back"):
        lhm.reconstruct(pictures, {"front": MASK, "back": MASK}, Options())
    with pytest.raises(GlsplatError, match="not a height"):
        run(lhm, height=1.7)


def test_an_interpreter_that_cannot_run(installation) -> None:
    lhm = installation("pass")
    lhm.python.write_text("#!/nowhere/python\n")
    with pytest.raises(GlsplatError, match="LHM cannot be run: No such file"):
        run(lhm)


def test_the_environment_names_the_installation(tmp_path, monkeypatch) -> None:
    for name in ("GLSPLAT_LHM", "GLSPLAT_LHM_PYTHON", "GLSPLAT_LHM_TIMEOUT", "GLSPLAT_LHM_MODEL"):
        monkeypatch.delenv(name, raising=False)

    def refused(message: str) -> None:
        with pytest.raises(GlsplatError, match=message):
            from_environment()

    refused("set GLSPLAT_LHM to the folder")
    monkeypatch.setenv("GLSPLAT_LHM", str(tmp_path))
    refused("is not a checkout of LHM: it has no folder LHM")
    (tmp_path / "LHM").mkdir()
    refused("no interpreter there; set GLSPLAT_LHM_PYTHON")
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    os.symlink(sys.executable, python)
    assert from_environment() == Lhm(tmp_path, python, 600.0, "LHM-500M")
    monkeypatch.setenv("GLSPLAT_LHM_PYTHON", str(tmp_path))
    refused("no interpreter there")
    monkeypatch.setenv("GLSPLAT_LHM_PYTHON", sys.executable)
    monkeypatch.setenv("GLSPLAT_LHM_MODEL", "LHM-1B")
    for wrong in ("soon", "0", "-3", "nan", "inf"):
        monkeypatch.setenv("GLSPLAT_LHM_TIMEOUT", wrong)
        refused("GLSPLAT_LHM_TIMEOUT needs seconds above 0")
    monkeypatch.setenv("GLSPLAT_LHM_TIMEOUT", "1200")
    assert from_environment() == Lhm(tmp_path, Path(sys.executable).absolute(), 1200.0, "LHM-1B")


TORCH = """
import contextlib, types
import numpy as np
class Tensor:
    def __init__(self, values): self.values = np.asarray(values)
    def __getitem__(self, key): return Tensor(self.values[key])
    def __len__(self): return len(self.values)
    def __truediv__(self, by): return Tensor(self.values / by)
    shape = property(lambda self: self.values.shape)
    def reshape(self, *shape): return Tensor(self.values.reshape(shape))
    def permute(self, *axes): return Tensor(self.values.transpose(axes))
    def float(self): return Tensor(self.values.astype(np.float32))
    def detach(self): return self
    def cpu(self): return self
    def numpy(self): return self.values
def as_tensor(values, device=None): return values if isinstance(values, Tensor) else Tensor(values)
def zeros(shape, device=None): return Tensor(np.zeros(shape, np.float32))
cuda = types.SimpleNamespace(is_available=lambda: False)
no_grad = contextlib.nullcontext
"""
MODELS = """
import types
import numpy as np
from torch import Tensor
N = 120
class Rig:
    skinning_weight = Tensor(np.eye(55)[np.arange(N) % 55])
    shape_dirs = Tensor(np.zeros((N, 3, 10)))
    is_constrain_body = Tensor(np.zeros(N, bool))
    smplx_layer = types.SimpleNamespace(parents=Tensor(np.array(PARENTS)))
    def get_zero_pose_human(self, shape_param, device, face_offset, joint_offset):
        assert shape_param.shape == (1, 10)
        return Tensor(np.random.default_rng(1).normal(0, 0.3, (1, 55, 3)))
class Model:
    renderer = types.SimpleNamespace(smplx_model=Rig())
    to = lambda self, device: self
    float = eval = lambda self: self
    def infer_single_view(self, image, head, c2ws, intrs, render_c2ws, render_intrs, render_bg_colors, smplx_params):
        assert image.shape == (1, 1, 3, 1694, 1022) and head.shape == (1, 1, 3, 112, 112)
        solid = image.values[0, 0].mean(axis=0) < 0.99
        assert 0.85 < solid.any(axis=1).mean() < 0.95 and not solid[:20].any()  # whole, before white, room about
        assert smplx_params["body_pose"].shape == (1, 1, 21, 3) and smplx_params["betas"].shape == (1, 10)
        rng = np.random.default_rng(0)
        made = types.SimpleNamespace(
            offset_xyz=Tensor(np.zeros((N, 3))), opacity=Tensor(np.ones((N, 1))), scaling=Tensor(np.full((N, 3), 0.01)),
            rotation=Tensor(np.tile([1.0, 0, 0, 0], (N, 1))), shs=Tensor(rng.random((N, 1, 3))))
        return [made], Tensor(rng.normal(0, 0.5, (1, N, 3))), Tensor(np.tile(np.eye(4), (1, 55, 1, 1)))
    @classmethod
    def from_pretrained(cls, path):
        assert path == "weights", path
        return cls()
model_dict = {"human_lrm_sapdino_bh_sd3_5": Model}
"""
ESTIMATOR = """
import types
class PoseEstimator:
    def __init__(self, folder, device): assert device == "cpu"
    def __call__(self, path): return types.SimpleNamespace(is_full_body=WHOLE, msg="no legs", beta=[0.0] * 10)
"""


def stand_ins(folder: Path, whole: bool = True, weights: str = "weights") -> Lhm:
    """A folder with modules of the names that the script imports."""
    files = {
        "torch.py": TORCH,
        "LHM/models/__init__.py": MODELS.replace("PARENTS", repr([int(parent) for parent in PARENTS])),
        "LHM/utils/hf_hub.py": "wrap_model_hub = lambda model: model",
        "LHM/utils/model_card.py": f"MODEL_PATH = {{'LHM-500M': {weights!r}}}",
        "engine/pose_estimation/pose_estimator.py": ESTIMATOR.replace("WHOLE", str(whole)),
        "weights/config.json": "{}",
    }
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return Lhm(folder, Path(sys.executable))


def test_the_script_runs_with_stand_ins(tmp_path) -> None:
    avatar = run(stand_ins(tmp_path))
    assert len(avatar.splats) == 120 and avatar.splats.finite().all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"whole": False}, "LHM finds no whole body: no legs"),
        ({"weights": "elsewhere"}, "the weights of LHM-500M are not in elsewhere"),
    ],
)
def test_the_script_reports_missing_parts(tmp_path, changes, message) -> None:
    with pytest.raises(GlsplatError, match=f"exit code 1.: {message}"):
        run(stand_ins(tmp_path, **changes))
