"""`tagmill doctor`: whether this machine can run a stack, and what to do where it can't."""
