"""The formats, one module a family; reached through the registry only."""
