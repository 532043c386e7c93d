"""What becomes a class: sides, types, or what a mapping file says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from common.config.problems import Problems
from common.config.tree import read_tree
from common.errors import RefusedError
from common.geometry import Box

BAD_MAPPING = "bad_config"
_HOW = "it maps OBJECT, TYPE, SIDE, OBJECT/SIDE or TYPE/SIDE to a class name, or to null to leave it out"


@dataclass(frozen=True)
class Naming:
    """``names``: the classes in the order of their ids. ``by_side``: a target's class depends on its side."""

    names: tuple[str, ...]
    by_side: bool
    _table: Mapping[str, str | None] | None = None
    by_type: bool = False

    def class_of(self, box: Box, side: str | None) -> str | None:
        """The class of an object of which ``side`` faces the camera most; None: it is none."""
        if self._table is not None:
            keys = [] if side is None else [f"{box.name}/{side}", f"{box.type}/{side}"]
            keys += [box.name, box.type] + ([] if side is None else [side])
            return next((self._table[key] for key in keys if key in self._table), None)
        return one_line(box.type) if self.by_type else (None if side is None else one_line(side))


def naming(wish: str, boxes: Iterable[Box], *, all_sides: bool) -> Naming:
    """How classes are named; ``wish``: side, type or a file. Raises RefusedError for a file that can't be used."""
    boxes = list(boxes)
    if wish == "side":
        return Naming(_unique(one_line(side.class_name) for box in boxes for side in box.sides), by_side=True)
    if wish == "type":
        return Naming(_unique(one_line(box.type) for box in boxes), by_side=all_sides, by_type=True)
    table = _read(Path(wish))
    sides = {side.class_name for box in boxes for side in box.sides}
    by_side = any("/" in key or key in sides for key in table)
    known = {box.name for box in boxes} | {box.type for box in boxes} | sides
    known |= {f"{one}/{side.class_name}" for box in boxes for one in (box.name, box.type) for side in box.sides}
    strange = [key for key in table if key not in known]
    if strange:
        raise RefusedError(
            f"{wish}: the sessions have no '{strange[0]}'; they have {', '.join(sorted(known))}", code=BAD_MAPPING
        )
    names = _unique(name for name in table.values() if name is not None)
    if not names:
        raise RefusedError(f"{wish} leaves every class out", code=BAD_MAPPING)
    return Naming(names, by_side=by_side or all_sides, _table=table)


def one_line(name: str) -> str:
    """A class name that fits on a line of its own."""
    return " ".join(name.split())


def _read(path: Path) -> dict[str, str | None]:
    problems = Problems(path)
    tree = read_tree(path, problems, "class mapping")
    if problems.found:
        raise RefusedError(f"--classes is 'side', 'type' or a YAML file; {problems.lines()[0]}", code=BAD_MAPPING)
    plain = None if tree is None else tree.plain()
    if not isinstance(plain, dict) or not plain:
        raise RefusedError(f"{path} is no class mapping: {_HOW}", code=BAD_MAPPING)
    found: dict[str, str | None] = {}
    for key, name in plain.items():
        if not isinstance(name, str | None) or (isinstance(name, str) and not one_line(name)):
            raise RefusedError(f"{path}: {key}: {name!r} is no class name; {_HOW}", code=BAD_MAPPING)
        found[str(key)] = None if name is None else one_line(name)
    return found


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
