"""`tagmill inspect`: what is in a session, which samples look wrong, which files are broken."""
