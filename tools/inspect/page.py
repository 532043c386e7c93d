"""The report: one HTML file with the numbers, plots, and contact sheets of what looks wrong."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader
from common.errors import DatasetError
from common.geometry import CORNER_NAMES
from tools.inspect.coverage import coverage_map
from tools.inspect.facts import Facts, Suspect
from tools.inspect.summary import Spread, Summary
from tools.report.overlay import draw_label
from tools.report.page import Page
from tools.report.plot import Axis, Series, plot
from tools.report.sheet import Row, contact_sheet

Picture = NDArray[np.uint8]

SHOWN_SUSPECTS, SHOWN_USUAL, SHOWN_ALIKE = 12, 6, 6
_WIDTH = 300
_BINS = 24


def report(reader: SessionReader, summary: Summary, facts: Sequence[Facts], found: Sequence[Suspect], top: int) -> Page:
    """The whole report of a session; ``top``: so many suspicious samples are listed."""
    page = Page(f"Session {summary.name}")
    bad = [one for one in found if one.reasons]
    page.text(
        f"{summary.samples} samples, {summary.bytes / 1e6:.0f} MB, {summary.in_bin} in the bin. "
        f"{len(bad)} look suspicious, {summary.duplicates} are near-duplicates of another."
    )
    _suspicious(page, reader, bad, top)
    _contents(page, summary)
    _quality(page, summary, facts)
    _duplicates(page, reader, summary, facts)
    _ledger(page, summary)
    return page


def _suspicious(page: Page, reader: SessionReader, bad: Sequence[Suspect], top: int) -> None:
    page.heading("Look at these first")
    if not bad:
        page.text("No sample stands out.")
        return
    page.note("A score of 1 is where doubt begins. 'tagmill dataset delete SAMPLE' moves one to the bin.")
    rows = [
        [one.facts.sample, f"{one.score:.1f}", "; ".join(reason.text for reason in one.reasons[:3])]
        for one in bad[:top]
    ]
    page.table(["sample", "score", "why"], rows)
    if len(bad) > top:
        page.note(f"The first {top} of {len(bad)}; the file with '--json' has all.")
    shown = [_row(reader, one.facts, one.reasons[0].text) for one in bad[:SHOWN_SUSPECTS]]
    _sheet(page, "The most suspicious", [row for row in shown if row is not None])


def _contents(page: Page, summary: Summary) -> None:
    page.heading("What is in it")
    rows = [["camera " + name, str(count)] for name, count in summary.by_camera.items()]
    rows += [["object " + name, str(count)] for name, count in summary.by_object.items()]
    rows += [["class " + name, str(count)] for name, count in summary.by_class.items()]
    rows += [["background, without an object", str(summary.background)]]
    page.table(["what", "samples"], rows)
    page.note("A window has the class of the side that faces the camera most.")
    for name, cells in summary.coverage.items():
        page.figure(coverage_map(name, cells))
    if summary.angles:
        page.table(
            ["class", "viewing angle, median", "5 % to 95 %", "erased share of the window, median", "5 % to 95 %"],
            [
                [name, f"{angle.median:.0f}°", _range(angle, "{:.0f}", "°"), *_share(summary.erased.get(name))]
                for name, angle in summary.angles.items()
            ],
        )


def _quality(page: Page, summary: Summary, facts: Sequence[Facts]) -> None:
    page.heading("How good it is")
    named = (
        ("residual of the markers, px", summary.residual, "{:.2f}"),
        ("uncertainty of the worst corner (1 sigma), px", summary.corner_sigma, "{:.2f}"),
        ("uncertainty of the distance (1 sigma), mm", summary.distance_sigma, "{:.2f}"),
        ("blur, 0 to 1", summary.blur, "{:.2f}"),
        ("brightness, 0 to 255", summary.brightness, "{:.0f}"),
    )
    rows = [
        [name, form.format(spread.median), _range(spread, form, "")]
        for name, spread, form in named
        if spread is not None
    ]
    page.table(["measure", "median", "5 % to 95 %"], rows)
    items = [item for one in facts for item in one.objects]
    _histogram(
        page,
        "Distance",
        "distance, mm",
        {name: [item.distance_mm for item in items if item.name == name] for name in summary.by_object},
    )
    _histogram(
        page,
        "Viewing angle of the main side",
        "angle, degrees (0: seen squarely)",
        {"all": [item.angle_deg for item in items]},
    )
    _histogram(
        page,
        "Blur",
        "blur, 0 (sharp) to 1",
        {name: [one.blur for one in facts if one.readable and one.camera == name] for name in summary.by_camera},
    )


def _duplicates(page: Page, reader: SessionReader, summary: Summary, facts: Sequence[Facts]) -> None:
    page.heading("Near-duplicates")
    if not summary.alike:
        page.text("None: no two samples look alike and show their objects from the same place.")
        return
    page.text(
        f"{len(summary.alike)} groups in which the pictures look alike and every object is turned by less than 6° and "
        f"moved by less than 4 % of its distance. {summary.duplicates} samples could go. They must stay in one part of "
        "a split: 'tagmill export' sees to that."
    )
    rows = [
        row
        for group in summary.alike[:SHOWN_ALIKE]
        if (row := _row(reader, facts[group[0]], f"{len(group)} samples like this one")) is not None
    ]
    _sheet(page, "The largest groups", rows)


def _ledger(page: Page, summary: Summary) -> None:
    page.heading("The ledger")
    if not summary.ledger:
        page.text("It has no entry.")
        return
    rows = []
    for row in summary.ledger:
        sums = [_counts(row["refused"]), _counts(row["dropped"])]
        verdict = "yes" if row["adds_up"] else ("no" if row["phase"] in ("ended", "interrupted") else "still running")
        rows.append(
            [
                f"{row['recording']}, {row['camera']}",
                str(row["captured"]),
                str(row["recorded"]),
                *sums,
                str(row["deleted"]),
                verdict,
            ]
        )
    page.table(["recording, camera", "captured", "recorded", "refused", "dropped", "deleted", "adds up"], rows)
    page.note("captured = recorded + refused + dropped; what was deleted later stays recorded.")


def _counts(counts: dict[str, int]) -> str:
    if not counts:
        return "0"
    return f"{sum(counts.values())} ({', '.join(f'{why} {count}' for why, count in sorted(counts.items()))})"


def _histogram(page: Page, title: str, label: str, groups: dict[str, list[float]]) -> None:
    known = {name: np.array([value for value in values if np.isfinite(value)]) for name, values in groups.items()}
    known = {name: values for name, values in known.items() if len(values)}
    if not known:
        return
    low, high = (float(edge) for edge in (min(v.min() for v in known.values()), max(v.max() for v in known.values())))
    edges = np.linspace(low, high if high > low else low + 1.0, _BINS + 1)
    middles = [float(value) for value in (edges[:-1] + edges[1:]) / 2]
    series = [
        Series(name, middles, [float(count) for count in np.histogram(values, edges)[0]])
        for name, values in known.items()
    ]
    page.figure(plot(title, Axis(label), Axis("samples", zero=True), series, height=300))


def _sheet(page: Page, title: str, rows: Sequence[Row]) -> None:
    if rows:
        page.picture(contact_sheet(title, ("as stored", "label"), rows, width=_WIDTH), title)


def _row(reader: SessionReader, facts: Facts, caption: str) -> Row | None:
    """None for a sample whose picture can't be shown."""
    try:
        label = reader.label(facts.sample)
        bgr = reader.colour(label)
    except DatasetError:
        return None
    whole = all(len(item.corners) == len(CORNER_NAMES) for item in label.objects)
    drawn = draw_label(bgr, label) if whole else bgr
    scale = 2 * _WIDTH / bgr.shape[1]
    size = (2 * _WIDTH, max(round(bgr.shape[0] * scale), 1))
    small = tuple(
        np.asarray(cv2.resize(one, size, interpolation=cv2.INTER_AREA), dtype=np.uint8) for one in (bgr, drawn)
    )
    return Row(small, _short(f"{facts.sample.split('T', 1)[-1]}: {_ascii(caption)}"))


def _ascii(text: str) -> str:
    """cv2 draws nothing else."""
    return text.encode("ascii", "replace").decode()


def _short(text: str, most: int = 66) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def _range(spread: Spread, form: str, unit: str) -> str:
    return f"{form.format(spread.low)}{unit} to {form.format(spread.high)}{unit}"


def _share(spread: Spread | None) -> tuple[str, str]:
    if spread is None:
        return "", ""
    return f"{spread.median:.0%}", f"{spread.low:.0%} to {spread.high:.0%}"
