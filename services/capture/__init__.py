"""The tagmill capture package."""
