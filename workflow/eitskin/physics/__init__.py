"""The physics of a skin, from its geometry to voltages."""
