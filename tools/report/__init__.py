"""Pictures and tables for people: overlays, contact sheets. One for all tools."""
