"""The method itself: networks, volume renderer, losses (section 3 and the supplement's architecture tables)."""
