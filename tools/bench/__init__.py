"""Benchmarks that anyone can rerun; they print figures and assert nothing about time."""
