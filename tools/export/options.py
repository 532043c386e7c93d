"""What was asked for on the command line, checked."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from common.errors import RefusedError

SplitBy = Literal["auto", "session", "block", "camera", "none"]
BAD_VALUE = "out_of_bounds"


@dataclass(frozen=True)
class Filters:
    """Which samples; None: doesn't matter. A sample is left out if one of its objects is beyond a limit."""

    cameras: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    max_uncertainty_px: float | None = None
    max_reprojection_px: float | None = None
    max_angle_deg: float | None = None
    min_inside: float | None = None
    max_blur: float | None = None
    min_distance_mm: float | None = None
    max_distance_mm: float | None = None
    ambiguous: bool = False
    incomplete: bool = False
    background: bool = True


@dataclass(frozen=True)
class SplitWish:
    """How to part the samples: by what, which shares go to val and test, from which seed."""

    by: SplitBy = "auto"
    val: float = 0.2
    test: float = 0.0
    seed: int = 1


@dataclass(frozen=True)
class PictureWish:
    """The pictures: None keeps the stored size or format."""

    size: tuple[int, int] | None = None
    letterbox: bool = False
    extension: str | None = None
    quality: int = 95
    copy: bool = False


@dataclass(frozen=True)
class Options:
    """All of it."""

    classes: str | None
    all_sides: bool
    filters: Filters
    split: SplitWish
    pictures: PictureWish


def add_options(parser: argparse.ArgumentParser) -> None:
    """All that says what is exported."""
    what = parser.add_argument_group("what becomes a class")
    what.add_argument(
        "--classes", metavar="side|type|FILE", help="side, type, or a YAML file that maps names (default: the format's)"
    )
    what.add_argument("--all-sides", action="store_true", help="each visible side is a target of its own")
    which = parser.add_argument_group("which samples")
    which.add_argument("--camera", action="append", default=[], metavar="NAME", help="only of this camera (repeatable)")
    which.add_argument("--object", action="append", default=[], metavar="NAME", help="only this object (repeatable)")
    limits = {
        "max-uncertainty-px": "corners in the picture known this well (one sigma)",
        "max-reprojection-px": "reprojection error up to this",
        "max-angle-deg": "the side that faces the camera most is seen at up to this angle",
        "min-inside": "at least this share (0..1) of the window is inside of the picture",
        "max-blur": "blur (0 sharp, 1 blurred) within the windows up to this; looks at every picture",
        "min-distance-mm": "objects at least so far away",
        "max-distance-mm": "objects at most so far away",
    }
    for name, words in limits.items():
        which.add_argument(f"--{name}", type=float, help=words)
    which.add_argument("--ambiguous", action="store_true", help="also samples with an ambiguous pose")
    which.add_argument("--incomplete", action="store_true", help="also samples in which an object has no pose")
    which.add_argument("--no-background", action="store_true", help="without pictures that show no object")
    split = parser.add_argument_group("training and validation")
    split.add_argument(
        "--split",
        choices=("auto", "session", "block", "camera", "none"),
        default="auto",
        help="by session, time block or camera (auto: session if there are three or more, else block)",
    )
    split.add_argument("--val", type=float, default=0.2, help="share of the validation set (0.2)")
    split.add_argument("--test", type=float, default=0.0, help="share of the test set (0)")
    split.add_argument("--seed", type=int, default=1, help="the same seed gives the same split (1)")
    pictures = parser.add_argument_group("pictures")
    pictures.add_argument("--size", metavar="WxH", help="resize to this (default: as stored)")
    pictures.add_argument("--letterbox", action="store_true", help="with --size: keep the shape, pad with grey")
    pictures.add_argument("--pictures", choices=("png", "jpg"), help="encode anew (default: as stored)")
    pictures.add_argument("--quality", type=int, default=95, help="of JPEG, 1..100 (95)")
    pictures.add_argument("--copy", action="store_true", help="copy unchanged pictures instead of linking them")


def options_of(args: argparse.Namespace) -> Options:
    """The checked options; raises RefusedError with a sentence for what can't be."""
    wish = SplitWish(args.split, args.val, args.test, args.seed)
    if not (0 <= wish.val < 1 and 0 <= wish.test < 1 and wish.val + wish.test < 1):
        raise RefusedError("--val and --test are shares from 0 up, together below 1", code=BAD_VALUE)
    if not 1 <= args.quality <= 100:
        raise RefusedError("--quality is 1 to 100", code=BAD_VALUE)
    if args.letterbox and args.size is None:
        raise RefusedError("--letterbox needs --size WxH", code=BAD_VALUE)
    return Options(
        classes=args.classes,
        all_sides=args.all_sides,
        filters=Filters(
            cameras=tuple(args.camera),
            objects=tuple(args.object),
            max_uncertainty_px=args.max_uncertainty_px,
            max_reprojection_px=args.max_reprojection_px,
            max_angle_deg=args.max_angle_deg,
            min_inside=args.min_inside,
            max_blur=args.max_blur,
            min_distance_mm=args.min_distance_mm,
            max_distance_mm=args.max_distance_mm,
            ambiguous=args.ambiguous,
            incomplete=args.incomplete,
            background=not args.no_background,
        ),
        split=wish,
        pictures=PictureWish(_size(args.size), args.letterbox, args.pictures, args.quality, args.copy),
    )


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and 10 <= int(width) <= 16384 and 10 <= int(height) <= 16384):
        raise RefusedError(f"--size '{text}' is no size such as 640x480 (10 to 16384 px a side)", code=BAD_VALUE)
    return int(width), int(height)


def folder_of(text: Path) -> Path:
    """A path as typed, absolute, without following links."""
    return Path(text).expanduser().absolute()
