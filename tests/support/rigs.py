"""Objects of rig files that many tests share."""

from collections.abc import Sequence

SIDES = ("front", "left", "right", "back", "top")


def box(name: str = "box-1", first: int = 0, marker_size_mm: int = 150, sides: Sequence[str] = SIDES) -> str:
    """An item of ``objects:``: a box of 400 x 300 x 300 mm, a marker in each side's middle, from ``first`` on."""
    lines = [f"  - name: {name}", "    size_mm: {width: 400, height: 300, depth: 300}", "    sides:"]
    for number, side in enumerate(sides, first):
        lines.append(f"      {side}: {{marker: {number}, marker_size_mm: {marker_size_mm}, border_mm: 15}}")
    return "\n".join(lines) + "\n"
