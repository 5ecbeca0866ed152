"""What two recordings of one skin share, and what changed between them."""
