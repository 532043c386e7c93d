"""Hostile input for every parser: seconds of it in the suite (tests/unit/test_fuzz.py), longer by `make fuzz`."""
