"""Make a session in which a class (a side's name, or with --type an object's type) is called otherwise.

The session it is made of stays as it is; pictures are linked.
"""

from __future__ import annotations

import argparse
from typing import Any

from common.dataset.derive import Taken
from common.dataset.snapshot import Snapshot
from common.errors import RefusedError
from common.labels import Label, ObjectLabel
from tools.dataset.deriving import add_rig, beside, make, session_named, tell

NO_CLASS = "no_class"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which class of which session."""
    add_rig(parser)
    parser.add_argument("session", metavar="SESSION", help="a session's name below dataset.root, or its folder")
    parser.add_argument("old", metavar="OLD", help="the class as it is called now")
    parser.add_argument("new", metavar="NEW", help="as it is to be called")
    parser.add_argument("--into", required=True, metavar="NAME", help="the new session's name, beside the other one")
    parser.add_argument("--object", metavar="NAME", help="only of this object")
    parser.add_argument("--type", action="store_true", help="OLD and NEW are objects' types, not sides")


def run(args: argparse.Namespace) -> int:
    """Labels and rig are renamed alike."""
    folder = session_named(args, args.session)
    source = Snapshot(folder)
    objects: dict[str, Any] = source.session.rig.get("objects") or {}
    wanted = _objects_with(args, objects)
    target = beside(folder, args.into)

    def relabel(label: Label) -> Label:
        renamed = tuple(_renamed(args, item) if item.name in wanted else item for item in label.objects)
        return label.model_copy(update={"objects": renamed})

    def describe(rig: dict[str, Any]) -> dict[str, Any]:
        known = rig.get("objects") or {}
        return {**rig, "objects": {name: _described(args, row, name in wanted) for name, row in known.items()}}

    return tell(args, [(target, make(target, [Taken(source)], relabel, describe))])


def _objects_with(args: argparse.Namespace, objects: dict[str, Any]) -> set[str]:
    """The objects that have the class; raises RefusedError if none has, or one has the new one already."""
    if not args.new.strip() or args.new == args.old:
        raise RefusedError("the new name must be another one, and not empty", code="bad_name")
    if args.object is not None and args.object not in objects:
        raise RefusedError(f"there is no object {args.object}; there are {', '.join(objects)}", code=NO_CLASS)
    asked = {name: row for name, row in objects.items() if args.object in (None, name)}
    classes = {name: [row.get("type")] if args.type else list(row.get("sides") or {}) for name, row in asked.items()}
    found = {name for name, names in classes.items() if args.old in names}
    if not found:
        there = ", ".join(sorted({str(one) for names in classes.values() for one in names}))
        raise RefusedError(
            f"no object has the {'type' if args.type else 'side'} {args.old}; there are {there}", code=NO_CLASS
        )
    twice = [] if args.type else [name for name in sorted(found) if args.new in classes[name]]
    if twice:
        raise RefusedError(
            f"{twice[0]} has a side {args.new} already; two sides can't have one name ('tagmill export --classes FILE' "
            "makes one class of several)",
            code="refused",
        )
    return found


def _renamed(args: argparse.Namespace, item: ObjectLabel) -> ObjectLabel:
    if args.type:
        return item.model_copy(update={"type": args.new})

    def named(parts: tuple[Any, ...]) -> tuple[Any, ...]:
        change = {"class_name": args.new}
        return tuple(part.model_copy(update=change) if part.class_name == args.old else part for part in parts)

    return item.model_copy(update={"sides": named(item.sides), "faces": named(item.faces)})


def _described(args: argparse.Namespace, row: dict[str, Any], wanted: bool) -> dict[str, Any]:
    if not wanted:
        return row
    if args.type:
        return {**row, "type": args.new}
    sides = row.get("sides") or {}
    return {**row, "sides": {args.new if name == args.old else name: side for name, side in sides.items()}}
