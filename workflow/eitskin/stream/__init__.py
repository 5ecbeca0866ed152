"""Frames judged one by one as they arrive: touch, no touch, or not decidable."""
