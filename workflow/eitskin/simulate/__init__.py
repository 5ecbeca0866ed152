"""What a board would read of a skin: frames, sets of touches, the twin."""
