"""`tagmill dataset`: what is done to samples that are stored."""
