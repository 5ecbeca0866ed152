"""What may be said of a recording, once the effects that explain it are fitted."""
