"""The search for what was left out."""
