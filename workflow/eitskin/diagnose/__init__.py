"""What a simulation leaves out of a recording: where, what, how much."""
