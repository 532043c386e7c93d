"""A third party's camera driver or export format, as its pip-installed package would leave it on the path."""

from __future__ import annotations

from pathlib import Path


def install(folder: Path, name: str, module: str, attribute: str, group: str = "tagmill.cameras") -> Path:
    """``module`` (source code) as ``name`` in an entry-point group; the folder to put on PYTHONPATH."""
    about = folder / f"{name}_package-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{name} = {name}_module:{attribute}\n")
    (folder / f"{name}_module.py").write_text(module)
    return folder
