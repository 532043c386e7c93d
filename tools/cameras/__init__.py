"""`tagmill cameras`: what is attached, and one camera alone."""
