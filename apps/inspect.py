"""``glsplat inspect``: describe the content of a file, and anything unusual in it."""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar, splats_of
from glsplat.data import embedded_file
from glsplat.extras.consent.file import OnFile, on_file
from glsplat.formats import recognise
from glsplat.formats.scene_file import SceneFile
from glsplat.io.files import printable
from glsplat.meshes import RiggedMesh
from glsplat.scene import is_rigged
from glsplat.skinning.driven import why_not_driven, why_not_tracked
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import Level, Splats
from glsplat.views import box_of

from .args import add_scene, open_scene, single
from .avatar import consent

HELP = "Describe a scene, avatar, mesh or scene file: counts, ranges, the rig, items, and anything unusual."
EXAMPLE = "glsplat inspect me.glb --json"

_PICTURE_PX = 1024  # with 90 degrees, so that the focal length is half of it
_NEEDLE = 1e3  # ratio of longest to shortest axis
_OUTLIER = 10  # times the distance from the median that holds 95 % of the splats
_PERCENTILES = (0, 1, 50, 99, 100)
_UNUSUAL = {
    "not_finite": "NaN or infinity in some attribute; never drawn",
    "zero_quaternions": "quaternion of length zero",
    "negative_scales": "negative scale; drawn as its magnitude",
    "zero_scales": "scale of zero; flat or a point",
    "needles": f"longest axis more than {_NEEDLE:g} times the shortest",
    "opacities_outside": "opacity below 0 or above 1",
    "invisible": "opacity below 1/255; never drawn",
    "outliers": f"farther out than {_OUTLIER} times 95 % of the others",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_scene(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print the description. Raises FormatError for an unreadable file."""
    file, name = open_scene(args), None if args.scene is None else str(embedded_file(args.scene))
    scene = None if file.composed else single(file)
    if args.up != "y" and scene is None and len(file.scene) == 1 and not file.composed:
        scene = file.scene.items[0].content  # --up does not change what a rig is
    if isinstance(scene, (Splats, Avatar)):
        report = describe(scene, name)
        print(json.dumps(report, indent=1) if args.json else _text(report))
        return 0
    whole = describe_scene(file, name or "")  # the embedded avatar is no scene file
    text = _mesh_text if whole["kind"] == "mesh" else _scene_text
    print(json.dumps(whole, indent=1) if args.json else text(whole))
    return 0


def describe_scene(file: SceneFile, path: str) -> dict[str, Any]:
    """Return the items of a scene file, or a mesh, as JSON values. Items of one file share their memory."""
    items = []
    files = {id(item): path for item, path in file.sources}
    for index, item in enumerate(file.scene):
        content, box = item.content, box_of(item)
        entry: dict[str, Any] = {"name": item.name, "kind": type(content).__name__.lower(), "visible": item.visible}
        entry["translation"] = item.transform[:3, 3].tolist()
        entry["scale"] = float(np.cbrt(np.linalg.det(item.transform[:3, :3])))
        entry["bounds"] = None if box is None else {"min": box[0].tolist(), "max": box[1].tolist()}  # of 98 %
        if isinstance(content, RiggedMesh):
            entry |= {"kind": "mesh", "triangles": len(content.faces), "parts": len(content.parts)}
            entry["textures"] = [[part.name, part.texture.shape[1], part.texture.shape[0]] for part in content.parts]
            entry["meta"] = dict(content.meta)
        else:
            entry["splats"] = len(splats_of(content))
            entry["levels"] = len(content.levels)
        if not isinstance(content, Splats):
            motion = next((motion for other, motion in file.motions.values() if other is item), None)
            entry |= {"joints": len(content.skeleton), "posed": item.pose is not None}
            entry["driven"] = item is file.avatar  # it takes the poses of options and clients
            entry["consent"] = consent.report(on_file(files[id(item)])) if is_rigged(content) else None
            entry["motion"] = None if motion is None else {"name": motion.label, "seconds": motion.duration}
        items.append(entry | {"item": index})
    different = {id(item.content): item.content for item in file.scene}.values()
    return {
        "file": path,
        "kind": "scene" if file.composed else "mesh",
        "file_bytes": Path(path).stat().st_size,
        "up": file.up,
        "background": list(file.background),
        "duration": file.duration,
        "splats": sum(entry.get("splats", 0) for entry in items),
        "memory_bytes": sum(splats_of(c).nbytes for c in different if not isinstance(c, RiggedMesh)),
        "items": items,
    }


def _scene_text(report: dict[str, Any]) -> str:
    lines = [f"{report['file']}: {report['kind']}, {len(report['items'])} items, {report['splats']:,} splats"]
    lines.append(f"  {'up':12} {report['up']}")
    lines.append(f"  {'background':12} {', '.join(f'{v:g}' for v in report['background'])}")
    if report["duration"]:
        lines.append(f"  {'motions':12} {report['duration']:.2f} s")
    for entry in report["items"]:
        what = f"{entry['splats']:,} splats" if "splats" in entry else f"{entry['triangles']:,} triangles"
        at = ", ".join(f"{v:.4g}" for v in entry["translation"])
        words = [entry["kind"], what, f"at {at}"]
        words += [f"scale {entry['scale']:.4g}"] if abs(entry["scale"] - 1) > 1e-9 else []
        words += [f"{entry['levels']} coarser levels"] if entry.get("levels") else []
        words += [f"{entry['joints']} joints"] if "joints" in entry else []
        words += [consent.short_text(entry["consent"])] if entry.get("consent") else []
        words += ["takes poses"] if entry.get("driven") else []
        words += [f"moves by {entry['motion']['name']}"] if entry.get("motion") else []
        words += [] if entry["visible"] else ["hidden"]
        lines.append(f"  {entry['item']:<4} {entry['name'] or '-'}: " + ", ".join(words))
    return "\n".join(map(printable, lines))


def _mesh_text(report: dict[str, Any]) -> str:
    """Return the description of a file that is one mesh, as text."""
    entry = report["items"][0]
    lines = [
        f"{report['file']}: mesh, {entry['triangles']:,} triangles, {entry['parts']} parts, {entry['joints']} joints"
    ]
    rows = [("size", f"{report['file_bytes'] / 1e6:.2f} MB on disk")]
    rows.append(("textures", ", ".join(f"{name} {wide} x {high}" for name, wide, high in entry["textures"])))
    if bounds := entry["bounds"]:
        rows.append(("bounds", _bounds_text(bounds)))
    rows += _notes(entry["meta"], entry["consent"])
    return _wrapped(lines, rows)


def _wrapped(lines: list[str], rows: list[tuple[str, str]]) -> str:
    for key, text in rows:
        # a file's control characters must not reach the terminal
        lines += textwrap.wrap(printable(f"  {key:12} {text}"), 110, subsequent_indent=" " * 15)
    return "\n".join(lines)


def _bounds_text(bounds: dict[str, list[float]]) -> str:
    axes = (
        f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in zip("xyz", bounds["min"], bounds["max"], strict=True)
    )
    return ", ".join(axes) + " m"


def describe(scene: Splats | Avatar, path: str | Path | None) -> dict[str, Any]:
    """Return the description of splats or an avatar as JSON values; ``path`` None is the embedded avatar."""
    splats = splats_of(scene)
    report: dict[str, Any] = {
        "file": None if path is None else str(path),
        "format": "glb" if path is None else recognise(path),
        "kind": "avatar" if isinstance(scene, Avatar) else "splats",
        "splats": len(splats),
        "sh_degree": splats.sh_degree,
        "file_bytes": None if path is None else Path(path).stat().st_size,
        "memory_bytes": splats.nbytes,
        "antialias": splats.antialias,
        "cones": splats.cones is not None,
        "cones_psnr": splats.cones_psnr,
        "colour": _COLOURS[None if splats.surface is None else splats.surface.shade is not None],
        "levels": levels_of(scene),
        "bounds": _bounds(splats.means),
        "scale": _percentiles(np.abs(splats.scales).max(axis=1)),
        "opacity": _percentiles(splats.opacities),
        "unusual": {name: count for name, count in _unusual(splats).items() if count},
    }
    if isinstance(scene, Avatar):
        report["avatar"] = _rig(scene)
        report["consent"] = consent.report(OnFile(nobody=True) if path is None else on_file(path))
        report["memory_bytes"] += scene.skin.joints.nbytes + scene.skin.weights.nbytes
        report["memory_bytes"] += scene.shapes.nbytes if scene.shapes is not None else 0
    report["memory_bytes"] += sum(level["memory_bytes"] for level in report["levels"])
    return report


def levels_of(scene: Splats | Avatar) -> list[dict[str, Any]]:
    """Return the coarser levels of detail as JSON values."""
    out = []
    level: Level[Any]
    for level in scene.levels:
        content = level.content
        rig = (content.skin.joints, content.skin.weights) if isinstance(content, Avatar) else ()
        out.append(
            {
                "splats": len(splats_of(content)),
                "density": level.density,  # pixels per metre
                "metres": _PICTURE_PX / 2 / level.density,  # least distance, in a picture of 1024 pixels and 90 degrees
                "psnr": level.psnr,
                "memory_bytes": splats_of(content).nbytes + sum(array.nbytes for array in rig),
            }
        )
    return out


def levels_text(levels: list[dict[str, Any]]) -> list[str]:
    """Return a line of text for each of ``levels_of``."""
    lines = []
    for one in levels:
        kept = "error unknown" if one["psnr"] is None else f"{one['psnr']:.1f} dB at worst"
        where = f"from {one['metres']:.2g} m on at {_PICTURE_PX} px and 90 degrees ({one['density']:.4g} px/m)"
        lines.append(f"{one['splats']:,} splats {where}, {kept}, {one['memory_bytes'] / 1e6:.2f} MB")
    return lines


def _rig(avatar: Avatar) -> dict[str, Any]:
    skeleton, skin = avatar.skeleton, avatar.skin
    strongest = np.bincount(strongest_joint(skin.joints, skin.weights), minlength=len(skeleton))
    with np.errstate(all="ignore"):
        offset = np.nan_to_num(skeleton.rest @ skeleton.inverse_bind - np.eye(4))
    return {
        "joints": len(skeleton),
        "roots": [name for name, parent in zip(skeleton.names, skeleton.parents, strict=True) if parent < 0],
        "influences": skin.influences,
        "weight_lost": skin.lost,
        "weights_repaired": skin.repaired,
        "not_driven": why_not_driven(skeleton),  # "": motions can
        "not_tracked": why_not_tracked(skeleton),  # "": headsets can
        "rest_offset": float(np.abs(offset).max()),  # 0: splats are stored in the zero pose
        "shapes": _shapes(avatar),
        "splats_per_joint": {name: int(n) for name, n in zip(skeleton.names, strongest, strict=True) if n},
        "meta": dict(avatar.meta),
    }


def _shapes(avatar: Avatar) -> dict[str, Any] | None:
    """Return the facial expressions as JSON values; None without any."""
    shapes = avatar.shapes
    if shapes is None:
        return None
    farthest = np.zeros(len(shapes))
    np.maximum.at(farthest, shapes.targets, np.linalg.norm(shapes.metres, axis=1))
    return {
        "names": list(shapes.names),
        "arkit": len(set(shapes.names) & set(ARKIT)),
        "entries": len(shapes.targets),
        "splats": int((np.diff(shapes.starts) > 0).sum()),  # moved by any shape
        "farthest": {name: float(metres) for name, metres in zip(shapes.names, farthest, strict=True)},
        "limits": shapes.limits.tolist(),
        "levels": sum(level.content.shapes is not None for level in avatar.levels),  # with shapes of their own
    }


def _bounds(means: NDArray[np.float32]) -> dict[str, list[float]] | None:
    usable = means[np.isfinite(means).all(axis=1)]
    return {"min": usable.min(axis=0).tolist(), "max": usable.max(axis=0).tolist()} if len(usable) else None


def _percentiles(values: NDArray[np.float32]) -> dict[str, float] | None:
    usable = values[np.isfinite(values)].astype(np.float64)
    if not len(usable):
        return None
    return {f"p{p}": float(value) for p, value in zip(_PERCENTILES, np.percentile(usable, _PERCENTILES), strict=True)}


def _unusual(splats: Splats) -> dict[str, int]:
    """Return the number of unusual splats by kind; a splat may count in several."""
    size = np.abs(splats.scales)
    longest, shortest = size.max(axis=1), size.min(axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        found = {
            "not_finite": ~splats.finite(),
            "zero_quaternions": ~splats.quats.any(axis=1),
            "negative_scales": (splats.scales < 0).any(axis=1),
            "zero_scales": shortest == 0,
            "needles": (shortest > 0) & np.isfinite(longest) & (longest > _NEEDLE * shortest),
            "opacities_outside": (splats.opacities < 0) | (splats.opacities > 1),
            "invisible": splats.opacities < 1 / 255,
            "outliers": _outliers(splats.means),
        }
    return {name: int(mask.sum()) for name, mask in found.items()}


def _outliers(means: NDArray[np.float32]) -> NDArray[np.bool_]:
    finite: NDArray[np.bool_] = np.all(np.isfinite(means), axis=1)
    if not finite.any():
        return finite
    usable = means[finite].astype(np.float64)
    distance = np.linalg.norm(usable - np.median(usable, axis=0), axis=1)
    out = np.zeros_like(finite)
    out[finite] = distance > max(_OUTLIER * float(np.percentile(distance, 95)), 1e-6)
    return out


def _notes(meta: dict[str, Any], agreed: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Return rows of a file's metadata, and of the verified consent record, as a text alone is not signed."""
    rows = []
    for key, value in meta.items():
        if key == "unseen" and isinstance(value, (int, float)) and 0 <= value <= 1:
            rows.append((key, f"{value:.0%} of the surface was in no photograph and is guessed"))
        elif key != "consent" or isinstance(value, str):
            rows.append((key, value if isinstance(value, str) else json.dumps(value)))
    return rows if agreed is None else [*rows, ("signed", consent.full_text(agreed))]


_COLOURS = {None: "baked", False: "albedo", True: "shaded"}
_LIT = {
    "baked": "never lit: nothing is known of the surface (docs/light.md)",
    "albedo": "lit by --light, colours are albedo",
    "shaded": "lit by --light, without one as photographed",
}


def _text(report: dict[str, Any]) -> str:
    name = report["file"] or "the default avatar"
    lines = [
        f"{name}: {report['kind']}, {report['format']}, {report['splats']:,} splats, SH degree {report['sh_degree']}"
    ]
    size = "" if report["file_bytes"] is None else f"{report['file_bytes'] / 1e6:.2f} MB on disk, "
    rows = [("size", f"{size}{report['memory_bytes'] / 1e6:.2f} MB in memory")]
    rows.append(("antialias", "opacity compensation wanted" if report["antialias"] else "not asked for"))
    cones = "every splat has one" if report["cones"] else "none; --cull-hidden needs them (glsplat avatar cones)"
    if report["cones_psnr"] is not None:
        cones += f"; the worst picture keeps {report['cones_psnr']:.1f} dB without what they hide"
    rows.append(("cones", cones))
    rows.append(("light", _LIT[report["colour"]]))
    rows += [("" if index else "levels", line) for index, line in enumerate(levels_text(report["levels"]))]
    if bounds := report["bounds"]:
        rows.append(("bounds", _bounds_text(bounds)))
    for key, unit in (("scale", " m (longest axis)"), ("opacity", "")):
        if values := report[key]:
            rows.append((key, ", ".join(f"{p} {value:.4g}" for p, value in values.items()) + unit))
    if rig := report.get("avatar"):
        rows.append(
            ("rig", f"{rig['joints']} joints, roots {', '.join(rig['roots'])}; {rig['influences']} influences a splat")
        )
        rows.append(
            ("weights", f"{rig['weight_lost']:.3g} lost by truncation, {rig['weights_repaired']} splats repaired")
        )
        if shapes := rig["shapes"]:
            names = ", ".join([*shapes["names"][:4], "..."] if len(shapes["names"]) > 4 else shapes["names"])
            said = f"{len(shapes['names'])} ({names}), {shapes['arkit']} of ARKit's 52"
            said += f"; they move {shapes['splats']} splats"
            if still := len(report["levels"]) - shapes["levels"]:
                said += f"; {still} coarser level{'s keep' if still > 1 else ' keeps'} a still face"
            rows.append(("shapes", said))
        rows.append(("driven", _driven(rig["not_driven"], rig["not_tracked"])))
        if rig["rest_offset"] > 1e-4:
            rows.append(("rest", f"inverse bind matrices are {rig['rest_offset']:.3g} off the rest pose"))
        parts = ", ".join(f"{joint} {count}" for joint, count in rig["splats_per_joint"].items())
        rows.append(("parts", parts or "none"))
        rows += _notes({"consent": "not stated"} | rig["meta"], report["consent"])
    unusual = [f"{count:,} {name}: {_UNUSUAL[name]}" for name, count in report["unusual"].items()]
    rows += [("unusual", text) for text in unusual] or [("unusual", "nothing")]
    return _wrapped(lines, rows)


def _driven(not_driven: str, not_tracked: str) -> str:
    if not_driven:
        return f"by no motion: {not_driven}"
    return f"by motions, by no headset: {not_tracked}" if not_tracked else "by motions and headsets"
