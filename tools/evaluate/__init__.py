"""Measures how good labels and erased pictures are, against what is known."""
