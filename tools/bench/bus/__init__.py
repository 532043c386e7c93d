"""`tagmill bench bus`: what it costs to give a frame to readers, by our ring and by what one would take instead."""
