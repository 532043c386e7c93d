"""The tagmill control package."""
