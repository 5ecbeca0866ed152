"""Skins out of drawings, and drawings of skins."""
