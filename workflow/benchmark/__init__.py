"""What is measured against others: speed, finite elements, numerical errors."""
