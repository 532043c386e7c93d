"""`make fuzz`: each target for a while, led by the code's coverage (atheris), in a process of its own.

A crash, a hang of 20 s or more than 2 GiB ends a target's run; the input is then in ``fuzz-findings/`` and
``python -m tests.fuzz.run --target NAME FILE`` runs it again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

FINDINGS = Path("fuzz-findings")
HANG_S, MOST_MB = 20, 2048


def main() -> int:
    """All targets, or one; exit code 1 if there was a finding."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.run", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="for each target (60)")
    parser.add_argument("--target", help="only this one")
    parser.add_argument("input", nargs="?", type=Path, help="only this file")
    args = parser.parse_args()
    if args.target is not None:
        return _one(args.target, args.seconds, args.input)
    from tests.fuzz.targets import TARGETS

    command = [sys.executable, "-m", "tests.fuzz.run", "--seconds", str(args.seconds), "--target"]
    bad = [one.name for one in TARGETS if _told(one.name, [*command, one.name], args.seconds)]
    print(f"findings in: {', '.join(bad)}; see {FINDINGS}/" if bad else f"{len(TARGETS)} targets, no finding")
    return 1 if bad else 0


def _told(name: str, command: list[str], seconds: int) -> int:
    """Run one target and print its last words."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=seconds * 2 + 120)
    except subprocess.TimeoutExpired:
        print(f"{name:12} did not end")
        return 1
    lines = [line for line in done.stderr.splitlines() if line.startswith("Done ")]
    print(f"{name:12} {lines[-1] if lines else done.stderr[-2000:]}", flush=True)
    return done.returncode


def _one(name: str, seconds: int, given: Path | None) -> int:
    import atheris

    with atheris.instrument_imports(include=["common", "services", "tools", "yaml"]):
        from tests.fuzz.targets import TARGETS

    target = next(one for one in TARGETS if one.name == name)
    FINDINGS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "work"
        corpus = Path(made) / "corpus"
        folder.mkdir()
        corpus.mkdir()
        if given is not None:
            target(folder, given.read_bytes())
            return 0
        for number, seed in enumerate(target.seeds):
            (corpus / str(number)).write_bytes(seed)
        words = Path(made) / "words"
        words.write_text("".join(_entry(word) for word in target.words))
        options = [
            f"-max_total_time={seconds}",
            f"-timeout={HANG_S}",
            f"-rss_limit_mb={MOST_MB}",
            "-max_len=8192",
            f"-dict={words}",
            f"-artifact_prefix={FINDINGS}/{name}-",
        ]
        atheris.Setup([sys.argv[0], *options, str(corpus)], lambda data: target(folder, data))
        atheris.Fuzz()
    return 0


def _entry(word: bytes) -> str:
    """A line of libFuzzer's dictionary."""
    escaped = "".join(f"\\x{byte:02x}" for byte in word[:60])
    return f'"{escaped}"\n'


if __name__ == "__main__":
    sys.exit(main())
