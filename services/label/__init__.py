"""The tagmill label package."""
