"""Camera drivers, reached through the registry only."""
