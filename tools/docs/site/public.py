"""Read the public names of glsplat from its source, without imports, so that a site builds without OpenGL."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def public_modules() -> Iterator[tuple[str, Path]]:
    """Yield (name, file) of each package and each module directly in glsplat/ that has an ``__all__``."""
    for path in sorted((ROOT / "glsplat").rglob("*.py")):
        inner = path.relative_to(ROOT).with_suffix("").parts
        if path.name != "__init__.py" and len(inner) > 2:
            continue
        if listed(path):
            yield ".".join(inner[:-1] if path.name == "__init__.py" else inner), path


def listed(path: Path) -> list[str]:
    """Return the names of a file's stub or ``__all__``; [] if it has neither."""
    if (stub := path.with_suffix(".pyi")).exists():
        body = ast.parse(stub.read_text(encoding="utf-8")).body
        return sorted(alias.name for node in body if isinstance(node, ast.ImportFrom) for alias in node.names)
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def homes(module: str, path: Path) -> dict[str, str]:
    """Return the definition of each public name of a module: ``{"Avatar": "glsplat.avatar.Avatar"}``."""
    source = stub if (stub := path.with_suffix(".pyi")).exists() else path
    tree = ast.parse(source.read_text(encoding="utf-8"))
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            base = module.split(".")[: len(module.split(".")) - node.level + (path.name == "__init__.py")]
            start = ".".join([*base, node.module]) if node.level else node.module
            found |= {alias.asname or alias.name: f"{start}.{alias.name}" for alias in node.names}
    return {name: found.get(name, f"{module}.{name}") for name in listed(path)}


def api_page(module: str, path: Path, elsewhere: dict[str, str]) -> str:
    """Return the page of one module for mkdocstrings: its docstring, then each name of its ``__all__``.

    Each name is explained on one page and linked from others: ``elsewhere`` has the page of each name, and this page's
    are added.
    """
    example = f"    import {module}\n" if module == "glsplat" else f"    from {module} import {listed(path)[0]}\n"
    lines = [f"# {module}", "", example, f"::: {module}", "    options:", "      members: []"]
    lines += ["      show_root_heading: false", "      show_root_toc_entry: false", ""]
    for name, home in homes(module, path).items():
        if home in elsewhere:
            lines += [f"`{name}` is explained with [{elsewhere[home]}]({elsewhere[home]}.md#{home}).", ""]
        else:
            lines += [f"::: {home}", ""]
            elsewhere[home] = module
    return "\n".join(lines)


def api_pages() -> dict[str, str]:
    """Return the API's pages by their address within the site, the index first."""
    modules = list(public_modules())
    rows = [f"| [`{name}`]({name}.md) | {summary(path)} |" for name, path in modules]
    index = [
        "# API reference",
        "",
        "    import glsplat",
        "    help(glsplat.Renderer)      # the same text",
        "",
        "Generated from the docstrings of the public names: those that `__all__` of the package, of a",
        "sub-package or of a module right in `glsplat` lists. [From Python](../python.md) explains them in",
        "order; [the gallery](../gallery.md) has programs to begin with. Array shapes stand in brackets,",
        "lengths are metres, angles radians; frames are those of [the contract](../conventions.md).",
        "",
        "| module | what it has |",
        "|---|---|",
        *rows,
    ]
    elsewhere: dict[str, str] = {}
    pages = {"api/index.md": "\n".join(index) + "\n"}
    return pages | {f"api/{name}.md": api_page(name, path, elsewhere) for name, path in modules}


def summary(path: Path) -> str:
    """Return the first paragraph of a module's docstring, escaped for a table."""
    said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return said.partition("\n\n")[0].replace("\n", " ").replace("``", "`").replace("|", "\\|")
