"""The tagmill detect package."""
