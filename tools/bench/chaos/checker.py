"""The independent judge of a chaos run: reads the client's log of answers and the disk, and nothing else.

It imports nothing of tagmill: JSON by ``json``, pictures by ``cv2``, its own idea of the formats. Start it by hand on
a run that was kept: ``python -m tools.bench.chaos.checker FOLDER``.

FOLDER holds ``answers.jsonl`` (the log), ``truth.json`` (what each frame must look like), ``disk/dataset`` (the session
and, as ``gone-N``, what was put aside where a fault deleted it) and ``shm`` (the shared memory, empty by now).
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tools.bench.chaos.check_ledgers import check_ledgers
from tools.bench.chaos.check_samples import Sample, check_folder
from tools.bench.chaos.check_traces import check_traces


@dataclass
class Verdict:
    """``violations``: one sentence each. ``counts``: what was looked at."""

    violations: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)


def check(folder: Path, session: str, prefix: str | None = None, run_dir: Path | None = None) -> Verdict:
    """Judge a run that is over. ``prefix`` and ``run_dir``: also look for what the stack should not have left."""
    entries = [json.loads(line) for line in (folder / "answers.jsonl").read_text().splitlines()]
    truth = json.loads((folder / "truth.json").read_text())
    root = folder / "disk" / "dataset"
    verdict = Verdict()
    verdict.violations += [
        f"not recovered: {entry['not_recovered']}" for entry in entries if entry.get("not_recovered")
    ]
    samples: dict[str, Sample] = {}
    for put_aside in sorted(root.glob("gone-*")):
        samples |= check_folder(put_aside, truth, verdict.violations, abandoned=True)
    kept = check_folder(root / session, truth, verdict.violations, abandoned=False)
    samples |= kept
    answers = [entry["answer"] for entry in entries if "answer" in entry]
    acknowledged = {name for answer in answers for name in answer.get("samples", ())}
    verdict.violations += [
        f"{name} was acknowledged and is not whole on the disk"
        for name in sorted(acknowledged)
        if name not in samples or not samples[name].whole
    ]
    verdict.violations += check_ledgers(root / session, kept, samples, entries)
    verdict.violations += check_traces(folder / "shm", prefix, run_dir)
    verdict.counts = _counts(entries, answers, acknowledged, samples)
    return verdict


def _counts(
    entries: list[dict[str, Any]], answers: list[dict[str, Any]], acknowledged: set[str], samples: dict[str, Sample]
) -> dict[str, int]:
    refused = Counter(answer["error"]["code"] for answer in answers if not answer.get("ok"))
    return {
        "orders": sum("request" in entry for entry in entries),
        "answers": len(answers),
        "silences": sum("silence" in entry for entry in entries),
        "acknowledged": len(acknowledged),
        "samples": len(samples),
        **{f"refused {code}": count for code, count in sorted(refused.items())},
    }


def main(words: list[str]) -> int:
    """Print every violation; 1 if there is any."""
    if len(words) not in (1, 2):
        print("checker FOLDER [SESSION]", file=sys.stderr)
        return 2
    verdict = check(Path(words[0]), words[1] if len(words) == 2 else "chaos")
    print(json.dumps({"violations": verdict.violations, "counts": verdict.counts}, indent=1))
    return int(bool(verdict.violations))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
