"""``make demo``: the whole stack on synthetic cameras, checked against the renderer's truth."""
