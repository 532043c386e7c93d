"""`tagmill view`: a session in the Rerun viewer."""
