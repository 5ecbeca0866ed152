"""The tables and figures of the paper, "Touch with Insight", and what it leaves open."""
