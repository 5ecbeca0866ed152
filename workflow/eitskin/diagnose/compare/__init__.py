"""Two recordings compared without a model of the skin."""
