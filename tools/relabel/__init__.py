"""`tagmill relabel`: labels and pictures made again from the originals."""
