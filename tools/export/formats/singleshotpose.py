"""singleshotpose, ObjectDatasetTools: ``LINEMOD/OBJ/{JPEGImages,labels,mask,depth,transforms}``, one folder a class.

A row of a label has 21 numbers: class (0), the centre and the eight corners as shares of the picture (x slowest, z
fastest, as ObjectDatasetTools orders them), and the cuboid's width and height. Models and transforms are in metres.
Pictures are undistorted. File names have no leading zeros: singleshotpose strips ``/00`` on its way to the mask.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

import numpy as np

from common.geometry import Box
from tools.export.formats.bop import hash_of
from tools.export.formats.parts import Array, json_text, number, picture_file, pixels_of, read_text, shares
from tools.export.masks import covering, visible_mask
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file
from tools.export.pictures import png
from tools.export.solid import diameter, ply

_LABELS = "labels"
_NUMBERS = 21
ORDER = tuple(int(i) for i in np.lexsort(Box("", "", (1.0, 1.0, 1.0), ()).corners.T[::-1]))
"""Corner indices by x, then y, then z."""


class SingleShotPose:
    """singleshotpose and what follows it."""

    traits: ClassVar[Traits] = Traits(default_classes="type", whole=True, undistorted=True)

    def shot(self, shot: Shot, export: Export) -> Written:
        """Picture, label, mask, depth and transform in the folder of each class."""
        files: list[OutFile] = []
        before = covering(shot)
        for name, own_folder in folders(export.classes).items():
            root, stem = f"LINEMOD/{own_folder}", str(shot.number + 1)
            own = [(target, before[i]) for i, target in enumerate(shot.targets) if target.class_name == name]
            files.append(picture_file(shot, f"{root}/JPEGImages/{stem}.{shot.change.extension}"))
            files.append(text_file(f"{root}/{_LABELS}/{stem}.txt", "".join(f"{_row(one, shot)}\n" for one, _ in own)))
            mask = np.zeros((shot.camera.height, shot.camera.width), dtype=bool)
            for target, others in own:
                mask |= visible_mask(shot, target, others)
            files.append(_bytes(f"{root}/mask/{stem}.png", png(np.where(mask, np.uint8(255), np.uint8(0)))))
            transform = own[0][0].pose.matrix if own else np.eye(4)
            transform[:3, 3] /= 1000
            out = io.BytesIO()
            np.save(out, transform)
            files.append(_bytes(f"{root}/transforms/{stem}.npy", out.getvalue()))
            files += _depth(shot, f"{root}/depth/{stem}.png")
        return Written(tuple(files))

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """Lists, intrinsics and a model for each class."""
        files: list[OutFile] = []
        boxes = {target.class_name: target.box for shot in export.shots for target in shot.targets}
        k, first = export.shots[0].camera.matrix, export.shots[0]
        unit = 1.0 if first.source.label.depth is None else first.source.label.depth.unit_mm
        intrinsics = {"fx": k[0, 0], "fy": k[1, 1], "ppx": k[0, 2], "ppy": k[1, 2], "depth_scale": unit / 1000}
        plain = {key: float(value) for key, value in intrinsics.items()}
        sizes = {"width": first.camera.width, "height": first.camera.height}
        for name, own_folder in folders(export.classes).items():
            root = f"LINEMOD/{own_folder}"
            files.append(text_file(f"{root}/intrinsics.json", json_text(plain | sizes)))
            for part in export.splits:
                lines = [f"{root}/JPEGImages/{shot.number + 1}.{shot.change.extension}\n" for shot in export.of(part)]
                files.append(text_file(f"{root}/{part}.txt", "".join(lines)))
            if name in boxes:
                files.append(text_file(f"{root}/{own_folder}.ply", ply(boxes[name], scale=0.001)))
                files.append(text_file(f"cfg/{own_folder}.data", _data(own_folder, boxes[name], export)))
        return files

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """From the label files of all classes."""
        for shot in export.shots:
            rows: dict[str, list[ReadTarget]] = {}
            for name, own_folder in folders(export.classes).items():
                path = folder / "LINEMOD" / own_folder / _LABELS / f"{shot.number + 1}.txt"
                rows[name] = [_read_row(name, line, shot) for line in read_text(path).splitlines()]
            order = [rows[target.class_name].pop(0) for target in shot.targets if rows[target.class_name]]
            yield shot, [*order, *(row for rest in rows.values() for row in rest)]

    def notes(self, export: Export) -> list[str]:
        """What the format can't hold."""
        notes = []
        if any(
            len([t for t in shot.targets if t.class_name == n]) > 1 for shot in export.shots for n in export.classes
        ):
            notes.append("two objects of one class in a picture: transforms/ has the first one's pose only")
        if len({shot.camera.matrix.tobytes() for shot in export.shots}) > 1:
            notes.append("intrinsics.json has the first camera's intrinsics; export cameras apart (--camera)")
        if "val" in export.splits and "test" not in export.splits:
            notes.append("singleshotpose validates on what cfg/*.data calls valid: here val.txt")
        return notes


def folders(classes: Sequence[str]) -> dict[str, str]:
    """The folder of each class; where two would have the same, the later one has a number behind it."""
    found: dict[str, str] = {}
    for name in classes:
        plain, number = _folder_name(name), 2
        while plain in found.values():
            plain, number = f"{_folder_name(name)}-{number}", number + 1
        found[name] = plain
    return found


def _folder_name(name: str) -> str:
    """A class as the name of a folder; never one that leads out of its place, as ``..`` does."""
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)
    return plain if plain.strip(".") else "_" * max(len(plain), 1)


def _row(target: Target, shot: Shot) -> str:
    centre = shot.camera.project(target.pose.translation)[0]
    points = shares(np.vstack([centre, target.corners[list(ORDER)]]), shot)
    extent = np.ptp(points, axis=0)
    return " ".join(["0", *(number(float(value)) for value in (*points.ravel(), *extent))])


def _read_row(name: str, line: str, shot: Shot) -> ReadTarget:
    numbers = np.array(line.split(), dtype=np.float64)
    if len(numbers) != _NUMBERS:
        return ReadTarget(f"{name}: {len(numbers)} numbers instead of {_NUMBERS}")
    points = np.full((len(ORDER), 2), np.nan)
    points[list(ORDER)] = pixels_of(numbers[3:19].reshape(-1, 2), shot)
    return ReadTarget(name, points=points)


def _depth(shot: Shot, path: str) -> list[OutFile]:
    files = shot.source.label.files
    if files is None or files.depth is None:
        return []
    change, stored = shot.change, shot.source.folder / files.depth.path
    key = f"{files.depth.sha256}:{change.key}"
    return [OutFile(PurePosixPath(path), key, make=lambda: png(change.depth(stored)), size=files.depth.size)]


def _bytes(path: str, data: bytes) -> OutFile:
    return OutFile(PurePosixPath(path), hash_of(data), data=data, size=len(data))


def _data(folder: str, box: Box, export: Export) -> str:
    root = f"LINEMOD/{folder}"
    valid = next((part for part in ("val", "test") if part in export.splits), "train")
    lines = {
        "train": f"{root}/train.txt",
        "valid": f"{root}/{valid}.txt",
        "backup": f"backup/{folder}",
        "mesh": f"{root}/{folder}.ply",
        "name": folder,
        "diam": f"{diameter(box) / 1000:.6f}",
    }
    return "".join(f"{key} = {value}\n" for key, value in lines.items())


def corner_signs() -> Array:
    """The corners (8, 3) in this format's order, as signs."""
    return np.sign(Box("", "", (1.0, 1.0, 1.0), ()).corners[list(ORDER)])
