"""The report of a diagnosis: its page and its figures."""
