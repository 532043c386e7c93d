"""The tagmill tools package."""
