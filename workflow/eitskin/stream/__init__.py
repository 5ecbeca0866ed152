"""Frames as they come, and what each says of the touch."""
