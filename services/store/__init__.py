"""The tagmill store package."""
