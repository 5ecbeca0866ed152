"""Single questions to real recordings, each judged on data left out."""
