"""How far the diagnosis can be trusted: recordings with known truth, diagnosed and scored."""
