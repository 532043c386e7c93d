"""What shows whether a printer kept to the scale: a 100 mm ruler, and a box for a caliper."""

from __future__ import annotations

from tools.markers.canvas import BLACK, INK, MUTED, Canvas, rectangle

LENGTH_MM = 100
RULER_HEIGHT_MM = 9.0
CALIPER_MM = (50.0, 15.0)
SMALL_CALIPER_MM = (20.0, 15.0)
_FRAME = 0.25


def draw_ruler(canvas: Canvas, x: float, y: float) -> None:
    """A ruler whose marks 0 and 100 are at ``x`` and ``x + 100``, its long marks' upper ends at ``y``."""
    base = y + 5.0
    canvas.line((x, base), (x + LENGTH_MM, base), width=0.12)
    for mm in range(LENGTH_MM + 1):
        length, width = (3.6, 0.14) if mm % 10 == 0 else (2.5, 0.1) if mm % 5 == 0 else (1.6, 0.08)
        if mm in (0, LENGTH_MM):
            length = 5.0
        canvas.line((x + mm, base - length), (x + mm, base), width=width)
        if mm % 10 == 0:
            canvas.text((x + mm, base + 2.9), f"{mm}", 6.5, align="centre")
    canvas.text((x + LENGTH_MM + 2.6, base + 2.9), "mm", 6.5, grey=MUTED)


def draw_caliper_box(canvas: Canvas, x: float, y: float, size: tuple[float, float]) -> None:
    """A frame whose outer edges are ``size`` apart, with its size in it."""
    width, height = size
    inner = rectangle(x + _FRAME, y + _FRAME, width - 2 * _FRAME, height - 2 * _FRAME)
    canvas.fill([rectangle(x, y, width, height), inner], BLACK)
    middle = x + width / 2
    canvas.text((middle, y + height / 2 + 0.2), f"{width:.2f} × {height:.2f}", 7, grey=INK, align="centre")
    words = "mm, outer edges" if width > 30 else "mm, outside"
    canvas.text((middle, y + height / 2 + 3.4), words, 5.5, grey=MUTED, align="centre")
