"""Make new sessions of parts of one: by camera, by recording, or of samples that are named; it stays as it is."""

from __future__ import annotations

import argparse
from collections import defaultdict

from common.dataset.bin import no_sample
from common.dataset.derive import Taken
from common.dataset.snapshot import Snapshot
from common.errors import RefusedError
from common.ids import sample_camera
from tools.dataset.deriving import add_rig, beside, make, session_named, tell
from tools.dataset.moving import names_given

_NO_RECORDING = "single"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session, and what the parts are."""
    add_rig(parser)
    parser.add_argument("session", metavar="SESSION", help="a session's name below dataset.root, or its folder")
    parser.add_argument(
        "samples", nargs="*", metavar="SAMPLE", help="with --into: its samples; '-' reads names from stdin"
    )
    parser.add_argument("--into", metavar="NAME", help="a new session of the named samples")
    parser.add_argument("--rest", metavar="NAME", help="with --into: another one of all other samples")
    parser.add_argument("--by", choices=("camera", "recording"), help="a new session each, called SESSION-CAMERA, ...")


def run(args: argparse.Namespace) -> int:
    """Each part is made whole or not at all."""
    folder = session_named(args, args.session)
    source = Snapshot(folder)
    parts = _parts(args, folder.resolve().name, source)
    targets = [(beside(folder, name), samples) for name, samples in parts.items()]
    taken = next((target for target, _ in targets if target.exists()), None)
    if taken is not None:
        raise RefusedError(f"there is a session {taken.name} in {taken.parent} already", code="session_exists")
    return tell(args, [(target, make(target, [Taken(source, samples)])) for target, samples in targets])


def _parts(args: argparse.Namespace, name: str, reader: Snapshot) -> dict[str, tuple[str, ...]]:
    samples = reader.samples()
    if args.by is not None:
        if args.into or args.rest or args.samples:
            raise RefusedError("--by makes parts by itself: leave --into, --rest and samples out", code="refused")
        parts: dict[str, list[str]] = defaultdict(list)
        for sample in samples:
            recording = reader.known[sample] or _NO_RECORDING
            parts[sample_camera(sample) if args.by == "camera" else recording].append(sample)
        return {f"{name}-{part}": tuple(members) for part, members in sorted(parts.items())}
    if args.into is None:
        raise RefusedError("say --by camera, --by recording, or --into NAME with samples", code="refused")
    wanted = names_given(args.samples)
    unknown = [sample for sample in wanted if sample not in set(samples)]
    if unknown:
        raise no_sample(reader.folder, unknown)
    if not wanted:
        raise RefusedError("no sample was named; 'tagmill dataset list --names' has them", code="no_sample")
    chosen = set(wanted)
    found = {args.into: tuple(sorted(chosen))}
    if args.rest is not None:
        found[args.rest] = tuple(sample for sample in samples if sample not in chosen)
        if args.rest == args.into or not found[args.rest]:
            raise RefusedError("--rest would be empty, or is called like --into", code="refused")
    return found
