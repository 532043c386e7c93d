"""The tagmill services package."""
